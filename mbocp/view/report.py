"""A report: one page that works offline, with the replay as its upper half and all else below."""

from __future__ import annotations

import html
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from mbocp.robot import Robot
from mbocp.solution import ActiveLimit, Load, Solution, loads_of
from mbocp.view.meshcat.page import Below, write_page
from mbocp.view.of_solution import drawn_of
from mbocp.view.replay import replay_page
from mbocp.view.reports.plots import motion_figures, multiplier_figures, other_figures, why_zigzag

_RESOURCES = Path(__file__).parent / "reports"


def write_report(
    solution: Solution,
    path: str | Path,
    *,
    robot: Robot | None = None,
    facts: Sequence[tuple[str, str]] = (),
) -> Path:
    """Write a solution as one self-contained page.

    Parameters
    ----------
    solution : Solution
    path : str or Path
        The file; an old one is replaced only when the new one is complete.
    robot : Robot, optional
        Default: the one of the solution, see `Solution.load_robot`.
    facts : sequence of (str, str)
        Rows of the first table: what is known of the solution, name and words. Default: status and cost.

    Raises
    ------
    ReplayError
        If the motion does not fit the robot, or the file cannot be written.
    InvalidValue, RobotError
        As `Solution.load_robot`.
    """
    shown = solution.load_robot() if robot is None else robot
    below = Below(
        content=_content(solution, shown, facts or _facts(solution)),
        style=(_RESOURCES / "below.css").read_text(encoding="utf-8"),
        script=(_RESOURCES / "below.js").read_text(encoding="utf-8"),
    )
    page = replay_page(shown, solution.t, solution.qs, below=below, **drawn_of(solution, shown))
    return write_page(page, path, "report")


def _content(solution: Solution, robot: Robot, facts: Iterable[tuple[str, str]]) -> str:
    sections = [
        ("Over time", _plots(motion_figures(solution, robot))),
        ("What came out", _table(facts)),
        ("Active limits", _limits(solution.active_limits)),
        ("Loads of the controls", _loads(loads_of(solution, robot))),
        ("Forces, adjoints and multipliers", _multipliers(solution)),
        ("Convergence and diagnostics", _plots(other_figures(solution, robot))),
        ("Problem file", f"<pre>{html.escape(solution.problem_text or 'not recorded')}</pre>"),
        ("Made with", _table(_versions(solution.versions))),
    ]
    return "\n".join(f"<h2>{title}</h2>\n{body}" for title, body in sections)


def _plots(figures: Iterable[str]) -> str:
    return f'<div class="plots">{"".join(figures)}</div>'


def _multipliers(solution: Solution) -> str:
    words = why_zigzag(solution)
    note = f'<p class="note">{words}</p>' if words else ""
    return _plots(multiplier_figures(solution)) + note


def _facts(solution: Solution) -> list[tuple[str, str]]:
    status = f"{solution.status}: {solution.advice}" if solution.advice else str(solution.status)
    return [("status", status), ("cost", f"{solution.cost:.10g}"), ("solver", solution.solver)]


def _versions(versions: Mapping[str, str]) -> Iterable[tuple[str, str]]:
    return versions.items() or [("versions", "not recorded")]


def _table(rows: Iterable[tuple[str, str]]) -> str:
    body = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(words)}</td></tr>" for name, words in rows
    )
    return f'<table class="facts">{body}</table>'


def _limits(limits: Sequence[ActiveLimit]) -> str:
    if not limits:
        return "<p>The motion touches none of its limits.</p>"
    return _rows(("kind", "name", "side", "bound", "where"), map(_cells, limits))


def _rows(heading: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{word}</th>" for word in heading)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'


def _loads(loads: Sequence[Load]) -> str:
    if not loads:
        return "<p>There are no controls.</p>"
    rows = (
        (
            load.name,
            f"{load.rms:.4g} {load.unit}",
            f"{load.largest:.4g} {load.unit}",
            *("-" if math.isnan(power) else f"{power:.4g} W" for power in (load.power, load.braking)),
            *("-" if math.isnan(energy) else f"{energy:.4g} J" for energy in (load.work, load.braked)),
        )
        for load in loads
    )
    heading = ("control", "root mean square", "largest", "largest power", "largest braking", "work", "braked")
    return _rows(heading, rows)


def _cells(limit: ActiveLimit) -> tuple[str, ...]:
    bound = f"{limit.bound:.5g} {limit.unit}".strip() if limit.bound == limit.bound else "-"
    return limit.kind, limit.name, limit.side, bound, f"{limit.count} of {limit.total}"

"""Reports: one page that works offline, with the replay as its upper half and all else below."""

from __future__ import annotations

import html
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._files import parse_toml
from mbocp._text import shorten, show
from mbocp.exceptions import Unreadable
from mbocp.robot import Robot
from mbocp.solution import ActiveLimit, Load, Solution, loads_of
from mbocp.solution.atomic import replace_text
from mbocp.view.meshcat.page import Below
from mbocp.view.of_solution import list_things_drawn
from mbocp.view.replay import OtherMotion, replay_page
from mbocp.view.reports.page_plots import (
    motion_figures,
    multiplier_figures,
    other_figures,
    pair_figures,
    why_zigzag,
)

_LONGEST = 160  # text of a value
_NUMBERS: Mapping[str, tuple[Callable[[Solution], float], str]] = {
    "cost": (lambda solution: solution.cost, ".7g"),
    "duration [s]": (lambda solution: solution.duration, ".5g"),
    "steps": (lambda solution: solution.num_steps, "d"),
    "iterations": (lambda solution: solution.iterations, "d"),
    "time of the solve [s]": (lambda solution: solution.wall_time_s, ".3g"),
    "residual": (lambda solution: solution.residual, ".3g"),
    "violation of constraints": (lambda solution: solution.constraint_violation, ".3g"),
    "violation of limits": (lambda solution: solution.limit_violation, ".3g"),
    "excess between nodes [%]": (lambda solution: 100.0 * solution.limit_excess, ".3g"),
    "clearance [m]": (lambda solution: solution.clearance, ".4g"),
    "work of the controls [J]": (lambda solution: solution.positive_work, ".4g"),
    "energy from the supply [J]": (lambda solution: solution.drawn_energy, ".4g"),
    "largest error of a step": (lambda solution: solution.accuracy.local_error, ".2g"),
}


def numbers_of(results: Mapping[str, Solution]) -> list[list[str]]:
    """Rows of a table: a name, and a cell for each result; numbers that none has are left out."""
    rows = [["status", *(str(solution.status) for solution in results.values())]]
    for name, (number, written) in _NUMBERS.items():
        values = [number(solution) for solution in results.values()]
        if np.isfinite(values).any():
            rows.append([name, *(format(x, written) if np.isfinite(x) else "-" for x in values)])
    return rows


def differences_of(results: Mapping[str, Solution]) -> list[list[str]]:
    """Rows of a table: a key of the problem files, and what each result has for it, where that differs."""
    keys = [dict(_keys_of(solution)) for solution in results.values()]
    names = dict.fromkeys(name for each in keys for name in each)
    return [
        [name, *_format([each.get(name) for each in keys])]
        for name in names
        if any(each.get(name) != keys[0].get(name) for each in keys)
    ]


def _format(values: Sequence[Any]) -> list[str]:
    """Values in few digits, where these tell them apart."""
    short = ["-" if value is None else _short(value) for value in values]
    return short if len(set(short)) > 1 else [show(value, _LONGEST) for value in values]


def _short(value: Any) -> str:
    if not isinstance(value, list):
        return f"{value:.6g}" if isinstance(value, float) else show(value, _LONGEST)
    entries = [_short(entry) for entry in value]
    is_even = len(entries) > 1 and len(set(entries)) == 1
    return (
        f"{entries[0]}, each of {len(entries)}" if is_even else shorten(f"[{', '.join(entries)}]", _LONGEST)
    )


def _keys_of(solution: Solution) -> Iterator[tuple[str, Any]]:
    try:
        document = parse_toml(solution.problem_text)
    except Unreadable:  # of results that another program wrote
        return
    tables: list[tuple[str, Any]] = [("", document)]
    for prefix, table in tables:
        for key, value in table.items():
            if isinstance(value, dict):
                tables.append((f"{prefix}{key}.", value))
            else:
                yield f"{prefix}{key}", value


_ROUND_OFF = 1e-9  # of loads, in any of their units
_RESOURCES = Path(__file__).parent / "reports"


def write_report(
    solution: Solution, path: str | Path, *, robot: Robot | None = None, facts: Sequence[tuple[str, str]] = ()
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
        If the motion does not fit the robot.
    ResultFileError
        If the file cannot be written.
    InvalidValue, RobotError
        As `Solution.load_robot`.
    """
    shown = solution.load_robot() if robot is None else robot
    page = replay_page(
        shown,
        solution.t,
        solution.qs,
        below=_below(_content(solution, shown, facts or _facts(solution))),
        **list_things_drawn(solution, shown),
    )
    return replace_text(path, page)


def compare_results(results: Mapping[str, Solution], path: str | Path) -> Path:
    """Write several solutions as one page: one replay, numbers side by side, plots on the same axes.

    Parameters
    ----------
    results : mapping of str to Solution
        By the name that each has on the page; up to five.
    path : str or Path
        The file; an old one is replaced only when the new one is complete.

    Raises
    ------
    ReplayError
        If they are too many, or a motion does not fit its robot.
    ResultFileError
        If the file cannot be written.
    InvalidValue, RobotError
        As `Solution.load_robot`.
    """
    loaded = {name: (solution, solution.load_robot()) for name, solution in results.items()}
    (first, robot), *rest = loaded.values()
    names = list(results)[1:]
    others = [
        OtherMotion(its, other.t, other.qs, name) for name, (other, its) in zip(names, rest, strict=True)
    ]
    unlike = differences_of(results)
    sections = [
        ("Numbers", _rows(("", *results), numbers_of(results))),
        ("Keys that differ", _rows(("key", *results), unlike) if unlike else "<p>None: one problem.</p>"),
    ]
    plots = [(title, _plots(figures)) for title, figures in pair_figures(loaded)]
    drawn = {**list_things_drawn(first, robot), "title": " · ".join(results), "others": others}
    page = replay_page(
        robot, first.t, first.qs, below=_below(_join(sections) + _fold(plots, opened=3)), **drawn
    )
    return replace_text(path, page)


def _below(content: str) -> Below:
    style, script = ((_RESOURCES / name).read_text(encoding="utf-8") for name in ("below.css", "below.js"))
    return Below(content, style, script)


def _content(solution: Solution, robot: Robot, facts: Iterable[tuple[str, str]]) -> str:
    limits = solution.active_limits
    shown = [
        ("Over time", _plots(motion_figures(solution, robot))),
        ("What came out", _table(facts)),
        ("Loads of the controls", _loads(loads_of(solution, robot))),
    ]
    folded = [
        (f"Active limits ({len(limits)})", _limits(limits)),
        ("Forces, adjoints and multipliers", _multipliers(solution)),
        ("Convergence and diagnostics", _plots(other_figures(solution, robot))),
        ("Problem file", f"<pre>{html.escape(solution.problem_text or 'not recorded')}</pre>"),
        ("Made with", _table(_versions(solution.versions))),
    ]
    return _verdict(solution) + _join(shown) + _fold(folded)


def _verdict(solution: Solution) -> str:
    """What an engineer asks first, in one line."""
    words = [f"cost {solution.cost:.6g}", f"{solution.duration:.4g} s"]
    if np.isfinite(solution.clearance):
        words.append(f"clearance {1e3 * solution.clearance:.4g} mm")
    if not solution.converged:
        words.append(solution.advice)
    looks, status = ("", "converged") if solution.converged else (" bad", f"not converged: {solution.status}")
    rest = "".join(f" · {html.escape(word)}" for word in words if word)
    return f'<p class="verdict{looks}"><b>{html.escape(status)}</b>{rest}</p>'


def _join(sections: Iterable[tuple[str, str]]) -> str:
    return "\n".join(f"<h2>{html.escape(title)}</h2>\n{body}" for title, body in sections)


def _fold(sections: Iterable[tuple[str, str]], opened: int = 0) -> str:
    """Sections that a click opens, but for the first ones."""
    return "\n".join(
        f"<details{' open' if k < opened else ''}><summary><h2>{html.escape(title)}</h2></summary>\n{body}"
        "</details>"
        for k, (title, body) in enumerate(sections)
    )


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
    head = "".join(f"<th>{html.escape(word)}</th>" for word in heading)
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
            *(_with_unit(value, load.unit) for value in (load.rms, load.largest)),
            *(_with_unit(power, "W") for power in (load.power, load.braking)),
            *(_with_unit(energy, "J") for energy in (load.work, load.braked)),
        )
        for load in loads
    )
    heading = ("control", "root mean square", "largest", "largest power", "largest braking", "work", "braked")
    return _rows(heading, rows)


def _with_unit(value: float, unit: str) -> str:
    """A value with its unit, on one line; round-off is zero."""
    if math.isnan(value):
        return "-"
    number = f"{0.0 if abs(value) < _ROUND_OFF else value:.4g}"
    return f"{number} {unit}".replace(" ", "\N{NO-BREAK SPACE}")


def _cells(limit: ActiveLimit) -> tuple[str, ...]:
    bound = f"{limit.bound:.5g} {limit.unit}".strip() if limit.bound == limit.bound else "-"
    return limit.kind, limit.name, limit.side, bound, f"{limit.count} of {limit.total}"

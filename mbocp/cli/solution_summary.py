"""A result in words that a person understands."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.text import Text

from mbocp.cli.clearance_words import clearance_lines
from mbocp.cli.console import count, output, plain_table
from mbocp.cli.limit_rows import limit_rows
from mbocp.cli.summary_words import accuracy_words, coarse_words, work_words
from mbocp.integrators.schemes import SCHEMES

if TYPE_CHECKING:
    from mbocp.problem import Problem
    from mbocp.problem.reasons.cause import Cause
    from mbocp.robot import Robot
    from mbocp.solution import Solution
    from mbocp.solution.details import StartRecord

_Rows = list[tuple[str, str | Text]]

_MAX_STARTS = 6
_STOPPED = ("interrupted", "time_limit")  # nothing speaks against the problem then
_FAR = 0.5  # part of the cost: a lower bound that is farther below says little
_SAME = 1e-4  # relative: what differs by less is written alike


def print_summary(solution: Solution, problem: Problem, written: Sequence[tuple[str, Path]] = ()) -> None:
    """Print what was solved, how it went, and what was written."""
    robot = problem.robot
    rows: _Rows = [
        *solution_rows(solution, robot_words(robot.name, robot.nv, robot.nu, robot.nc)),
        ("at least", _bound(solution, problem)),
        ("kept apart", "\n".join(clearance_lines(problem.clearance))),
        *((kind, str(path)) for kind, path in written),
    ]
    after: dict[str, tuple[str, str | Text]] = {
        "robot": ("redundant", _redundant(robot)),
        "status": ("cause", _cause(solution, problem)),
    }
    listed = [one for row in rows for one in (row, after.get(row[0], ("", ""))) if one[1]]
    print_rows(solution.problem_name or problem.name, listed)


def _redundant(robot: Robot) -> str:
    names = ", ".join(robot.closure_labels[row].name for row in robot.redundant_rows)
    return f"{names}: left out, the other rows imply them" if names else ""


def _cause(solution: Solution, problem: Problem) -> Text:
    """Why there is no solution; nothing where there is one, or somebody stopped the search."""
    if solution.status.is_stationary or str(solution.status) in _STOPPED:
        return Text()
    from mbocp.problem.reasons.causes import causes_of

    why = "unknown; `mbocp explain` looks for the limit that has to give"
    causes = causes_of(problem)
    if causes and causes[0].words in solution.advice:
        return Text()
    if causes:
        why = causes[0].words if causes[0].is_certain else f"probably: {causes[0].words}"
    return Text(why, style="bold")


def _bound(solution: Solution, problem: Problem) -> str:
    """A lower bound of the cost, where a quick one is near enough to say something."""
    from mbocp.bounds.of_problem import quick_bound  # nobody else needs it

    if not solution.is_stationary:
        return ""
    found = quick_bound(solution, problem)
    return found.words if found.gap < _FAR else ""


def cause_rows(causes: Sequence[Cause]) -> _Rows:
    """Return what arithmetic says against a problem, ready for `print_rows`."""
    named = {True: ("impossible", "bold red"), False: ("doubtful", "yellow")}
    found = ((named[cause.is_certain], cause.words) for cause in causes)
    return [(name, Text(words, style=style)) for (name, style), words in found]


def print_rows(title: str, rows: Sequence[tuple[str, str | Text]]) -> None:
    """Print a title and named rows on stdout."""
    console = output()
    table = plain_table(show_header=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for name, text in rows:
        # Words are no markup: names of files may have brackets.
        table.add_row(Text(name), text if isinstance(text, Text) else Text(text))
    console.print(Text(title, style="bold underline"))
    console.print(table)


def solution_rows(solution: Solution, robot: str) -> _Rows:
    """Return what every result has to say, ready for `print_rows`."""
    verdict = Text(str(solution.status), style="bold green" if solution.converged else "bold red")
    if solution.advice:
        verdict.append(f": {solution.advice}", style="not bold default")
    rows: _Rows = [
        ("coarse", coarse_words(solution)),
        ("robot", robot),
        ("inertias", _masses(solution.robot_spec)),
        ("carries", _load_and_tools(solution.robot_spec)),
        ("horizon", f"{_duration(solution)} in {_steps(solution)}{_scheme(solution)}"),
        ("phases", _describe_phases(solution)),
        ("via points", _via(solution)),
        ("found", _parameters(solution)),
        ("guess", solution.guess_used or "not recorded"),
        ("starts", _starts(solution)),
        ("solver", f"{solution.solver}, {solution.unknowns} unknowns"),
        ("status", verdict),
        ("cost", f"{solution.cost:.10g}"),
        ("work", work_words(solution)),
        ("energy", _describe_drawn_energy(solution)),
        ("iterations", f"{solution.iterations} in {_seconds(solution.wall_time_s)}{_phases(solution)}"),
        ("residual", f"{solution.residual:.2e}, last increment {_increment(solution)}"),
        ("goal", solution.goal_error),
        *limit_rows(solution),
        ("accuracy", accuracy_words(solution)),
        ("conserved", _quantities(solution)),
        ("Hamiltonian", _hamiltonian(solution)),
    ]
    return [row for row in rows if row[1]]


def _increment(solution: Solution) -> str:
    return "-" if math.isnan(solution.increment) else f"{solution.increment:.2e}"


def _describe_drawn_energy(solution: Solution) -> str:
    if math.isnan(solution.drawn_energy):
        return ""
    return f"{solution.drawn_energy:.4g} J from the supply, as cost.energy says"


def _starts(solution: Solution) -> str:
    """Which of several guesses was taken, and what they led to, a line each, the cheapest first."""
    if not solution.starts:
        return ""
    guesses, same = [start.guess for start in solution.starts], dict[str, list["StartRecord"]]()
    for start in sorted(solution.starts, key=lambda start: (not start.status.is_stationary, start.cost)):
        same.setdefault(f"{start.status}, cost {start.cost:.6g}", []).append(start)
    lines = [
        f"{words} after {found[0].iterations} iterations: {found[0].guess}"
        + (f", and {len(found) - 1} more" if len(found) > 1 else "")
        for words, found in same.items()
    ]
    if len(lines) > _MAX_STARTS:
        lines[_MAX_STARTS:] = [f"and {len(lines) - _MAX_STARTS} other ends"]
    if solution.guess_used in guesses:
        number = 1 + guesses.index(solution.guess_used)
        lines.insert(0, f"number {number} of {len(guesses)} was taken: {solution.guess_used}")
    return "\n".join(lines)


def _duration(solution: Solution) -> str:
    """How long the motion takes, and between which bounds it was free to."""
    if solution.duration_range is None:
        return f"{solution.duration:g} s"
    lower, upper = solution.duration_range
    return f"{solution.duration:.9g} s, free between {lower:g} and {upper:g} s,"


def _steps(solution: Solution) -> str:
    """How many steps, and how long they are; where times of via points were found they differ."""
    lengths = np.diff(solution.t)
    leaps = int((lengths == 0.0).sum())
    lengths = lengths[lengths > 0.0]
    mean = solution.duration / len(lengths)
    words = f"{lengths.min():.4g} to {lengths.max():.4g} s"
    if np.ptp(lengths) <= _SAME * mean:
        words = f"{mean:.4g} s"
    return f"{len(lengths)} steps of {words}{count_impacts(leaps)}"


def count_impacts(number: int) -> str:
    """What steps without duration add to the others, in words."""
    return f" and {count(number, 'impact')}" if number else ""


def _via(solution: Solution) -> str:
    """When the motion passes via points."""
    return ", ".join(f"{name} at {time:.6g} s" for name, time in solution.via_times.items())


def _parameters(solution: Solution) -> str:
    """What numbers of the robot were found, a line each."""
    return "\n".join(
        f"{one.name}: {one.value:.6g} {one.unit}, between {one.lower:g} and {one.upper:g}"
        for one in solution.facts.parameters
    )


def _describe_phases(solution: Solution) -> str:
    """How long each phase takes, a line each."""
    times, lines = solution.phase_times, []
    for phase in solution.named_phases:
        begins, ends = times[phase.name]
        free = f", free between {phase.shortest:g} and {phase.longest:g} s," if phase.is_free else ""
        steps = count(phase.last - phase.first - phase.has_impact - phase.has_parting, "step")
        steps = f"an impact and {steps}" if phase.has_impact else steps
        lines.append(f"{phase.name}: {ends - begins:.6g} s{free} in {steps}, until {ends:.6g} s")
    return "\n".join(lines)


def _controls(solution: Solution) -> str:
    """How controls vary within steps, where they do."""
    if solution.has_constant_controls:
        return ""
    return ", controls linear" if solution.has_linear_controls else ", controls at its stages"


def _scheme(solution: Solution) -> str:
    if not solution.scheme:
        return ""
    known = SCHEMES.get(solution.scheme)
    if known is None or not known.takes("integrator.lie"):
        return f" by scheme {solution.scheme}{_controls(solution)}"
    within = f", {solution.substeps} steps in each" if solution.substeps > 1 else ""
    how = "" if solution.is_vector_space else f"; rotations: {solution.rotations}, {solution.lie}"
    return f" by scheme {solution.scheme}{within}{how}"


def robot_words(name: str, nv: int, nu: int, nc: int) -> str:
    """Say how much can move, and how much of it by itself."""
    free = f"{count(nv - nc, 'degree')} of freedom"
    held = f" ({nv} velocities, {count(nc, 'constraint')})" if nc else ""
    return f"{name}: {free}{held}, {count(nu, 'control')}"


def payload_words(payloads: Sequence[Mapping[str, Any]]) -> str:
    """Say what is carried, from the tables of payloads."""
    return ", ".join(f"{p.get('name')} ({p.get('mass')} kg at {p.get('frame')})" for p in payloads)


def inertia_words(links: Sequence[Mapping[str, Any]]) -> str:
    """Say which links have other masses than their file gives, from the facts of a robot."""
    return ", ".join(f"{one['link']} {one['mass']:.3g} kg ({one['origin']})" for one in links)


def _masses(robot_spec: Mapping[str, Any]) -> str:
    """What a problem says of masses and inertias that no file gives."""
    tables = [robot_spec, *(part for part in robot_spec.get("part", ()) if isinstance(part, Mapping))]
    given = (table.get("inertias") for table in tables)
    links = [name for table in given if isinstance(table, Mapping) for name in table.get("links", ())]
    return f"not of its file: those of {', '.join(links)}" if links else ""


def _load_and_tools(robot_spec: Mapping[str, Any]) -> str:
    written = robot_spec.get("payload")
    return payload_words([p for p in written if isinstance(p, Mapping)]) if isinstance(written, list) else ""


def _quantities(solution: Solution) -> str | Text:
    """Control momenta, each with what it is on a line of its own."""
    if not solution.conserved:
        return "none: no translation or rotation is known to be a symmetry of this problem"
    text = Text()
    for quantity in solution.conserved:
        kept = f"{quantity.value:.9g}, drift {quantity.drift:.1e}, relative {quantity.relative_drift:.1e}"
        if quantity.vanishes:
            kept = f"0 (drift {quantity.drift:.1e})"
        text.append(f"{quantity.name}: {kept}\n")
        if quantity.meaning:
            text.append(f"  {quantity.meaning}\n", style="dim")
    text.rstrip()
    return text


def _hamiltonian(solution: Solution) -> str:
    values = solution.control_hamiltonian
    if math.isnan(values["mean"]):
        return ""
    return f"mean {values['mean']:.6g}, from {values['min']:.6g} to {values['max']:.6g}"


def _phases(solution: Solution) -> str:
    """Time of each phase, and iterations where it has any."""
    named = [
        f"{phase.name} {f'{phase.iterations} in ' if phase.iterations else ''}{_seconds(phase.wall_time_s)}"
        for phase in solution.phases
    ]
    return f" ({', '.join(named)})" if named else ""


def _seconds(value: float) -> str:
    if math.isnan(value):
        return "unknown time"
    return f"{value * 1e3:.3g} ms" if value < 1.0 else f"{value:.3g} s"

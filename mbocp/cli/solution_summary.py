"""A result in words that a person understands."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.text import Text

from mbocp._arrays import Array, BoolArray
from mbocp.cli.console import count, output, plain_table
from mbocp.integrators.schemes import SCHEMES
from mbocp.problem.coordinates import COORDINATES
from mbocp.robot.parts import Label
from mbocp.solution.loads import rms_of
from mbocp.solvers.records import Status

if TYPE_CHECKING:
    from mbocp.problem import Goal, Problem
    from mbocp.problem.reasons.cause import Cause
    from mbocp.robot import Robot
    from mbocp.solution import Accuracy, ActiveLimit, Solution
    from mbocp.solution.records import StartRecord

_Rows = list[tuple[str, str | Text]]

_MAX_NAMES = 12  # more names than that are counted
_MAX_LIMITS = 8  # more lines than that nobody reads
_MAX_STARTS = 6
_FORCES = {"J/m": "N", "J/rad": "N m", "J/m^2": "N/m"}  # what multipliers of constraints are
_STOPPED = ("interrupted", "time_limit")  # nothing speaks against the problem then
_FAR = 0.5  # part of the cost: a lower bound that is farther below says little
_SAME = 1e-4  # relative: what differs by less is written alike
_AT_NODES = ("velocity", "position", "path")  # kinds of limits; the others hold in steps


def print_summary(solution: Solution, problem: Problem, written: Sequence[tuple[str, Path]] = ()) -> None:
    """Print what was solved, how it went, and what was written."""
    robot = problem.robot
    rows: _Rows = [
        *solution_rows(solution, robot_words(robot.name, robot.nv, robot.nu, robot.nc)),
        ("at least", _bound(solution, problem)),
        ("kept apart", "\n".join(problem.clearance.words) if problem.clearance else ""),
        *((kind, str(path)) for kind, path in written),
    ]
    after: dict[str, tuple[str, str | Text]] = {
        "robot": ("redundant", _redundant(robot)),
        "status": ("cause", _cause(solution, problem)),
        "residual": ("goal", goal_error(solution, problem)),
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
    if causes := causes_of(problem):
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
        ("coarse", _coarse(solution)),
        ("robot", robot),
        ("inertias", _masses(solution.robot_spec)),
        ("carries", _load_and_tools(solution.robot_spec)),
        ("horizon", f"{_duration(solution)} in {_steps(solution)}{_scheme(solution)}"),
        ("phases", _named_phases(solution)),
        ("via points", _via(solution)),
        ("found", _parameters(solution)),
        ("guess", solution.guess_used or "not recorded"),
        ("starts", _starts(solution)),
        ("solver", f"{solution.solver}, {solution.unknowns} unknowns"),
        ("status", verdict),
        ("cost", f"{solution.cost:.10g}"),
        ("work", _work(solution)),
        ("iterations", f"{solution.iterations} in {_seconds(solution.wall_time_s)}{_phases(solution)}"),
        ("residual", f"{solution.residual:.2e}, last increment {solution.increment:.2e}"),
        ("constraints", _violation(solution)),
        *_constraint_forces(solution),
        ("rms effort", _mean_squares(solution)),
        ("limits", _limits(solution)),
        ("robust", _robust(solution)),
        ("clearance", _clearance(solution)),
        ("drift of rotations", _drift(solution)),
        ("accuracy", _accuracy(solution)),
        ("conserved", _quantities(solution)),
        ("Hamiltonian", _hamiltonian(solution)),
    ]
    return [row for row in rows if row[1]]


def _work(solution: Solution) -> str:
    if math.isnan(solution.positive_work):
        return ""
    return f"{solution.positive_work:.4g} J by the controls, braking left out"


def _coarse(solution: Solution) -> Text:
    """What has to be known before everything else: that the steps are too long for the motion."""
    found = solution.accuracy
    if not found.is_known or found.is_small:
        return Text()
    words = (
        f"the errors of the steps are {_percent(found.share)} of the way of {found.way_joint}: a robot "
        "under these controls moves otherwise; take more steps, or a scheme of higher order (see accuracy)"
    )
    return Text(words, style="bold yellow")


def _feedback(found: Accuracy, size: Callable[[float, str], str]) -> list[str]:
    """What a feedback leaves of the errors."""
    if math.isnan(found.tracked_error):
        return []
    if math.isinf(found.tracked_error):
        return ["with the feedback of the optimum, held over each step, errors grow too fast to be told"]
    missed = size(found.tracked_error, found.tracked_joint)
    return [f"with the feedback of the optimum they miss it by {missed}"]


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 1.0 else f"{100 * share:.0f} %"


def _accuracy(solution: Solution) -> str:
    """Errors of single steps, of their sum, and of a replay."""
    found = solution.accuracy
    if not found.is_known:
        return ""
    units = {column.name: column.unit.removesuffix("/s") for column in solution.labels.v}

    def size(value: float, joint: str) -> str:
        return f"{value:.2g} {units.get(joint, '')}".rstrip() + f" ({joint})"

    missed = "more than can be told, for errors grow too fast"
    if math.isfinite(found.replay_error):
        missed = size(found.replay_error, found.replay_joint)
    lines = [
        *_horizon_and_solver(solution),
        f"a step is wrong by {size(found.local_error, found.local_joint)} at most, to t = "
        f"{found.local_time:.4g} s; all of them by {_percent(found.share)} of the way of {found.way_joint}",
        f"the controls alone, without feedback, miss the end by {missed}",
        *_feedback(found, size),
        f"the steps {'make' if found.made_energy > 0.0 else 'lose'} {abs(found.made_energy):.2g} J of "
        f"{found.energy_range:.3g} J",
    ]
    return "\n".join(lines)


def _horizon_and_solver(solution: Solution) -> list[str]:
    """What was asked for, and how many steps it took."""
    found = solution.accuracy
    if math.isnan(found.asked):
        return []
    rounds = "1 round" if found.rounds == 1 else f"{found.rounds} rounds"
    lengths = np.diff(solution.t)
    wrong = f"the cost is wrong by {found.cost_error:.1g} of it" if found.cost_error else "the cost is zero"
    return [
        f"{found.asked:g} was asked for: {solution.num_steps} steps of {lengths.min():.3g} to "
        f"{lengths.max():.3g} s, found in {rounds}; {wrong}"
    ]


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


def goal_error(solution: Solution, problem: Problem) -> str:
    """Say how far the end is from the goal, in the worst direction of position and of velocity."""
    robot, goal = problem.robot, problem.member(solution.goal_place).goal
    if goal.enforce == "none":
        return ""
    of_v = robot.v_labels
    parts = []
    if goal.q_active.any():
        of_q = [Label(label.name, label.unit.removesuffix("/s")) for label in of_v]
        parts.append(f"off by {_worst(robot.difference(goal.q, solution.q_final), goal.q_active, of_q)}")
    if goal.rate == "p" and goal.rate_active.any():
        away = solution.p_final - goal.value
        parts.append(f"momentum by {_worst(away, goal.rate_active, robot.p_labels)}")
    elif goal.rate_active.any():
        parts.append(f"velocity by {_worst(solution.vs[-1] - goal.value, goal.rate_active, of_v)}")
    if problem.sets_acceleration.any():
        of_a = [Label(label.name, f"{label.unit}^2") for label in of_v]
        away = solution.accelerations[-1] - goal.a
        parts.append(f"acceleration by {_worst(away, problem.sets_acceleration, of_a)}")
    if goal.periodic is not None:
        parts.append(_cycle_error(solution, problem))
    return ", ".join([*parts, *_frames_off(robot, goal, solution.q_final)])


def _worst(away: Array, asked: BoolArray, labels: Sequence[Label]) -> str:
    """Size of the largest error among those that count, and where it is."""
    worst = int(np.abs(np.where(asked, away, 0.0)).argmax())
    return f"{abs(away[worst]):.2e} {labels[worst].unit} at {labels[worst].name}"


def _frames_off(robot: Robot, goal: Goal, q: Array) -> Iterator[str]:
    if not goal.poses:
        return
    from mbocp.problem.goals.frames import pose_errors

    errors = pose_errors(robot, goal, q)
    for frame, distance, angle in zip(goal.poses, errors.positions, errors.angles, strict=True):
        yield f"{frame.name} off by {1e3 * distance:.2e} mm and {np.degrees(angle):.2e} deg"


def _cycle_error(solution: Solution, problem: Problem) -> str:
    """How far the end is from the image of the start."""
    robot, periodic = problem.robot, problem.member(solution.goal_place).goal.periodic
    if periodic is None:
        return ""
    start, end = ((solution.qs[n], solution.vs[n]) for n in (0, -1))
    defect = periodic.defect(robot, start, end)
    worst = int(np.abs(defect).argmax())
    label = robot.v_labels[worst % robot.nv]
    unit = label.unit.removesuffix("/s") if worst < robot.nv else label.unit
    words = f"a cycle, closed to {abs(defect[worst]):.2e} {unit} at {label.name}"
    apart = [
        f"{name} moves by {(end[0] - start[0])[robot.configuration_indices(name)].item():.6g}"
        for name in periodic.apart
        if robot.velocity_indices(name).stop - robot.velocity_indices(name).start == 1
        and robot.configuration_indices(name).stop - robot.configuration_indices(name).start == 1
    ]
    return "; ".join([words, *apart])


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
    told = f" and {leaps} impact{'s' * (leaps > 1)}" if leaps else ""
    return f"{len(lengths)} steps of {words}{told}"


def _via(solution: Solution) -> str:
    """When the motion passes via points."""
    return ", ".join(f"{name} at {time:.6g} s" for name, time in solution.via_times.items())


def _parameters(solution: Solution) -> str:
    """What numbers of the robot were found, a line each."""
    return "\n".join(
        f"{one.name}: {one.value:.6g} {one.unit}, between {one.lower:g} and {one.upper:g}"
        for one in solution.facts.parameters
    )


def _named_phases(solution: Solution) -> str:
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


def _violation(solution: Solution) -> str:
    if not solution.nc:
        return "none"
    columns = solution.labels.lam
    named = ", ".join(c.name for c in columns)
    names = named if len(columns) <= _MAX_NAMES else f"all {len(columns)} of them"
    words = f"violated by {solution.constraint_violation:.2e} at most ({names})"
    hidden = solution.velocity_violation
    return words if math.isnan(hidden) else f"{words}, their rates by {hidden:.2e}"


def _constraint_forces(solution: Solution) -> _Rows:
    """The largest force and moment that constraints exert; nothing where multipliers are of rigid bodies."""
    known = COORDINATES.get(solution.coordinates)
    if not solution.nc or known is None or not known.has_robot_multipliers or not len(solution.lams):
        return []
    leaps = np.diff(solution.t) == 0.0
    rows: _Rows = [("forces", f"of constraints, at most {_largest(solution, ~leaps, '')}")]
    if leaps.any():
        rows.append(("impulses", f"of impacts, at most {_largest(solution, leaps, ' s')}"))
    return rows


def _largest(solution: Solution, steps: BoolArray, more: str) -> str:
    """The largest multipliers of each unit in some of the steps, with names."""
    sizes = np.abs(solution.lams[steps]).max(axis=0)
    found = dict[str, tuple[float, str]]()
    for size, column in zip(sizes.tolist(), solution.labels.lam, strict=True):
        unit = _FORCES.get(column.unit, column.unit) + more
        if size > found.get(unit, (-1.0, ""))[0]:
            found[unit] = (size, column.name)
    return ", ".join(f"{size:.4g} {unit} at {name}" for unit, (size, name) in found.items())


def _limits(solution: Solution) -> str:
    """Which limits the motion touches, and by how much it leaves them; nothing where there are none."""
    if not _is_bounded(solution):
        return ""
    active = [_touches(limit) for limit in solution.active_limits]
    listed = "\n".join(active[:_MAX_LIMITS]) or "none is active"
    if len(active) > _MAX_LIMITS:
        listed += f"\nand {len(active) - _MAX_LIMITS} more"
    if solution.limit_violation > 0.0:
        listed += f"\nviolated by {solution.limit_violation:.2e} at most"
    elif solution.limit_violation == 0.0:
        listed += "\nall are kept at the nodes"
    if solution.limit_excess > 0.0:
        more = " or more" if solution.status is Status.UNDER_RESOLVED else ""
        part, when = f"{100.0 * solution.limit_excess:.3g} %{more}", f"{solution.limit_excess_time:.4g} s"
        listed += f"\nbetween nodes the {solution.limit_excess_of} leaves its limit by {part}, at {when}"
    return listed


def _robust(solution: Solution) -> str:
    """Which limits leave most room for what is uncertain."""
    if math.isnan(solution.sigmas):
        return ""
    return f"limits keep off {solution.sigmas:.3g} standard deviations: {solution.tightest}"


def _mean_squares(solution: Solution) -> str:
    """Root mean squares of controls, where they have limits."""
    if not solution.facts.effort_rms:
        return ""
    columns = zip(solution.labels.u, rms_of(solution), solution.facts.effort_rms, strict=True)
    words = [f"{c.name} {rms:.4g} of {most:.4g} {c.unit}" for c, rms, most in columns if math.isfinite(most)]
    return ", ".join(words)


def _is_bounded(solution: Solution) -> bool:
    bounds = (solution.limits_u, solution.limits_v, solution.limits_q)
    if (
        solution.path_names
        or solution.facts.effort_rms
        or solution.duration_range is not None
        or solution.named_phases
        or solution.facts.parameters
    ):
        return True
    return any(bool(np.isfinite(bound).any()) for bound in bounds)


def _touches(limit: ActiveLimit) -> str:
    where = f"{limit.kind} {limit.name}"
    times = f"in {limit.count} of {limit.total} {'nodes' if limit.kind in _AT_NODES else 'steps'}"
    if limit.kind == "effort_rms":
        return f"root mean square of {limit.name} at its limit {limit.bound:.6g} {limit.unit}"
    if limit.kind == "duration":
        return f"duration at its {limit.side} bound {limit.bound:.6g} s"
    if limit.kind == "parameter":
        return f"{limit.name} at its {limit.side} bound {limit.bound:.6g} {limit.unit}"
    if limit.kind == "time":
        return f"time of via {limit.name} at its {limit.side} bound {limit.bound:.6g} s"
    if limit.kind == "phase":
        return f"duration of phase {limit.name} at its {limit.side} bound {limit.bound:.6g} s"
    if limit.kind == "way":
        return f"way to {limit.name} in the least time that its steps may have, {limit.bound:.3g} s"
    if limit.kind == "path":
        bound = "" if math.isnan(limit.bound) else f" {limit.bound:.6g} {limit.unit}"
        return f"{where} at its {limit.side} bound{bound} {times}"
    return f"{where} at its {limit.side} limit {limit.bound:.6g} {limit.unit} {times}"


def _clearance(solution: Solution) -> str:
    """How near the robot comes to obstacles, or its links to each other."""
    if math.isnan(solution.clearance):
        return ""
    size = f"{1e3 * abs(solution.clearance):.4g} mm"
    how = size if solution.clearance >= 0.0 else f"{size} in each other"
    nearest = f"{solution.clearance_between} at {solution.clearance_time:.4g} s"
    return f"{how}: {nearest}, of the pairs that are checked"


def _drift(solution: Solution) -> str:
    """How well rotations stay rotations, where there are any."""
    if solution.is_vector_space or math.isnan(solution.manifold_drift):
        return ""
    words = f"{solution.manifold_drift:.2e} at most"
    if not math.isnan(solution.manifold_drift_resimulated):
        words += f"; {solution.manifold_drift_resimulated:.2e} when simulated with the controls"
    return words


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

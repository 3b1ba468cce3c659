"""The problem of a solution, wherever it is read, and what a result keeps of it in plain values."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from mbocp._arrays import Array
from mbocp._files import parse_toml
from mbocp.exceptions import ProblemFileError
from mbocp.problem import Problem, ProblemWarning
from mbocp.problem.file.messages import in_file
from mbocp.problem.file.obstacle_table import obstacles_from
from mbocp.problem.file.overrides import apply_overrides
from mbocp.problem.file.read_tables import read_tables
from mbocp.problem.goals.goal import Goal
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.problem.problem import problem_from_tables
from mbocp.problem.timeline.times import FreeTime
from mbocp.problem.timeline.via import ViaConstraint
from mbocp.robot import Robot, load_stored
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.solution.its_robot import find_held_files, warn_of_changes
from mbocp.solution.problem_facts import (
    BrakingPlace,
    Facts,
    ParameterValue,
    PathRow,
    PhasePlace,
    ViaPlace,
)
from mbocp.solution.solution_data import SolutionData
from mbocp.terms import OwnTerm
from mbocp.terms.braking import Braking
from mbocp.terms.over_speed import place_of
from mbocp.terms.rates import RATE_TERMS


def problem_of(
    solution: SolutionData,
    load_robot: Callable[[], Robot],
    overrides: Mapping[str, Any] | Sequence[str] = (),
    terms: Sequence[OwnTerm] = (),
) -> Problem:
    """Make the problem that was solved, see `Solution.load_problem`."""
    document = _document(solution)
    tables = apply_overrides(document, overrides)
    robot = _robot_in(solution, load_robot, document, tables)
    return problem_from_tables(
        tables, robot=robot, label=_label(solution), name=solution.problem_name, terms=terms
    )


class ProblemPicture(NamedTuple):
    """What pictures show of a problem.

    Attributes
    ----------
    problem : Problem
        Without terms of one's own, which no text holds; and of a result from a file without clearances, for
        which links would have to be covered with spheres.
    obstacles : tuple of Obstacle
    """

    problem: Problem
    obstacles: tuple[Obstacle, ...]


def problem_to_show(solution: SolutionData, load_robot: Callable[[], Robot]) -> ProblemPicture:
    """Make what pictures show of the problem that was solved."""
    problem = problem_without(solution, load_robot, "terms", "obstacle", "self_collision")
    with in_file(_label(solution)):
        tables = read_tables(_document(solution), _label(solution))
        return ProblemPicture(problem, obstacles_from(tables["obstacle"]))


def problem_to_check(solution: SolutionData, load_robot: Callable[[], Robot]) -> Problem:
    """Return the problem that was solved, with its steps; of a file, without terms of one's own."""
    solved: Problem | None = vars(solution).get("problem")
    found = problem_without(solution, load_robot, "terms") if solved is None else solved
    return found.with_steps_at(solution.t)


def facts_of_text(solution: SolutionData, load_robot: Callable[[], Robot]) -> Facts:
    """Return the facts of a result that keeps none: those of its problem without terms of one's own."""
    return facts_of(problem_without(solution, load_robot, "terms").member(solution.goal_place))


def problem_without(solution: SolutionData, load_robot: Callable[[], Robot], *keys: str) -> Problem:
    """Make the problem that was solved without some of its tables."""
    tables = {key: table for key, table in _document(solution).items() if key not in keys}
    robot = load_robot() if solution.robot_spec else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ProblemWarning)  # said when it was solved
        return problem_from_tables(tables, robot=robot, label=_label(solution), name=solution.problem_name)


def _label(solution: SolutionData) -> str:
    return f"the problem of {solution.problem_name or 'a result'}"


def _document(solution: SolutionData) -> Mapping[str, Any]:
    with ProblemFileError.where_unreadable(_label(solution)):
        return parse_toml(solution.problem_text)


def _robot_in(
    solution: SolutionData,
    load_robot: Callable[[], Robot],
    document: Mapping[str, Any],
    tables: Mapping[str, Any],
) -> Robot | None:
    """The robot of changed tables; None if it is no longer that of the solution."""
    was, now = (
        {"name": entry} if isinstance(entry, str) else dict(entry)
        for entry in (document.get("robot", {}), tables.get("robot", {}))
    )
    if was == now and solution.robot_spec:
        return load_robot()
    files = find_held_files(solution)
    is_other = any(was.get(key) != now.get(key) for key in ("name", "part"))
    if files is None or is_other:
        return None
    warn_of_changes(files)
    return load_stored(files, now)


def facts_of(problem: Problem) -> Facts:
    """Return what a result keeps of a problem in plain values; of several goals the problem of one."""
    widest, before, after = problem.widest_limits, problem.u_before, problem.u_after
    rates = {key: (f"{term.letter}_lower", f"{term.letter}_upper") for key, term in RATE_TERMS.items()}
    return Facts(
        duration_range=problem.duration_range,
        via=tuple(_via_place(constraint) for constraint in problem.timeline.waypoints),
        phases=tuple(
            PhasePlace(phase.name, phase.first, phase.last, *phase.sides, phase.leaps, phase.parts)
            for phase in problem.phase
        ),
        path=tuple(row for constraint in problem.path for row in _rows(problem, constraint)),
        rates={
            key: (_plain(getattr(widest, lower)), _plain(getattr(widest, upper)))
            for key, (lower, upper) in rates.items()
            if RATE_TERMS[key].letter in widest.letters
        },
        along=_limits_along(problem),
        ties=problem.robot.nc,
        held=tuple(sorted({hold.hold.name for phase in problem.phase for hold in phase.holds})),
        contacts=tuple(sorted({bounds.contact.constraint for bounds in problem.contacts})),
        a_start=_plain(problem.a_start),
        u_start=() if before is None else _plain(before),
        u_goal=() if after is None or isinstance(after, str) else _plain(after),
        q_goal=_goal_coordinates(problem.goal),
        braking=tuple(_find_braking_places(problem)),
        ends_held=isinstance(after, str),
        effort_rms=_plain(problem.limits.rms_upper) if problem.limits.finite("rms").any() else (),
        parameters=tuple(
            ParameterValue(one.name, one.start, one.unit, one.lower, one.upper, one.multiplier)
            for one in problem.parameter
        ),
        elastic={joint.name: joint.motor for joint in problem.robot.elastic},
    )


def _via_place(constraint: ViaConstraint) -> ViaPlace:
    time = constraint.via.time
    bounds = time if isinstance(time, FreeTime) else FreeTime()
    return ViaPlace(
        constraint.via.name, constraint.node, constraint.via.is_free, bounds.earliest, bounds.latest
    )


def _rows(problem: Problem, constraint: Any) -> list[PathRow]:
    """Rows of a path constraint; of clearances without what they keep beyond their margins."""
    asked = constraint
    if isinstance(constraint, Clearance) and constraint.reserve is not None:
        asked = constraint.of_pairs(constraint.chosen)
    total = int(np.count_nonzero(constraint.span.nodes(problem.num_steps, problem.dt)))
    sides = zip(constraint.labels, asked.lower, asked.upper, strict=True)
    return [PathRow(label.name, float(low), float(high), label.unit, total) for label, low, high in sides]


def _goal_coordinates(goal: Goal) -> tuple[bool, ...]:
    """Which coordinates end where a goal says; empty where all do."""
    says_all = goal.q_active.all() or goal.frames or goal.periodic is not None
    return () if says_all else tuple(goal.q_active.tolist())


def _find_braking_places(problem: Problem) -> Iterator[BrakingPlace]:
    for path in problem.frame_constraints:
        if path.kind == Braking.kind and path.span.nodes(problem.num_steps, problem.dt).all():
            joint = problem.robot.v_labels[place_of(path.frame, problem.robot)].name
            numbers = (float(path.number(key)[0]) for key in ("deceleration", "reserve"))
            yield BrakingPlace(joint, max(path.lower), min(path.upper), *numbers)


def _limits_along(problem: Problem) -> dict[str, Any]:
    """Limits that differ from phase to phase."""
    if not problem.has_limits_of_phases:
        return {}
    return {
        letter: tuple(tuple(_plain(row) for row in side) for side in sides)
        for letter, sides in problem.limits_along().items()
        if letter in ("u", "v", "q") and any(phase.limits.finite(letter).any() for phase in problem.phase)
    }


def _plain(values: Array) -> tuple[float, ...]:
    return tuple(np.asarray(values, dtype=np.float64).tolist())

"""From what a solver has come to, to a solution: trajectories, status, advice, provenance."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import cache, partial
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp import __version__
from mbocp._arrays import Array, dataclass, frozen_array
from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.formulation import Formulation, Motion
from mbocp.formulation.end_reached import describe_opening, miss_of_rates, miss_of_vias, vias_at_once
from mbocp.formulation.features.free_contacts import describe_free_contacts
from mbocp.formulation.gains import feedback_gains
from mbocp.formulation.iterates import place_iterate, with_robot_of
from mbocp.formulation.read_trajectory import (
    describe_coarse_turn,
    describe_idle_parameters,
    describe_light_joints,
    describe_light_time,
    describe_sensitive_time,
    measures_of,
    read_trajectory,
    times_of,
)
from mbocp.formulation.wrong_steps import describe_wrong_step
from mbocp.mechanics.symmetries import find_symmetries, momentum_name
from mbocp.problem import Problem
from mbocp.problem.between_nodes import LimitExcess, is_followed, largest_excess
from mbocp.problem.file.tables import problem_to_toml
from mbocp.problem.obstacles.approach import Approach, keeps_clear, nearest_approach
from mbocp.programme import Iterate
from mbocp.programme.iterate import IterateRecord
from mbocp.robot import Robot, singular_closure
from mbocp.solution.details import Accuracy, Labels, StartRecord
from mbocp.solution.goal_error import goal_error
from mbocp.solution.its_problem import facts_of
from mbocp.solution.later import defer
from mbocp.solution.solution import Solution
from mbocp.solvers import Outcome, Phase, SolverResult, Status
from mbocp.solvers.records import time_phase


@dataclass(frozen=True, eq=False)
class Attempt:
    """What a solver came to, before anything is read from it.

    Attributes
    ----------
    formulation : Formulation
    outcome : Outcome
    phases : tuple of Phase
    guess_used, left_out : str
        Words for the guess, and for end conditions that were left out.
    begun : float
        Time of `time.perf_counter` at which it began.
    starts : tuple of StartRecord
        What each start came to, where there were several.
    """

    formulation: Formulation
    outcome: Outcome
    phases: tuple[Phase, ...]
    guess_used: str
    left_out: str
    begun: float
    starts: tuple[StartRecord, ...] = ()

    @property
    def is_converged(self) -> bool:
        """Whether the solver says so."""
        return self.outcome.result.status is Status.CONVERGED

    @property
    def carried(self) -> IterateRecord:
        """Where a problem of other path constraints may begin."""
        return IterateRecord.of(self.outcome.result.iterate, self.formulation.programme)


def read_solution(attempt: Attempt, asked: Problem, *, with_gains: bool = False) -> Solution:
    """Solution of what was asked for, from what a solver has come to.

    Parameters
    ----------
    attempt : Attempt
    asked : Problem
        That of the formulation, or one of several goals, or of smaller margins.
    with_gains : bool
        Whether to work out the feedback gains.
    """
    outcome, phases = attempt.outcome, list(attempt.phases)
    result = outcome.result
    formulation, asked = _with_robot_of(attempt.formulation, result.iterate, asked)
    problem = formulation.problem
    approach: Approach | None = None
    last = result.record
    with time_phase(phases, "diagnostics"):
        motion = formulation.motion_of(result.iterate)
        t = times_of(problem, motion.dts)
        told = attempt.left_out + _suffix(singular_closure(problem.robot, motion.qs))
        if result.status.is_stationary:
            told += _suffix(describe_sensitive_time(formulation, result.iterate, motion, last.cost))
            told += _suffix(describe_light_time(problem, float(motion.dts.sum()), last.cost))
            told += _suffix(describe_idle_parameters(formulation, result.iterate))
        judged = replace(formulation, problem=_with_limits_of(problem, asked))
        status, advice, excess = judge(judged, motion, t, result.status, result.advice)
        status, advice = _above_ground(formulation, result.iterate, motion, status, advice)
    gains, clearance = np.zeros((0, 0, 0)), asked.clearance
    try:
        if with_gains and result.status.is_stationary:
            with time_phase(phases, "gains"):
                gains = feedback_gains(formulation, result.iterate)
        if clearance is not None:
            with time_phase(phases, "clearance"):
                if not keeps_clear(clearance, t, motion.qs, BOUND_TOLERANCE, motion.vs):
                    approach = nearest_approach(clearance, t, motion.qs, motion.vs)
            status, advice = _tell_contact(approach, status, advice)
    except KeyboardInterrupt:
        words = "interrupted before its gains or clearance were known"
        status, advice = Status.INTERRUPTED, f"{words}; {advice}"
    stored = problem.robot.stored
    now = {
        "status": status,
        "advice": advice + _describe_compiling(problem, result, phases) + told,
        "solver": outcome.solver,
        "iterations": sum(p.iterations for p in phases),
        "limit_excess": _ratio_of(excess, problem),
        "limit_excess_of": "" if excess is None else excess.of,
        "limit_excess_time": math.nan if excess is None else excess.time,
        "cost": float(last.cost),
        "residual": float(last.residual),
        "increment": float(last.increment),
        "unknowns": formulation.programme.num_unknowns,
        "wall_time_s": time.perf_counter() - attempt.begun,
        "phases": tuple(phases),
        "history": result.history,
        "t": frozen_array(t),
        "qs": frozen_array(motion.qs),
        "vs": frozen_array(motion.vs),
        "us": frozen_array(motion.us),
        "eta": result.iterate.eta,
        "gains": frozen_array(gains),
        "u_values": frozen_array(motion.values),
        "u_shares": frozen_array(motion.shares),
        "coordinates": problem.coordinates,
        "problem_name": problem.name,
        "robot_name": problem.robot.name,
        "guess_used": attempt.guess_used,
        "starts": attempt.starts,
        "accuracy": Accuracy(),
        "robot_files": None if stored is None else stored.with_spec(problem.robot.spec),
    }
    if clearance is None or approach is not None:
        now |= _fields(approach)
    now["problem"] = asked
    carried = partial(place_iterate, attempt.formulation, result.iterate)
    rest = partial(_rest, formulation, result.iterate, carried, asked, t, motion)
    alone = measures_of(formulation, result.iterate, motion)
    alone["iterate"] = carried
    alone["facts_kept"] = partial(facts_of, problem)
    return defer(Solution, now, rest, alone)


def _with_limits_of(problem: Problem, asked: Problem) -> Problem:
    """A problem that may have lower limits at nodes, with those that were asked for."""
    pairs = zip(problem.timeline.phases, asked.timeline.phases, strict=True)
    phases = tuple(replace(own, limits=said.limits) for own, said in pairs)
    return replace(problem, limits=asked.limits, timeline=replace(problem.timeline, phases=phases))


def _with_robot_of(formulation: Formulation, iterate: Iterate, asked: Problem) -> tuple[Formulation, Problem]:
    """Formulation and problem with the robot that was found."""
    if not asked.parameter:
        return formulation, asked
    motion = formulation.motion_of(iterate)
    problem = with_robot_of(formulation, motion).problem
    if iterate.bounds is not None:
        multipliers = iterate.bounds.us[0, formulation.layout.controls["found"]].tolist()
        pairs = zip(problem.parameter, multipliers, strict=True)
        found = tuple(replace(one, multiplier=m / (one.upper - one.lower)) for one, m in pairs)
        problem = replace(problem, parameter=found)
    begin = asked.q_start if asked.start_free is None else motion.qs[0]
    told = replace(asked, robot=problem.robot, parameter=problem.parameter, q_start=begin)
    return replace(formulation, problem=problem), told


def judge(
    formulation: Formulation, motion: Motion, t: Array, status: Status, advice: str
) -> tuple[Status, str, LimitExcess | None]:
    """Status and advice of a motion that a solver has found, and its largest excess of a limit between nodes.

    A motion is not solved where a joint turns too far in one step, it ends with other velocities than those
    that were asked for, or leaves a limit between nodes by far.

    Parameters
    ----------
    formulation : Formulation
    motion : Motion
    t : ndarray, shape (N + 1,)
        Times of its nodes [s].
    status, advice : Status, str
        The solver's.
    """
    status, advice = _resolution(formulation, replace(motion, dts=np.diff(t)), status, advice)
    status, advice = _at_goal(formulation, motion, status, advice)
    us = motion.values if motion.shares else motion.us
    excess = largest_excess(formulation.problem, t, motion.qs, motion.vs, us, motion.shares)
    light = _light_joints(formulation.problem, motion, t, excess)
    status, advice = _within_limits(excess, status, advice, light, varies=bool(motion.shares))
    at_once = vias_at_once(formulation.problem, t)
    both = (advice, at_once) if status is Status.CONVERGED else (at_once, advice)
    return status, "; ".join(filter(None, both)), excess


def _rest(
    formulation: Formulation,
    iterate: Iterate,
    carried: Callable[[], IterateRecord],
    asked: Problem,
    t: Array,
    motion: Motion,
) -> dict[str, Any]:
    """Fields of a solution that nobody needs to solve the next problem.

    Of a motion that keeps clear of everything, the nearest approach is among them.
    """
    problem = formulation.problem
    robot, clearance = problem.robot, asked.clearance
    diagnostics = read_trajectory(formulation, iterate)
    found = diagnostics.fields()
    return {
        **found,
        "goal_error": goal_error(problem, replace(motion, dts=np.diff(t)), found["ps"]),
        "iterate": carried(),
        **_fields(None if clearance is None else nearest_approach(clearance, t, motion.qs, motion.vs)),
        "control_momentum_meanings": _meanings(robot, diagnostics.control_momentum_names),
        "robot_spec": dict(robot.spec),
        "problem_text": problem_to_toml(asked),
        "facts_kept": facts_of(problem),
        **asked.limits.fields,
        "scheme": asked.scheme,
        "lie": asked.lie,
        "substeps": asked.substeps,
        "rotations": robot.rotations,
        "options": asdict(problem.solver),
        "versions": dict(_versions()),
        "labels": Labels.of_robot(robot, formulation.constraint_labels),
    }


def _meanings(robot: Robot, names: tuple[str, ...]) -> tuple[str, ...]:
    """What the control momenta of the named symmetries are, in words."""
    if not names:
        return ()
    words = {s.name: momentum_name(s, robot) for s in find_symmetries(robot)}
    return tuple(words[name] for name in names)


def _describe_compiling(problem: Problem, result: SolverResult, phases: list[Phase]) -> str:
    """Say where compiling took most of the time that a solve had."""
    limit = problem.solver.time_limit
    seconds = sum(phase.wall_time_s for phase in phases if phase.name == "compile")
    if limit is None or result.status is not Status.TIME_LIMIT or seconds < limit / 2:
        return ""
    return f"; compiling took {seconds:.1f} s of it, which the next run of this shape is spared"


def _suffix(words: str | None) -> str:
    return f"; {words}" if words else ""


def _resolution(formulation: Formulation, motion: Motion, status: Status, advice: str) -> tuple[Status, str]:
    """Status and advice of what is no motion where a joint turns too far in one step, or a step is wrong."""
    words = describe_coarse_turn(formulation, motion)
    if words is None:
        wrong, is_gross = describe_wrong_step(formulation.problem, motion)
        if is_gross and status is Status.CONVERGED:
            return Status.UNDER_RESOLVED, f"{wrong}; the optimality conditions hold: {advice}"
        return status, advice + _suffix(wrong)
    weight = "a larger weight" if np.any(formulation.problem.cost.velocity) else 'a weight ("auto")'
    remedy = f"take more steps, or give cost.velocity {weight}"
    if status is not Status.CONVERGED:
        return status, f"{advice}; {words}: {remedy}"
    return Status.UNDER_RESOLVED, f"{words}: {remedy}; the optimality conditions hold: {advice}"


def _at_goal(formulation: Formulation, motion: Motion, status: Status, advice: str) -> tuple[Status, str]:
    """Status and advice of a motion that leaves closed loops, or ends with other velocities than asked."""
    if status is not Status.CONVERGED:
        return status, advice
    (opening, _), (at_via, _) = found = (
        describe_opening(formulation, motion),
        miss_of_vias(formulation, motion),
    )
    for words, is_gross in found:
        if is_gross:
            return Status.UNDER_RESOLVED, f"{words}; the optimality conditions hold: {advice}"
    missed = miss_of_rates(formulation, motion)
    gross = missed and miss_of_rates(formulation, motion, is_strict=False)
    if gross is not None:
        status = Status.OTHER_ROOT if gross.is_free else Status.UNDER_RESOLVED
        return status, f"{gross.words}; the optimality conditions hold: {advice}"
    return status, advice + _suffix(opening or (missed and missed.words)) + _suffix(at_via)


def _above_ground(
    formulation: Formulation, iterate: Iterate, motion: Motion, status: Status, advice: str
) -> tuple[Status, str]:
    """Status and advice of a motion whose feet may leave the ground, and are in it between its nodes."""
    if not status.is_stationary:
        return status, advice
    words, is_gross = describe_free_contacts(formulation.problem, formulation.layout, iterate.xs, motion.qs)
    if is_gross and status is Status.CONVERGED:
        return Status.UNDER_RESOLVED, f"{words}: take more steps; the optimality conditions hold: {advice}"
    return status, advice + _suffix(words)


def _ratio_of(excess: LimitExcess | None, problem: Problem) -> float:
    """Part of a limit; NaN where nobody has looked between nodes."""
    if excess is not None:
        return excess.ratio
    return 0.0 if is_followed(problem) else math.nan


def _light_joints(problem: Problem, motion: Motion, t: Array, excess: LimitExcess | None) -> str:
    """What is said of joints that leave a limit of speed because they have nothing to turn; "" of others."""
    if excess is None or not excess.is_gross or excess.kind != "speed":
        return ""
    node = max(int(np.searchsorted(t, excess.time)) - 1, 0)
    words = describe_light_joints(problem.robot, motion.qs[node], excess.name)
    return "" if words is None else f"{words}: with that of rotors, [[robot.motor]], steps resolve more"


def _within_limits(
    excess: LimitExcess | None, status: Status, advice: str, light: str, *, varies: bool
) -> tuple[Status, str]:
    """Status and advice of a motion that leaves a limit between its nodes by more than drives put up with."""
    if status is Status.MAX_ITERATIONS and light:  # costs then hardly tell one motion from the next
        return status, f"{advice}; {light}"
    if excess is None or not excess.is_gross or status is not Status.CONVERGED:
        return status, advice
    remedy = "take more steps" + (", or controls that are constant in each" if varies else "")
    remedy += _suffix(light or None)
    return Status.UNDER_RESOLVED, f"{excess.words}: {remedy}; the optimality conditions hold: {advice}"


def _fields(approach: Approach | None) -> dict[str, Any]:
    """Fields of a solution."""
    if approach is None:
        return {"clearance": math.nan, "clearance_between": "", "clearance_time": math.nan}
    return {
        "clearance": float(approach.distance),
        "clearance_between": approach.between,
        "clearance_time": float(approach.time),
    }


def _tell_contact(approach: Approach | None, status: Status, advice: str) -> tuple[Status, str]:
    """Status and advice of a motion that touches something between its nodes, or comes nearer than it may."""
    if approach is None or approach.distance - approach.margin >= -BOUND_TOLERANCE:
        return status, advice
    if status is not Status.CONVERGED:
        return status, f"{advice}; {approach.words}"
    remedy = "take more steps, or a larger margin"
    if approach.distance >= 0.0:
        return status, f"{advice}; between nodes {approach.words}, less than its margin: {remedy}"
    return Status.UNDER_RESOLVED, f"between nodes {approach.words}: {remedy}; at the nodes: {advice}"


@cache
def _versions() -> Mapping[str, str]:
    packages = {"pin": pin.__version__, "casadi": ca.CasadiMeta.version(), "numpy": np.__version__}
    return {"mbocp": __version__, "python": platform.python_version(), **packages}

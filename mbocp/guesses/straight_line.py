"""Guesses on the straight line from start to goal in the configuration space, or on lines by via points."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, dataclass, null_space
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.formulation import Formulation, Motion
from mbocp.formulation.features.changing_constraints import fill_lengths, repeat_at_impacts
from mbocp.guesses.along import balances, is_led, usual_way
from mbocp.guesses.held_stops import carry, carry_rate, make_held_stops
from mbocp.guesses.stop import Stop
from mbocp.guesses.ways import Way
from mbocp.mechanisms.closed_path import find_closed_path
from mbocp.mechanisms.consistent_states import project_on_constraints, tangent_space
from mbocp.problem import Problem
from mbocp.programme import Iterate
from mbocp.robot import Robot
from mbocp.robot.kinematics import difference
from mbocp.robot.nodes import steps_between

_NUDGE = 0.1  # [m/s, rad/s, m/s^2, rad/s^2] on drives, see `drive_line`
_NO_SPEED = 1e-9  # [m/s, rad/s] of what may not move at all
_TOO_SHORT = 2.5  # times as long as guessed; the fastest motion takes 0.5 to 0.8 of what the line takes
_NEARLY = 0.75  # of a longer time: less is the guess before
_SAYS_ENOUGH = 1e-6  # part that written joints have in every motion that the constraints allow


def is_whole(problem: Problem) -> bool:
    """Whether goal.q is a whole end: given in full, or constraints or frames say the rest."""
    active = problem.goal.q_active
    if problem.goal.poses and problem.goal.enforce != "none":  # goal.q is where they are
        return True
    if problem.goal.periodic is not None:  # goal.q is the image of the start
        return True
    if active.all() or not active.any():
        return bool(active.all())
    allowed = _free_motions(problem)
    singular = np.linalg.svd(allowed[active], compute_uv=False)
    return len(singular) >= allowed.shape[1] and bool(
        singular[: allowed.shape[1]].min(initial=1.0) > _SAYS_ENOUGH
    )


def _free_motions(problem: Problem) -> Array:
    """Basis of the motions that constraints, and what is held, allow at the goal, shape (nv, any)."""
    if problem.timeline.switches is None:
        return tangent_space(problem.robot, problem.goal.q)
    table = problem.timeline.switches  # a place that is found counts: what is let go stays there
    return null_space(table.in_step(problem.goal.q, table.last_timed_step), RANK_TOLERANCE)


def may_take_longer(problem: Problem, times: float) -> bool:
    """Whether a line may take so many times as long, or nearly; past what moves it is one by the time."""
    clearance = problem.clearance
    if problem.robot.drives or (clearance is not None and clearance.movers):
        return False
    dts = problem.timeline.lengths()
    return bool(_stretch(problem, dts, times).sum() > _NEARLY * times * dts.sum())


def _stretch(problem: Problem, dts: Array, times: float) -> Array:
    """Lengths of the steps so many times as long where they are free, as far as they may be."""
    timeline = problem.timeline
    times = min(times, timeline.junctions[-1].latest / dts.sum())
    longer = dts.copy()
    for phase in timeline.free_phases:
        longer[phase.first : phase.last] *= max(1.0, min(times, timeline.sides_of(phase)[1] / phase.duration))
    return longer


def line(
    formulation: Formulation, way: Way | None = None, deadline: float = math.inf, times: float = 1.0
) -> Iterate:
    """Straight line from start to goal, or another way, with the controls that this takes.

    Where the duration is free and its guess too short for limits of rates, it takes longer; `times` as long
    where that is asked for.
    """
    problem = formulation.problem
    dts = _stretch(problem, problem.timeline.lengths(), times)
    qs, vs = _line_states(formulation, way, dts)
    if (slower := _slower(problem, vs, dts, is_straight=way is None)) > 1.0:
        dts = slower * dts
        qs, vs = _line_states(formulation, way, dts)
    accelerations = np.diff(vs, axis=0) / fill_lengths(problem, dts)[:, None]
    points = formulation.evaluation_points(qs, vs, dts)
    us, lams = balances(problem.robot, *points, accelerations, problem.timeline.switches, deadline)
    return formulation.iterate_of(Motion(qs, vs, us, dts), lams)


def drive_line(formulation: Formulation, way: Way | None = None) -> Iterate:
    """Configurations on the line, or another way, at a steady rate, with the velocities that go with it.

    Where controls prescribe velocities, a line is seldom a motion. A little of every drive's speed and
    control breaks the symmetry of tasks whose goal is where they start.
    """
    problem = formulation.problem
    robot, N, dts = problem.robot, problem.num_steps, problem.timeline.lengths()
    qs = _evenly(problem, way)
    rate = steps_between(robot, qs) / dts[:, None]
    us = np.zeros((N, robot.nu))
    us[:, robot.nu - len(robot.drives) :] = _NUDGE
    motion = Motion(qs, np.vstack([rate, rate[-1]]), us, dts)
    iterate = formulation.iterate_of(motion, np.zeros((N, robot.nc)))
    xs = np.array(iterate.xs)
    num_free = robot.nv - len(robot.driven)
    xs[1:, formulation.layout.s][:, num_free:] += _NUDGE
    return replace(iterate, xs=xs)


def at_rest(formulation: Formulation) -> Iterate:
    """Configurations on the line, every velocity and control zero: agrees with no kinematics, on purpose."""
    problem = formulation.problem
    robot, N = problem.robot, problem.num_steps
    qs = _evenly(problem)
    still, us = np.zeros((N + 1, robot.nv)), np.zeros((N, robot.nu))
    return formulation.iterate_of(Motion(qs, still, us, problem.timeline.lengths()), np.zeros((N, robot.nc)))


def _evenly(problem: Problem, way: Way | None = None) -> Array:
    """Configurations on a way, or on straight lines through the via points, at a steady rate."""
    times = guess_times(problem)
    if _has_stops(problem) and way is None:
        return carry(problem, line_of(problem, problem.q_start, _end(problem)).evenly(times))
    return carry(
        problem, (way or usual_way(problem))(problem.q_start, times / problem.timeline.num_timed_steps)
    )


def _has_stops(problem: Problem) -> bool:
    """Whether a line goes through more than the start and the end."""
    return bool(problem.timeline.waypoints) or (problem.timeline.switches is not None and not is_led(problem))


def _end(problem: Problem) -> Array:
    """Where the line ends: at the goal, or at the last via point where the goal leaves the end open."""
    if problem.via and not (problem.goal.q_active.any() or is_whole(problem)):
        return problem.via[-1].goal.q
    return problem.goal.q


def _slower(problem: Problem, vs: Array, dts: Array, is_straight: bool) -> float:
    """How many times as long a motion has to take to keep limits of its rates, if it may; 1 at least.

    A straight line keeps those of speeds, accelerations and jerks, or has the time of the guess where that is
    not far too short; other ways, and lines with impacts, keep those of speeds alone.
    """
    phases, clearance = problem.timeline.phases, problem.clearance
    has_movers = clearance is not None and bool(clearance.movers)  # a way past these is one by the time
    if len(phases) > 1 or not phases[0].is_free or has_movers:
        return 1.0
    limits, rates, slower = problem.widest_limits, vs, 1.0
    sides = (
        (limits.v_lower, limits.v_upper),
        (limits.a_lower, limits.a_upper),
        (limits.j_lower, limits.j_upper),
    )
    is_smooth = is_straight and not problem.timeline.impacts
    for order, (lower, upper) in enumerate(sides[: 3 if is_smooth else 1], start=1):
        over = np.maximum(rates / np.maximum(upper, _NO_SPEED), rates / np.minimum(lower, -_NO_SPEED))
        slower = max(slower, float(over.max(initial=1.0)) ** (1.0 / order))
        rates = np.diff(rates, axis=0) / fill_lengths(problem, dts)[: len(rates) - 1, None]
    if is_straight and slower < _TOO_SHORT:
        return 1.0
    return min(slower, problem.timeline.sides_of(phases[0])[1] / problem.duration)


def _line_states(formulation: Formulation, way: Way | None, dts: Array) -> tuple[Array, Array]:
    """Nodes on the way from start to goal, with velocities that the scheme's kinematics ask for."""
    problem = formulation.problem
    robot, N, dts = problem.robot, problem.num_steps, fill_lengths(problem, dts)
    is_impact, T = problem.timeline.is_impact, problem.timeline.num_timed_steps
    tau, v_start = formulation.tau, formulation.start_velocity
    model, q_start = robot.model, problem.q_start
    times = guess_times(problem)
    s = times / T
    if tau == 0.0:  # the first step goes where the start velocity says, whatever the controls
        s = np.append(0.0, (times[1:] - times[1]) / (N - times[1]) if N > 1 else 1.0)
        q_start = pin.integrate(model, q_start, dts[0] * v_start)
    blend = s**3 * (10 - 15 * s + 6 * s**2)  # from rest to rest, with zero acceleration at the ends
    if _has_stops(problem) and way is None:
        first = int(tau == 0.0 and N > 1)
        qs = line_of(problem, q_start, _end(problem), first).smoothly(np.maximum(times, times[first]))
    else:
        qs = (way or usual_way(problem))(q_start, blend)
    qs[0] = problem.q_start
    qs = carry(problem, qs)
    steps = steps_between(robot, qs) / dts[:, None]
    steps = repeat_at_impacts(steps, is_impact)
    if tau == 1.0:
        vs = np.vstack([v_start, steps])
        for step in problem.timeline.impacts:
            vs[step + 1] = carry_rate(problem, qs[step + 1], vs[step], step)
        return qs, vs
    if tau == 0.0:
        return qs, np.vstack([v_start, steps[1:], np.zeros(robot.nv)])
    # From rest: beginning with the start velocity they would swing about the line's. Their means are rates.
    if way is not None and not robot.nc:
        qs = _without_corners(robot, qs)
        steps = repeat_at_impacts(steps_between(robot, qs) / dts[:, None], is_impact)
    vs = np.zeros((N + 1, robot.nv))
    firsts = [0, *(step + 1 for step in problem.timeline.impacts)]
    for first, end in zip(firsts, [*firsts[1:], N + 1], strict=True):
        if first:
            vs[first] = _after(problem, qs, steps, first - 1)
        signs = np.where(np.arange(end - 1 - first) % 2, -1.0, 1.0)[:, None]
        vs[first + 1 : end] = signs * (2 * np.cumsum(signs * steps[first : end - 1], axis=0) - vs[first])
    vs[0] = v_start
    return qs, vs


def _without_corners(robot: Robot, qs: Array) -> Array:
    """Nodes of which each is drawn halfway to the middle of its neighbours.

    Velocities whose means are the rates of the steps swing for ever after a corner. With the weights 1/4, 1/2
    and 1/4 they are the mean rates of two steps, without a swing.
    """
    ahead = steps_between(robot, qs) / 4.0
    inner = [robot.integrate(q, step) for q, step in zip(qs[1:-1], ahead[1:] - ahead[:-1], strict=True)]
    return np.vstack([qs[:1], *inner, qs[-1:]])


def _after(problem: Problem, qs: Array, steps: Array, n: int) -> Array:
    """Velocity after an impact: that of the steps which follow, at their beginning, along what is held."""
    timed = [k for k in range(n + 1, len(steps)) if not problem.timeline.is_impact[k]][:2]
    if not timed:
        return carry_rate(problem, qs[n + 1], steps[n], n)
    ahead = steps[timed[0]] + (steps[timed[0]] - steps[timed[-1]]) / 2.0
    return carry_rate(problem, qs[n + 1], ahead, n)


@dataclass(frozen=True, eq=False)
class JointLine:
    """Configurations at some times, and velocities with which the motion goes through them.

    Attributes
    ----------
    robot : Robot
    times : ndarray, shape (k,)
        In mean steps, rising: numbers of nodes, where steps are as long as each other.
    qs : ndarray, shape (k, nq)
    vs : ndarray, shape (k, nv)
        In units of a tangent vector per mean step; zero at both ends.
    has_loops : ndarray of bool, shape (k - 1,)
        Whether all loops of the robot are closed from one to the next.
    """

    robot: Robot
    times: Array
    qs: Array
    vs: Array
    has_loops: BoolArray

    def evenly(self, at: Array) -> Array:
        """Configurations on straight lines from one to the next, at times, shape (m, nq)."""
        return self._legs(at, is_smooth=False)

    def smoothly(self, at: Array) -> Array:
        """Configurations at times, from rest to rest with continuous velocities, shape (m, nq).

        Each leg is a quintic of De Casteljau's construction with geodesics in place of lines, without
        acceleration at its ends. Closed loops stop at every via point.
        """
        return self._legs(at, is_smooth=True)

    def _legs(self, at: Array, *, is_smooth: bool) -> Array:
        found = np.empty((len(at), self.robot.nq))
        leg_of = np.clip(np.searchsorted(self.times, at, side="right") - 1, 0, len(self.times) - 2)
        for leg in range(len(self.times) - 1):
            mine = leg_of == leg
            if mine.any():
                first, last = self.times[leg], self.times[leg + 1]
                found[mine] = self._leg(leg, (at[mine] - first) / (last - first), is_smooth)
        return found

    def _leg(self, leg: int, s: Array, is_smooth: bool) -> Array:
        robot, (q0, q1) = self.robot, self.qs[leg : leg + 2]
        has_loops = bool(self.has_loops[leg])
        blend = s**3 * (10 - 15 * s + 6 * s**2) if is_smooth else s
        every = np.arange(robot.nv)
        if has_loops:
            way = find_closed_path(robot, project_on_constraints(robot, q0, every), q1, blend)
            if way is not None:
                return way
        moves = is_smooth and not has_loops and self.vs[leg : leg + 2].any()
        if not moves:
            qs = np.array([pin.interpolate(robot.model, q0, q1, x) for x in blend])
            return np.array([project_on_constraints(robot, q, every) for q in qs]) if has_loops else qs
        v0, v1 = (self.times[leg + 1] - self.times[leg]) * self.vs[leg : leg + 2]
        steps = np.array([0.0, 0.2, 0.4])
        corners = [robot.integrate(q0, a * v0) for a in steps]
        corners += [robot.integrate(q1, -a * v1) for a in steps[::-1]]
        return np.array([_de_casteljau(robot.model, corners, x) for x in s])


def line_of(problem: Problem, q_first: Array, q_end: Array, first: int = 0) -> JointLine:
    """From a configuration at the node `first` through the via points to the end.

    Where something is held, it is held at all of them, see `mbocp.guesses.held_stops`.
    """
    robot, N = problem.robot, problem.num_steps
    points = [point for point in problem.timeline.waypoints if first < point.node < N]
    clock = guess_times(problem)
    between = [Stop(point.node, point.via.goal.q, point.via.goal) for point in points]
    stops = make_held_stops(problem, [Stop(first, q_first), *between, Stop(N, q_end, problem.goal)], clock)
    nodes = [stop.node for stop in stops]
    times, qs = clock[nodes], np.array([stop.q for stop in stops])
    vs = np.zeros((len(times), robot.nv))
    for k, stop in enumerate(stops[1:-1], start=1):
        before, after = times[k] - times[k - 1], times[k + 1] - times[k]
        rate_before = -difference(robot.model, qs[k], qs[k - 1]) / before
        rate_after = difference(robot.model, qs[k], qs[k + 1]) / after
        vs[k] = (after * rate_before + before * rate_after) / (before + after)
        if stop.goal is not None:
            asked = stop.goal.rate_active
            vs[k][asked] = problem.dt * stop.goal.value[asked]
    return JointLine(robot, times, qs, vs, _has_loops(problem, nodes))


def _has_loops(problem: Problem, nodes: Sequence[int]) -> BoolArray:
    """Whether all loops of the robot are closed between a node and the next."""
    table = problem.timeline.switches
    legs = pairwise(nodes)
    acts = [table is None or bool(table.own[first:last].all()) for first, last in legs]
    return np.array(acts, dtype=np.bool_) & (problem.robot.nc > 0)


def guess_times(problem: Problem) -> Array:
    """Times of the nodes in mean steps, shape (N + 1,): their numbers, where all steps are equal."""
    timeline = problem.timeline
    if timeline.is_even and not timeline.impacts:
        return np.arange(problem.num_steps + 1.0)
    times: Array = timeline.times() / problem.dt
    times[-1] = timeline.num_timed_steps
    return times


def _de_casteljau(model: pin.Model, corners: list[Array], s: float) -> Array:
    while len(corners) > 1:
        corners = [pin.interpolate(model, a, b, s) for a, b in pairwise(corners)]
    return corners[0]

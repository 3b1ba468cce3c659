"""The line of a guess through via points: pieces from the start to the end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray
from mbocp.guesses.held import Stop, held_stops
from mbocp.mechanisms.closed_path import closed_path
from mbocp.mechanisms.consistent_states import project_on_constraints
from mbocp.problem import Problem
from mbocp.robot import Robot
from mbocp.robot.kinematics import difference


@dataclass(frozen=True, eq=False)
class Line:
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
            way = closed_path(robot, project_on_constraints(robot, q0, every), q1, blend)
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


def line_of(problem: Problem, q_first: Array, q_end: Array, first: int = 0) -> Line:
    """From a configuration at the node `first` through the via points to the end.

    Where something is held, it is held at all of them, see `mbocp.guesses.held`.
    """
    robot, N = problem.robot, problem.num_steps
    points = [point for point in problem.timeline.waypoints if first < point.node < N]
    clock = guessed_times(problem)
    between = [Stop(point.node, point.via.goal.q, point.via.goal) for point in points]
    stops = held_stops(problem, [Stop(first, q_first), *between, Stop(N, q_end, problem.goal)], clock)
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
    return Line(robot, times, qs, vs, _has_loops(problem, nodes))


def _has_loops(problem: Problem, nodes: Sequence[int]) -> BoolArray:
    """Whether all loops of the robot are closed between a node and the next."""
    table = problem.timeline.switches
    legs = pairwise(nodes)
    acts = [table is None or bool(table.own[first:last].all()) for first, last in legs]
    return np.array(acts, dtype=np.bool_) & (problem.robot.nc > 0)


def guessed_times(problem: Problem) -> Array:
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

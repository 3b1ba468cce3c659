r"""Guesses in which what is held stays held, and goes on from where it was let go.

First the *stops* are made to fit, one after the other: the nodes of via points, those where something is
taken on, and the end. There the joints that were written and the poses that are asked for hold, what is held
is where it was when its hold began, and frames that are to coincide do,

.. math:: g(q_k) = 0, \qquad \Phi(q_k; q_a) = 0, \qquad a \text{ the node where the hold began},

so that the arm goes where the box is wanted that it holds. What nobody asks for stays where it was at the
stop before. Then lines join the stops, and the nodes on them are put on the holds: by joints without motors
first, so that a free body follows the frame that holds it, and by the shortest step of all joints in the norm
of the mass matrix where these do not suffice, or where the body is one that legs carry: it moves on while
feet stand, but for those from which it jumps.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import groupby

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp.guesses.footholds import Landing, footholds, takeoffs
from mbocp.guesses.stop import Stop, first_of, instant
from mbocp.guesses.ties import Ties, tie_key, with_joints
from mbocp.guesses.ways import position_limits
from mbocp.problem import Goal, Problem
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.robot import Robot
from mbocp.robot.loops.projection import components
from mbocp.robot.poses.pose_rows import CLOSURE_WEIGHT, PoseRows
from mbocp.robot.poses.pose_search import JointBounds, joint_bounds, reach
from mbocp.robot.walking import find_walking_bodies

_TOLERANCE = 1e-9  # [m, rad]
_RESTARTS = 8  # random ones at a stop, where neither the line nor the stop before leads there
_QUATERNION = 4  # numbers; pairs of cosine and sine have one sign


@dataclass(frozen=True, eq=False)
class _StopRows:
    """What is asked for at a stop, with what holds there, see `mbocp.robot.poses.pose_search.ReachRows`."""

    poses: PoseRows
    ties: Ties

    @property
    def model(self) -> pin.Model:
        """Tree of joints."""
        return self.poses.model

    def residual(self, q: Array) -> Array:
        """Rows of the poses, and weighted ones of what holds."""
        return np.append(self.poses.pose_residual(q), CLOSURE_WEIGHT * self.ties.residuals(q[None])[0])

    def jacobian(self, q: Array) -> Array:
        """Their derivative."""
        return np.vstack([self.poses.pose_jacobian(q), CLOSURE_WEIGHT * self.ties.jacobians(q[None])[0]])


@dataclass(frozen=True, eq=False)
class _Stops:
    """Stops of a problem, made to fit one after the other."""

    problem: Problem
    table: SwitchTable
    landings: Mapping[int, Landing]

    @cached_property
    def _bounds(self) -> JointBounds:
        return joint_bounds(self.problem.robot.model, *position_limits(self.problem), frozenset())

    def fit(self, raw: Sequence[Stop]) -> list[Stop]:
        """Stops that fit, from what via points and goal have without holds; the first is taken as it is."""
        problem, robot = self.problem, self.problem.robot
        qs = np.tile(raw[0].q, (problem.num_steps + 1, 1))
        found, before = [raw[0]], raw[0].q
        for stop in raw[1:]:
            q, before = _stop_configuration(robot, found[-1].q, before, stop), stop.q
            ties = Ties.at(self.table, stop.node, qs)
            if landing := self.landings.get(stop.node):
                q = self._land(ties, landing, stop.goal)
            elif ties.count:
                q = self._settle(ties, q, found[-1].q, stop.goal)
            qs[instant(self.table.is_impact, stop.node)] = q
            found.append(Stop(stop.node, q, stop.goal))
        return found

    def _settle(self, ties: Ties, q: Array, before: Array, goal: Goal | None) -> Array:
        """A configuration that fits, at what is asked for where that can be."""
        robot = self.problem.robot
        if goal is None or not (goal.q_active.any() or goal.poses):
            return ties.fit(q[None])[0]
        targets = [frame.target for frame in goal.poses]
        rows, written = _StopRows(PoseRows(robot, targets), ties), robot.joints_with(goal.q_active)
        bounds = self._bounds
        best: Array | None = None
        for start in self._starts(q, before, written):
            there, has_arrived = reach(
                rows, bounds.clip(start), bounds, components(robot, written), _TOLERANCE
            )
            if best is None or has_arrived:
                best = there
            if has_arrived:
                break
        if best is not None:
            q = with_joints(robot, bounds.unwind(best, before), q, written)
        return ties.fit(q[None])[0]

    def _land(self, ties: Ties, landing: Landing, goal: Goal | None) -> Array:
        """A configuration in which feet land where they are wanted: by the legs, or by all joints."""
        robot, said = self.problem.robot, () if goal is None else goal.poses
        targets = [frame.target for frame in said] + list(landing.targets)
        rows, bounds = _StopRows(PoseRows(robot, targets), ties), self._bounds
        q, has_arrived = reach(rows, bounds.clip(landing.q), bounds, find_walking_bodies(robot), _TOLERANCE)
        if not has_arrived:
            q, _ = reach(rows, q, bounds, np.zeros(robot.nv, dtype=np.bool_), _TOLERANCE)
        return ties.fit(q[None])[0]

    def _starts(self, q: Array, before: Array, written: Sequence[str]) -> Iterator[Array]:
        """The line's configuration, the stop before, random ones; with the joints that are written."""
        robot, rng, bounds = self.problem.robot, np.random.default_rng(0), self._bounds
        yield q
        yield with_joints(robot, before, q, written)
        for _ in range(_RESTARTS):
            yield with_joints(robot, bounds.random(robot.model, before, rng), q, written)


def make_held_stops(problem: Problem, raw: Sequence[Stop], clock: Array) -> list[Stop]:
    """Stops at which what is held fits, with those beside them where something is taken on.

    Parameters
    ----------
    problem : Problem
        With holds, releases or impacts.
    raw : sequence of Stop
        The start, via points and the end, as they are without holds.
    clock : ndarray, shape (N + 1,)
        Times of the nodes, in any unit.
    """
    table = problem.timeline.switches
    if table is None:
        return list(raw)
    first, last = raw[0].node, raw[-1].node
    named = {first_of(table.is_impact, stop.node): stop for stop in raw}
    begun = {first_of(table.is_impact, begin.step) for begin in table.begins}
    for node in sorted(begun - set(named)):
        if first < node < last:
            named[node] = Stop(node, _between(problem, raw, clock, node))
    found = {node: Stop(node, stop.q, stop.goal) for node, stop in sorted(named.items())}
    landings = footholds(table, found, clock)
    for node in sorted(takeoffs(table) - set(found)):
        if first < node < last:  # feet that stand keep the body from where it flies to
            before = max(other for other in found if other < node)
            found[node] = Stop(node, found[before].q)
    return _Stops(problem, table, landings).fit([found[node] for node in sorted(found)])


def carry(problem: Problem, qs: Array) -> Array:
    """Configurations of the nodes, moved so that what is held stays held, shape (N + 1, nq)."""
    table = problem.timeline.switches
    if table is None:
        return qs
    found = np.array(qs)
    for _, group in groupby(range(1, len(qs)), lambda node: tie_key(table, node)):
        nodes = list(group)
        first = nodes[0]
        if table.is_impact[first - 1]:
            found[first] = found[first - 1]
            continue
        ties = Ties.at(table, first, found)
        apart = np.abs(ties.residuals(qs[nodes])).max(axis=1, initial=0.0) > _TOLERANCE
        if apart.any():
            led = [ties.lead(q, found[first - 1]) for q in qs[nodes][apart]]
            found[np.array(nodes)[apart]] = ties.fit(np.array(led))
        for node in nodes:
            found[node] = _with_signs(problem.robot, found[node], found[node - 1])
    return found


def carry_rate(problem: Problem, q: Array, v: Array, step: int) -> Array:
    """The velocity after an impact at which a motion would arrive with `v`, shape (nv,).

    .. math:: v^+ = v - M^{-1} J^T (J M^{-1} J^T)^+ J v
    """
    table = problem.timeline.switches
    J = np.zeros((0, len(v))) if table is None else table.in_step(q, step)
    if not len(J):
        return v
    root = np.linalg.cholesky(problem.robot.mass_matrix(q))
    scaled = np.linalg.solve(root, J.T).T  # J L^-T
    leap = np.linalg.lstsq(scaled, J @ v, rcond=1e-10)[0]
    return v - np.linalg.solve(root.T, leap)


def _stop_configuration(robot: Robot, now: Array, before: Array, stop: Stop) -> Array:
    """The configuration of a stop, with the joints that nobody asks for where they are now."""
    moved, goal = np.abs(robot.difference(before, stop.q)) > 0.0, stop.goal
    if goal is not None:
        moved = goal.q_active | (moved & bool(goal.poses))
    return with_joints(robot, now, stop.q, robot.joints_with(moved))


def _with_signs(robot: Robot, q: Array, before: Array) -> Array:
    """The configuration, with quaternions of the sign that is near the one before: steps compare numbers."""
    found = np.array(q)
    for _, at in robot.unit_groups:
        if at.stop - at.start == _QUATERNION and found[at] @ before[at] < 0.0:
            found[at] = -found[at]
    return found


def _between(problem: Problem, raw: Sequence[Stop], clock: Array, node: int) -> Array:
    """The configuration of a node on the straight line between its neighbours."""
    after = next(k for k, stop in enumerate(raw) if stop.node > node)
    a, b = raw[after - 1], raw[after]
    share = (clock[node] - clock[a.node]) / (clock[b.node] - clock[a.node])
    return np.array(pin.interpolate(problem.robot.model, a.q, b.q, share))

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

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, IntArray, dataclass, null_space
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.guesses.footholds import Landing, footholds, takeoffs
from mbocp.guesses.stop import Stop, first_of, instant
from mbocp.guesses.ways import position_limits
from mbocp.problem import Goal, Problem
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.robot import Robot
from mbocp.robot.kinematics import frame_jacobian
from mbocp.robot.loops.kinds.constraint import Constraint
from mbocp.robot.loops.projection import attitude_rows, closure_by_angle, components, reduce_rows
from mbocp.robot.poses.pose_rows import CLOSURE_WEIGHT, PoseRows, placements_of
from mbocp.robot.poses.pose_search import JointBounds, joint_bounds, reach
from mbocp.robot.walking import walking_bodies

_TOLERANCE = 1e-9  # [m, rad]
_FITTED = 1e-12  # [m, rad] within which holds are kept: another step would change nothing of a solve
_RESTARTS = 8  # random ones at a stop, where neither the line nor the stop before leads there
_QUATERNION = 4  # numbers; pairs of cosine and sine have one sign
_DECIDED = 1e-6  # part of a joint in the motions that are left when motors stand still


@dataclass(frozen=True, eq=False)
class _Ties:
    """What holds at an instant, from where it was at the nodes before, whose configurations are known."""

    table: SwitchTable
    own: BoolArray
    rows: BoolArray
    anchors: IntArray
    qs: Array

    @classmethod
    def at(cls, table: SwitchTable, node: int, qs: Array) -> _Ties:
        """Of the step to a node, and what is to coincide because it is taken on before the next one."""
        last = len(table.rows)
        after = next((n for n in range(node, last) if not table.is_impact[n]), last - 1)
        own: BoolArray = np.asarray(table.own[node - 1 : after + 1].any(axis=0))
        rows = table.rows[node - 1].copy()
        for begin in table.begins:
            if node <= begin.step <= after and not begin.frame.is_anchored and begin.frame in table.held:
                rows |= _rows_of(table, begin.frame) & table.rows[begin.step]
        return cls(table, own, rows, np.where(table.rows[node - 1], table.anchors[node - 1], -1), qs)

    @property
    def count(self) -> int:
        """Number of rows."""
        return int(self.own.sum() + self.rows.sum())

    def residual(self, q: Array) -> Array:
        """Rows at a configuration, shape (count,).

        Those of attitudes are rotation vectors, as their equations vanish at half turns, too.
        """
        found = np.zeros(len(self.rows))
        for anchor in np.unique(self.anchors[self.rows]):
            mine = self.rows & (self.anchors == anchor)
            known = q if anchor < 0 else self.qs[anchor]
            found[mine] = self.table.residuals(q[None], known[None])[0][mine]
        for (_, at), before, turn in zip(self._attitudes, self._turns_before, self._turns(q), strict=True):
            found[at] = pin.log3(before.T @ turn)
        if not self.own.any():
            return found[self.rows]
        own = closure_by_angle(self.table.robot, q)[0][self._kept_rows]
        return np.concatenate([own, found[self.rows]])

    def jacobian(self, q: Array) -> Array:
        """Their derivative, of rotation vectors the angular velocity, shape (count, nv)."""
        robot, found = self.table.robot, self.table.jacobians(q[None])[0]
        for (constraint, at), turn in zip(self._attitudes, self._turns(q), strict=True):
            in_a, in_b = (frame_jacobian(robot.model, q, k, pin.LOCAL)[3:] for k in constraint.frame_ids)
            found[at] = in_a - turn.T @ in_b
        if not self.own.any():
            return found[self.rows]
        own = closure_by_angle(robot, q)[1]()[self._kept_rows]
        return np.vstack([own, found[self.rows]])

    @cached_property
    def _kept_rows(self) -> IntArray:
        """Rows of the robot's own constraints that act, among all of them."""
        return np.array(self.table.robot.kept_rows, dtype=np.intp)[self.own]

    @cached_property
    def _attitudes(self) -> list[tuple[Constraint, slice]]:
        """What keeps an attitude, and the rows of its rotation."""
        kept = attitude_rows(frame.constraint for frame in self.table.held)
        return [(constraint, at) for constraint, at in kept if self.rows[at].any()]

    @cached_property
    def _turns_before(self) -> list[Array]:
        """Of each of these, the attitude in which it is held."""
        anchors = [self.anchors[at.start] for _, at in self._attitudes]
        turns = {anchor: self._turns(self.qs[anchor]) for anchor in set(anchors) if anchor >= 0}
        return [turns[anchor][k] if anchor >= 0 else np.eye(3) for k, anchor in enumerate(anchors)]

    def _turns(self, q: Array) -> list[Array]:
        """Of each of these, axes of its first frame in those of the second, shape (3, 3)."""
        pairs = [constraint.frame_ids for constraint, _ in self._attitudes]
        return [place.rotation for place in placements_of(self.table.robot.model, q, pairs)]

    def fit(self, q: Array) -> Array:
        """The configuration moved so that the rows hold, shape (nq,)."""
        robot, rows = self.table.robot, range(self.count)

        def what(_: object, at: Array) -> tuple[Array, Callable[[], Array]]:
            return self.residual(at), lambda: self.jacobian(at)

        follows = _follows(robot)
        if follows.any() and _suffices(self.jacobian(q), follows):
            q = reduce_rows(robot, q, follows, rows, what, _FITTED)
        return reduce_rows(robot, q, np.ones(robot.nv, dtype=np.bool_), rows, what, _FITTED)

    def lead(self, q: Array, before: Array) -> Array:
        """The configuration, with joints that motors decide by what holds where they were before.

        They are near there; on the line, a body may be half a turn away from the frame that holds it, where
        rows of a weld vanish, too.
        """
        robot, follows = self.table.robot, _follows(self.table.robot)
        if not follows.any():
            return q
        open_ways = null_space(self.jacobian(before)[:, follows], RANK_TOLERANCE)
        decided = np.zeros(robot.nv, dtype=np.bool_)
        decided[follows] = np.abs(open_ways).max(axis=1, initial=0.0) < _DECIDED
        names = [name for name in robot.joint_names if decided[robot.velocity_indices(name)].all()]
        return _with(robot, q, before, names)

    def apart(self, q: Array) -> float:
        """The largest residual [m, rad]."""
        return float(np.abs(self.residual(q)).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class _StopRows:
    """What is asked for at a stop, with what holds there, see `mbocp.robot.poses.pose_search.ReachRows`."""

    poses: PoseRows
    ties: _Ties

    @property
    def model(self) -> pin.Model:
        """Tree of joints."""
        return self.poses.model

    def residual(self, q: Array) -> Array:
        """Rows of the poses, and weighted ones of what holds."""
        return np.append(self.poses.pose_residual(q), CLOSURE_WEIGHT * self.ties.residual(q))

    def jacobian(self, q: Array) -> Array:
        """Their derivative."""
        return np.vstack([self.poses.pose_jacobian(q), CLOSURE_WEIGHT * self.ties.jacobian(q)])


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
            ties = _Ties.at(self.table, stop.node, qs)
            if landing := self.landings.get(stop.node):
                q = self._land(ties, landing, stop.goal)
            elif ties.count:
                q = self._settle(ties, q, found[-1].q, stop.goal)
            qs[instant(self.table.is_impact, stop.node)] = q
            found.append(Stop(stop.node, q, stop.goal))
        return found

    def _settle(self, ties: _Ties, q: Array, before: Array, goal: Goal | None) -> Array:
        """A configuration that fits, at what is asked for where that can be."""
        robot = self.problem.robot
        if goal is None or not (goal.q_active.any() or goal.poses):
            return ties.fit(q)
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
            q = _with(robot, bounds.unwind(best, before), q, written)
        return ties.fit(q)

    def _land(self, ties: _Ties, landing: Landing, goal: Goal | None) -> Array:
        """A configuration in which feet land where they are wanted: by the legs, or by all joints."""
        robot, said = self.problem.robot, () if goal is None else goal.poses
        targets = [frame.target for frame in said] + list(landing.targets)
        rows, bounds = _StopRows(PoseRows(robot, targets), ties), self._bounds
        q, has_arrived = reach(rows, bounds.clip(landing.q), bounds, walking_bodies(robot), _TOLERANCE)
        if not has_arrived:
            q, _ = reach(rows, q, bounds, np.zeros(robot.nv, dtype=np.bool_), _TOLERANCE)
        return ties.fit(q)

    def _starts(self, q: Array, before: Array, written: Sequence[str]) -> Iterator[Array]:
        """The line's configuration, the stop before, random ones; with the joints that are written."""
        robot, rng, bounds = self.problem.robot, np.random.default_rng(0), self._bounds
        yield q
        yield _with(robot, before, q, written)
        for _ in range(_RESTARTS):
            yield _with(robot, bounds.random(robot.model, before, rng), q, written)


def held_stops(problem: Problem, raw: Sequence[Stop], clock: Array) -> list[Stop]:
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
    for node in range(1, len(qs)):
        if table.is_impact[node - 1]:
            found[node] = found[node - 1]
            continue
        ties = _Ties.at(table, node, found)
        if ties.count and ties.apart(qs[node]) > _TOLERANCE:
            found[node] = ties.fit(ties.lead(qs[node], found[node - 1]))
        found[node] = _with_signs(problem.robot, found[node], found[node - 1])
    return found


def carried_rate(problem: Problem, q: Array, v: Array, step: int) -> Array:
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
    return _with(robot, now, stop.q, robot.joints_with(moved))


def _with(robot: Robot, q: Array, other: Array, joints: Sequence[str]) -> Array:
    """A configuration with some joints as in another."""
    found = np.array(q)
    for name in joints:
        at = robot.configuration_indices(name)
        found[at] = other[at]
    return found


def _with_signs(robot: Robot, q: Array, before: Array) -> Array:
    """The configuration, with quaternions of the sign that is near the one before: steps compare numbers."""
    found = np.array(q)
    for _, at in robot.unit_groups:
        if at.stop - at.start == _QUATERNION and found[at] @ before[at] < 0.0:
            found[at] = -found[at]
    return found


def _suffices(J: Array, chosen: BoolArray) -> bool:
    """Whether some velocity components can do what all can of some rows."""
    few, all_of_them = (np.linalg.matrix_rank(part, RANK_TOLERANCE) for part in (J[:, chosen], J))
    return bool(few == all_of_them)


def _follows(robot: Robot) -> BoolArray:
    """Velocity components that no motor or drive moves, but for bodies on legs, shape (nv,)."""
    has_motor = np.abs(robot.actuation.selection).sum(axis=1) > 0.0
    has_motor[list(robot.driven)] = True
    found: BoolArray = ~(has_motor | walking_bodies(robot))
    return found


def _rows_of(table: SwitchTable, frame: object) -> BoolArray:
    """Rows of one of the held frames."""
    owners = [held for held in table.held for _ in held.rows]
    return np.array([owner is frame for owner in owners], dtype=np.bool_)


def _between(problem: Problem, raw: Sequence[Stop], clock: Array, node: int) -> Array:
    """The configuration of a node on the straight line between its neighbours."""
    after = next(k for k, stop in enumerate(raw) if stop.node > node)
    a, b = raw[after - 1], raw[after]
    share = (clock[node] - clock[a.node]) / (clock[b.node] - clock[a.node])
    return np.array(pin.interpolate(problem.robot.model, a.q, b.q, share))

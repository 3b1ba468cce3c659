"""What holds at a node of a guess, from where it was at the nodes before."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray, IntArray, dataclass, null_space
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.problem.timeline.switches import SwitchTable
from mbocp.robot import Robot
from mbocp.robot.kinematics import frame_jacobians
from mbocp.robot.loops.kinds.constraint import Constraint
from mbocp.robot.loops.projection import attitude_rows, jacobian_by_angle, residual_by_angle
from mbocp.robot.loops.reduction import reduce_rows
from mbocp.robot.poses.pose_rows import placements_of
from mbocp.robot.walking import find_walking_bodies

_FITTED = 1e-12  # [m, rad] within which holds are kept: another step would change nothing of a solve
_DECIDED = 1e-6  # part of a joint in the motions that are left when motors stand still


@dataclass(frozen=True, eq=False)
class Ties:
    """What holds at an instant, from where it was at the nodes before, whose configurations are known."""

    table: SwitchTable
    own: BoolArray
    rows: BoolArray
    anchors: IntArray
    qs: Array

    @classmethod
    def at(cls, table: SwitchTable, node: int, qs: Array) -> Ties:
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

    def residuals(self, qs: Array) -> Array:
        """Rows at n configurations, shape (n, count).

        Those of attitudes are rotation vectors, as their equations vanish at half turns, too.
        """
        found = np.zeros((len(qs), len(self.rows)))
        for anchor in np.unique(self.anchors[self.rows]):
            mine = self.rows & (self.anchors == anchor)
            known = qs if anchor < 0 else np.broadcast_to(self.qs[anchor], qs.shape)
            found[:, mine] = self.table.residuals(qs, known)[:, mine]
        for (_, at), before, turns in zip(self._attitudes, self._turns_before, self._turns(qs), strict=True):
            found[:, at] = [pin.log3(before.T @ turn) for turn in turns]
        if not self.own.any():
            return found[:, self.rows]
        own = [residual_by_angle(self.table.robot, q)[self._kept_rows] for q in qs]
        return np.hstack([own, found[:, self.rows]])

    def jacobians(self, qs: Array) -> Array:
        """Their derivatives, of rotation vectors the angular velocity, shape (n, count, nv)."""
        robot, found = self.table.robot, self.table.jacobians(qs)
        for (constraint, at), turns in zip(self._attitudes, self._turns(qs), strict=True):
            in_a, in_b = (frame_jacobians(robot.model, qs, k, pin.LOCAL) for k in constraint.frame_ids)
            found[:, at] = in_a[:, 3:] - turns.transpose(0, 2, 1) @ in_b[:, 3:]
        if not self.own.any():
            return found[:, self.rows]
        own = [jacobian_by_angle(robot, q)[self._kept_rows] for q in qs]
        return np.concatenate([own, found[:, self.rows]], axis=1)

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
        turns = {at: self._turns(self.qs[at][None]) for at in set(anchors) if at >= 0}
        return [turns[anchor][k][0] if anchor >= 0 else np.eye(3) for k, anchor in enumerate(anchors)]

    def _turns(self, qs: Array) -> list[Array]:
        """Of each of these, axes of its first frame in those of the second, shape (n, 3, 3)."""
        pairs = [constraint.frame_ids for constraint, _ in self._attitudes]
        places = placements_of(self.table.robot.model, qs, pairs)
        return [np.array([place.rotation for place in along]) for along in places]

    def fit(self, qs: Array) -> Array:
        """Configurations moved so that the rows hold, shape (n, nq)."""
        robot, follows = self.table.robot, _follows(self.table.robot)
        what = self.residuals, self.jacobians, _FITTED
        if follows.any():
            suffices = np.array([_suffices(J, follows) for J in self.jacobians(qs)])
            if suffices.any():
                qs = np.array(qs)
                qs[suffices] = reduce_rows(robot, qs[suffices], follows, *what)
        return reduce_rows(robot, qs, np.ones(robot.nv, dtype=np.bool_), *what)

    def lead(self, q: Array, before: Array) -> Array:
        """The configuration, with joints that motors decide by what holds where they were before.

        They are near there; on the line, a body may be half a turn away from the frame that holds it, where
        rows of a weld vanish, too.
        """
        robot, follows = self.table.robot, _follows(self.table.robot)
        if not follows.any():
            return q
        open_ways = null_space(self.jacobians(before[None])[0][:, follows], RANK_TOLERANCE)
        decided = np.zeros(robot.nv, dtype=np.bool_)
        decided[follows] = np.abs(open_ways).max(axis=1, initial=0.0) < _DECIDED
        names = [name for name in robot.joint_names if decided[robot.velocity_indices(name)].all()]
        return with_joints(robot, q, before, names)


def tie_key(table: SwitchTable, node: int) -> tuple[object, ...]:
    """The same for nodes next to each other that have the same ties, none of which is led by another."""
    if table.is_impact[node - 1] or _follows(table.robot).any():
        return (node,)
    ties = Ties.at(table, node, np.zeros((0, 0)))
    return tuple(part.tobytes() for part in (ties.own, ties.rows, ties.anchors))


def with_joints(robot: Robot, q: Array, other: Array, joints: Sequence[str]) -> Array:
    """A configuration with some joints as in another."""
    found = np.array(q)
    for name in joints:
        at = robot.configuration_indices(name)
        found[at] = other[at]
    return found


def _suffices(J: Array, chosen: BoolArray) -> bool:
    """Whether some velocity components can do what all can of some rows."""
    few, all_of_them = (np.linalg.matrix_rank(part, RANK_TOLERANCE) for part in (J[:, chosen], J))
    return bool(few == all_of_them)


def _follows(robot: Robot) -> BoolArray:
    """Velocity components that no motor or drive moves, but for bodies on legs, shape (nv,)."""
    has_motor = np.abs(robot.actuation.selection).sum(axis=1) > 0.0
    has_motor[list(robot.driven)] = True
    found: BoolArray = ~(has_motor | find_walking_bodies(robot))
    return found


def _rows_of(table: SwitchTable, frame: object) -> BoolArray:
    """Rows of one of the held frames."""
    owners = [held for held in table.held for _ in held.rows]
    return np.array([owner is frame for owner in owners], dtype=np.bool_)

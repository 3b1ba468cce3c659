r"""Rows of a pose and their derivatives in numbers, by Pinocchio.

Of a target there are the differences of positions in the axes of the reference frame [m], and the rotation
vector from the target to the frame in the target's axes [rad]:

.. math:: R_r^T (p_f - p_r) - p^*, \qquad \log\left(R^{*T} R_r^T R_f\right)

or, where only an axis has a direction, the two components normal to the direction of the arc from the one
to the other. Rows of welds are rotation vectors, too, as their equations vanish at half turns. The derivative
of a rotation vector is taken to be the angular velocity. That gives the exact gradient of the square of the
angle, and the exact derivative at the target.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot.large import make_working_data
from mbocp.robot.loops.projection import jacobian_by_angle, residual_by_angle
from mbocp.robot.mechanism import Mechanism
from mbocp.robot.poses.target import FrameTarget, normals_to, rotation_between

CLOSURE_WEIGHT = 30.0  # of rows of closed loops beside those of a pose that is out of reach


class PoseErrors(NamedTuple):
    """What is left to each target."""

    positions: Array  # (targets,) [m]
    angles: Array  # (targets,) [rad]


class _Part(NamedTuple):
    target: FrameTarget
    frame: int
    reference: int
    at: tuple[int, ...]  # coordinates that are asked for
    wanted: Array  # (3,) position
    rotation: Array | None  # (3, 3)
    arc: Array | None  # (2, 3) from a rotation vector of an axis to the two rows of its arc


class PoseRows:
    """Residuals and Jacobian of targets and closed loops at a configuration.

    Parameters
    ----------
    robot : Mechanism
    targets : sequence of FrameTarget
        Whose frames the robot has.
    """

    def __init__(self, robot: Mechanism, targets: Sequence[FrameTarget]) -> None:
        self.robot, self.model = robot, robot.model
        self._data = make_working_data(robot.model)
        self._parts = [
            _Part(
                target,
                robot.frame_id(target.name),
                robot.frame_id(target.relative_to),
                tuple(int(i) for i in target.coordinates),
                np.zeros(3) if target.position is None else np.array(target.position),
                None if target.orientation is None else target.rotation,
                None
                if target.direction is None
                else -normals_to(target.direction).T @ pin.skew(target.direction),
            )
            for target in targets
        ]

    def residual(self, q: Array) -> Array:
        """All rows, those of the closed loops last and weighted."""
        rows = self.pose_residual(q)
        if not self.robot.constraints:
            return rows
        return np.concatenate([rows, CLOSURE_WEIGHT * residual_by_angle(self.robot, q)])

    def pose_residual(self, q: Array) -> Array:
        """The targets' rows alone."""
        pin.framesForwardKinematics(self.model, self._data, q)
        return np.concatenate([np.zeros(0), *(row for part in self._parts for row in self._rows(part))])

    def jacobian(self, q: Array) -> Array:
        """Derivative of the rows in tangent coordinates; call `residual` at the same q before."""
        rows = self.pose_jacobian(q)
        if not self.robot.constraints:
            return rows
        return np.concatenate([rows, CLOSURE_WEIGHT * jacobian_by_angle(self.robot, q)])

    def pose_jacobian(self, q: Array) -> Array:
        """Derivative of the targets' rows alone; call `residual` or `errors` at the same q before."""
        pin.computeJointJacobians(self.model, self._data, q)
        none = np.zeros((0, self.model.nv))
        return np.concatenate([none, *(row for part in self._parts for row in self._derivatives(part))])

    def errors(self, q: Array) -> PoseErrors:
        """Distance [m] and angle [rad] to each target."""
        pin.framesForwardKinematics(self.model, self._data, q)
        lengths, angles = [], []
        for part in self._parts:
            rows = self._rows(part)
            has_position = bool(part.at)
            lengths.append(float(np.linalg.norm(rows[0])) if has_position else 0.0)
            angles.append(float(np.linalg.norm(rows[-1])) if len(rows) > has_position else 0.0)
        return PoseErrors(np.array(lengths), np.array(angles))

    def _rows(self, part: _Part) -> list[Array]:
        placements = self._data.oMf
        p, R = placements[part.frame].translation, placements[part.frame].rotation
        if part.reference:
            base = placements[part.reference]
            p, R = base.rotation.T @ (p - base.translation), base.rotation.T @ R
        rows = [(p - part.wanted)[list(part.at)]] if part.at else []
        if part.rotation is not None:
            rows.append(pin.log3(part.rotation.T @ R))
        elif part.arc is not None and part.target.direction is not None:
            rows.append(part.arc @ rotation_between(part.target.direction, R @ part.target.axis))
        return rows

    def _derivatives(self, part: _Part) -> list[Array]:
        nv, data = self.model.nv, self._data
        pin.updateFramePlacement(self.model, data, part.frame)
        moved = pin.getFrameJacobian(self.model, data, part.frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, nv)
        if part.reference:
            moved = self._relative(part, moved)
        rows = [moved[list(part.at)]] if part.at else []
        if part.rotation is not None:
            rows.append(part.rotation.T @ moved[3:])
        elif part.arc is not None:
            a = data.oMf[part.frame].rotation @ part.target.axis
            if part.reference:
                a = data.oMf[part.reference].rotation.T @ a
            rows.append(part.arc @ (moved[3:] - np.outer(a, a @ moved[3:])))
        return rows

    def _relative(self, part: _Part, moved: Array) -> Array:
        """Jacobian of the frame in the reference frame and its axes."""
        data = self._data
        pin.updateFramePlacement(self.model, data, part.reference)
        base = pin.getFrameJacobian(self.model, data, part.reference, pin.LOCAL_WORLD_ALIGNED)
        base = base.reshape(6, self.model.nv)
        away = data.oMf[part.frame].translation - data.oMf[part.reference].translation
        turned: Array = data.oMf[part.reference].rotation.T
        lines = moved[:3] - base[:3] + pin.skew(away) @ base[3:]
        return np.vstack([turned @ lines, turned @ (moved[3:] - base[3:])])


def placements_of(model: pin.Model, qs: Array, pairs: Sequence[tuple[int, ...]]) -> list[list[pin.SE3]]:
    """Return placements of frames in the axes of others at n configurations, n for each pair."""
    found: list[list[pin.SE3]] = [[] for _ in pairs]
    if not pairs:
        return found
    data = make_working_data(model)
    for q in qs:
        pin.framesForwardKinematics(model, data, q)
        for places, (frame, reference) in zip(found, pairs, strict=True):
            places.append(data.oMf[reference].actInv(data.oMf[frame]))
    return found

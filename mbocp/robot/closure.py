"""Numbers of holonomic constraints: residual and Jacobian, from their one symbolic source."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import joints
from mbocp.robot.constraint_equations import constraint_rows
from mbocp.robot.constraints import Constraint, Coupling

__all__ = ["Closure"]


class Closure:
    """Residual and tangent Jacobian of a model's constraints, all rows.

    The rows are a function of the placements of the frames and of the displacements of the joints that they
    speak of; their exact derivatives meet Pinocchio's frame Jacobians.

    Parameters
    ----------
    model : pin.Model
    constraints : sequence of Constraint
    """

    def __init__(self, model: pin.Model, constraints: Sequence[Constraint]) -> None:
        self.model, self.constraints = model, tuple(constraints)
        framed = [c for c in self.constraints if not isinstance(c, Coupling)]
        coupled = [c for c in self.constraints if isinstance(c, Coupling)]
        self._frames = tuple(dict.fromkeys(f for c in framed for f in (c.frame_a, c.frame_b)))
        self._joints = tuple(dict.fromkeys(j for c in coupled for j in (c.joint_a, c.joint_b)))
        self.size = sum(len(c.rows) for c in self.constraints)
        self._function = _rows_function(self.constraints, self._frames, self._joints)

    def residual(self, q: Array) -> Array:
        """Phi(q), shape (size,)."""
        if not self.constraints:
            return np.zeros(0)
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, q)
        return self._values(data, q)[0]

    def jacobian(self, q: Array) -> Array:
        """Derivative of Phi in tangent coordinates, shape (size, nv)."""
        if not self.constraints:
            return np.zeros((0, self.model.nv))
        model, data = self.model, self.model.createData()
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        frames = [
            pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED).reshape(6, model.nv)
            for frame in self._frames
        ]
        moved: Array = np.vstack([*frames, self._joint_rows()])
        return self._values(data, q)[1] @ moved

    def _values(self, data: pin.Data, q: Array) -> tuple[Array, Array]:
        places = [data.oMf[frame] for frame in self._frames]
        numbers = np.array([np.append(M.translation, M.rotation.ravel(order="F")) for M in places])
        theta = np.array([joints.displacement(self.model, joint, q) for joint in self._joints])
        rows, derivative = self._function(numbers.reshape(-1, 12).T, theta)
        return rows.full().ravel(), derivative.full()

    def _joint_rows(self) -> Array:
        dofs = [joints.velocity_slice(self.model, joint).start for joint in self._joints]
        return np.eye(self.model.nv)[dofs].reshape(len(dofs), self.model.nv)


class _Placed:
    """Kinematics whose configuration is the frames' placements themselves, one column of 12 for each."""

    def __init__(self, frames: Sequence[int], joint_ids: Sequence[int], theta: ca.SX) -> None:
        self._columns = {frame: k for k, frame in enumerate(frames)}
        self._joints, self._theta = {joint: k for k, joint in enumerate(joint_ids)}, theta

    def frame_position(self, frame_id: int, q: ca.SX) -> ca.SX:
        return q[:3, self._columns[frame_id]]

    def frame_rotation(self, frame_id: int, q: ca.SX) -> ca.SX:
        return ca.reshape(q[3:, self._columns[frame_id]], 3, 3)

    def joint_displacement(self, joint_id: int, q: ca.SX) -> ca.SX:
        return self._theta[self._joints[joint_id]]


def _rows_function(
    constraints: Sequence[Constraint], frames: Sequence[int], joint_ids: Sequence[int]
) -> ca.Function:
    """(placements (12, frames), displacements) -> rows, and their derivative by displacements of the frames.

    A frame's displacement is its twist at the origin in world axes, linear before angular.
    """
    placements, theta = ca.SX.sym("placements", 12, len(frames)), ca.SX.sym("theta", len(joint_ids))
    placed = _Placed(frames, joint_ids, theta)
    rows = [constraint_rows(constraint, placed, placements) for constraint in constraints]
    phi = ca.vertcat(*rows) if rows else ca.SX.zeros(0, 1)
    by_numbers = ca.jacobian(phi, ca.vec(placements))
    columns = []
    for k, frame in enumerate(frames):
        block = by_numbers[:, 12 * k : 12 * k + 12]
        axes = placed.frame_rotation(frame, placements)
        turned = ca.vertcat(*[-ca.skew(axes[:, i]) for i in range(3)])  # d(axis) = w x axis
        columns += [block[:, :3], block[:, 3:] @ turned]
    derivative = ca.horzcat(*columns, ca.jacobian(phi, theta))
    return ca.Function("closure", [placements, theta], [ca.densify(phi), ca.densify(derivative)])

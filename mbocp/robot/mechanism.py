"""What closing the loops of a robot needs of it: its group, its mass matrix and its constraints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.exceptions import InvalidValue
from mbocp.robot import joints, kinematics
from mbocp.robot.large import make_working_data
from mbocp.robot.loops.kinds.constraint import Constraint
from mbocp.robot.model import RobotModel


@dataclass(frozen=True, eq=False, repr=False)
class Mechanism(RobotModel):
    """A multibody system with holonomic constraints, see `mbocp.robot.Robot`.

    `Robot` itself closes loops and solves for poses by functions of this package; they know it as this.
    """

    def integrate(self, q: ArrayLike, dv: ArrayLike) -> Array:
        """Move from `q` along the tangent vector `dv`: q ∘ exp(dv), shape (nq,)."""
        q, dv = self._vector(q, self.nq, "q"), self._vector(dv, self.nv, "dv")
        return frozen_array(pin.integrate(self.model, q, dv))

    def difference(self, q0: ArrayLike, q1: ArrayLike) -> Array:
        """Tangent vector at `q0` that leads to `q1`, shape (nv,)."""
        q0, q1 = self._vector(q0, self.nq, "q0"), self._vector(q1, self.nq, "q1")
        return frozen_array(kinematics.difference(self.model, q0, q1))

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Joint-space mass matrix M(q), shape (nv, nv) [kg, kg m, kg m^2]."""
        return frozen_array(kinematics.mass_matrix(self.model, self._vector(q, self.nq, "q")))

    def constraint_residual(self, q: ArrayLike) -> Array:
        """Phi(q), the rows that the equations keep, shape (nc,) [m, rad, m^2]."""
        return frozen_array(self.closure_residual(q)[self._kept_rows])

    def constraint_jacobian(self, q: ArrayLike) -> Array:
        """dPhi_dq in tangent coordinates, the rows that the equations keep, shape (nc, nv)."""
        return frozen_array(self.closure_jacobian(q)[self._kept_rows])

    def closure_residual(self, q: ArrayLike) -> Array:
        """Residual of all rows of the constraints, the redundant ones included [m, rad, m^2]."""
        return frozen_array(self._closure.residual(self._vector(q, self.nq, "q")))

    def closure_jacobian(self, q: ArrayLike) -> Array:
        """Derivative of `closure_residual` in tangent coordinates, shape (rows, nv)."""
        return frozen_array(self._closure.jacobian(self._vector(q, self.nq, "q")))

    def closure_along(self, qs: ArrayLike) -> tuple[Array, Array]:
        """`closure_residual` and `closure_jacobian` at many configurations, faster than one by one.

        Parameters
        ----------
        qs : array_like, shape (n, nq)

        Returns
        -------
        residuals : ndarray, shape (n, rows)
            [m, rad, m^2].
        jacobians : ndarray, shape (n, rows, nv)
        """
        array = frozen_array(qs, shape=(None, self.nq), name=f"robot {self.name!r}: qs")
        if not np.isfinite(array).all():
            raise InvalidValue(f"robot {self.name!r}: qs", "numbers that are not finite", "finite numbers")
        residuals, jacobians = self._closure.along(array)
        return frozen_array(residuals), frozen_array(jacobians)

    @cached_property
    def _closure(self) -> Closure:
        return Closure(self.model, self.constraints)

    @property
    def _kept_rows(self) -> NDArray[np.intp]:
        return np.array(self.kept_rows, dtype=np.intp)

    def _vector(self, value: ArrayLike, size: int, name: str) -> Array:
        array = frozen_array(value, shape=(size,), name=f"robot {self.name!r}: {name}")
        if not np.isfinite(array).all():
            raise InvalidValue(f"robot {self.name!r}: {name}", array.tolist(), "finite numbers")
        return array


class Closure:
    """Residual and tangent Jacobian of a model's constraints, all rows.

    The rows are a function of the placements of their frames and of the displacements of their joints. Its
    exact derivatives are multiplied by Pinocchio's frame Jacobians.

    Parameters
    ----------
    model : pin.Model
    constraints : sequence of Constraint
    """

    def __init__(self, model: pin.Model, constraints: Sequence[Constraint]) -> None:
        self.model, self.constraints = model, tuple(constraints)
        self._frames = tuple(dict.fromkeys(f for c in self.constraints for f in c.frame_ids))
        self._joints = tuple(dict.fromkeys(j for c in self.constraints for j in c.joint_ids))
        self.size = sum(len(c.rows) for c in self.constraints)
        self._function, self._places = _rows_function(self.constraints, self._frames, self._joints)
        self._idle: list[pin.Data] = []  # making one takes longer than using it

    def residual(self, q: Array) -> Array:
        """Phi(q), shape (size,)."""
        if not self.constraints:
            return np.zeros(0)
        with self._data() as data:
            pin.framesForwardKinematics(self.model, data, q)
            numbers, theta = self._placements(data), self._displacements(q)
        return self._function(numbers.T, theta)[0].full().ravel()

    def jacobian(self, q: Array) -> Array:
        """Derivative of Phi in tangent coordinates, shape (size, nv)."""
        return self.along(np.asarray(q)[None])[1][0]

    def along(self, qs: Array) -> tuple[Array, Array]:
        """Phi and its derivative at n configurations (n, nq), shapes (n, size) and (n, size, nv)."""
        n, model, frames = len(qs), self.model, len(self._frames)
        if not self.constraints or not n:
            return np.zeros((n, self.size)), np.zeros((n, self.size, model.nv))
        numbers, moved = np.empty((n, frames, 12)), np.empty((n, frames, 6, model.nv))
        with self._data() as data:
            for k, q in enumerate(qs):
                pin.computeJointJacobians(model, data, q)
                pin.updateFramePlacements(model, data)
                numbers[k] = self._placements(data)
                for i, frame in enumerate(self._frames):
                    jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
                    moved[k, i] = jacobian.reshape(6, model.nv)
        theta = np.array([self._displacements(q) for q in qs])
        function = self._function if n == 1 else self._function.map(n)
        rows, derivatives = function(numbers.reshape(-1, 12).T, theta.T)
        by_motion = np.zeros((n, self.size, 6 * frames + len(self._joints)))
        by_motion[:, self._places[0], self._places[1]] = derivatives.full().T
        jacobians: Array = by_motion[:, :, : 6 * frames] @ moved.reshape(n, 6 * frames, model.nv)
        jacobians += by_motion[:, :, 6 * frames :] @ self._joint_rows()
        return rows.full().T, jacobians

    @contextmanager
    def _data(self) -> Iterator[pin.Data]:
        """Pinocchio's working memory, one for each that is at work at the same time."""
        try:
            data = self._idle.pop()
        except IndexError:
            data = make_working_data(self.model)
        try:
            yield data
        finally:
            self._idle.append(data)

    def _placements(self, data: pin.Data) -> Array:
        numbers = np.empty((len(self._frames), 12))
        for i, frame in enumerate(self._frames):
            placement = data.oMf[frame]
            numbers[i, :3], numbers[i, 3:] = placement.translation, placement.rotation.ravel(order="F")
        return numbers

    def _displacements(self, q: Array) -> Array:
        return np.array([joints.displacement(self.model, joint, q) for joint in self._joints])

    def _joint_rows(self) -> Array:
        dofs = [joints.velocity_slice(self.model, joint).start for joint in self._joints]
        return np.eye(self.model.nv)[dofs].reshape(len(dofs), self.model.nv)


class _PlacementKinematics:
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
) -> tuple[ca.Function, tuple[list[int], list[int]]]:
    """(placements (12, frames), displacements) -> rows, and their derivatives by motions that are not zero.

    The motions are the twists of the frames at their origins in world axes, linear before angular, six for
    each, then the rates of the displacements.

    Returns
    -------
    function : casadi.Function
    places : (list of int, list of int)
        Row and motion of each derivative.
    """
    placements, theta = ca.SX.sym("placements", 12, len(frames)), ca.SX.sym("theta", len(joint_ids))
    placed = _PlacementKinematics(frames, joint_ids, theta)
    rows = [constraint.equations(placed, placements) for constraint in constraints]
    phi = ca.vertcat(*rows) if rows else ca.SX.zeros(0, 1)
    by_numbers = ca.jacobian(phi, ca.vec(placements))
    columns = []
    for k, frame in enumerate(frames):
        block = by_numbers[:, 12 * k : 12 * k + 12]
        axes = placed.frame_rotation(frame, placements)
        turned = ca.vertcat(*[-ca.skew(axes[:, i]) for i in range(3)])  # d(axis) = w x axis
        columns += [block[:, :3], block[:, 3:] @ turned]
    derivative = ca.sparsify(ca.horzcat(*columns, ca.jacobian(phi, theta)))
    function = ca.Function("closure", [placements, theta], [ca.densify(phi), ca.vec(derivative.nz[:])])
    return function, derivative.sparsity().get_triplet()

r"""Inverse dynamics of a robot, linear in its parameters.

Closed loops leave n independent coordinates y of all joints, with :math:`v = G(q)\,\dot y` and
:math:`\Phi_q G = 0`, so that reactions drop out of

.. math:: G^T \left(Y(q, v, a)\,\varphi - f(q, v) - B u\right) = 0.

The independent coordinates are joints with motors wherever that is possible: then :math:`G^T B u` are the
torques of the motors themselves.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.linalg import qr

from mbocp._arrays import Array, IntArray
from mbocp.exceptions import InvalidValue, UnsupportedRobot
from mbocp.robot import Robot, joints
from mbocp.robot.kinematics import difference, force_elements

PER_BODY = 10  # mass, first moments, moments of inertia: Pinocchio's order
_CLOSED = 1e-10  # [m, rad] residual of closed loops
_STEPS = 30  # of Newton's method
_SINGULAR = 1e-14  # determinant of the loops' Jacobian [by units of its rows]
_WALK = 0.05  # [rad, m] the independent coordinates move at most between two closures in a row
_JUMP = 0.5  # [rad, m] no joint moves further on such a way
_SHIFT = 1e-6  # of central differences; their error is about 1e-10 of the derivative


class JointMotion(NamedTuple):
    """A motion at K times.

    Parameters
    ----------
    qs : ndarray, shape (K, nq)
        Configurations [m, rad, unit quaternion xyzw].
    v, a : ndarray, shape (K, nv)
        Velocities and accelerations [m, rad, s].
    G : ndarray, shape (K, nv, n)
    """

    qs: Array
    v: Array
    a: Array
    G: Array


class InverseDynamics:
    """Rows of inverse dynamics for the independent coordinates of a robot.

    Parameters, in this order: ten of each body, rotor inertia, damping and Coulomb friction of each joint.

    Parameters
    ----------
    robot : Robot
    friction_speed : float, optional
        Of the smooth Coulomb friction [rad/s, m/s]; by default that of the robot's joints, or 0.1.

    Raises
    ------
    UnsupportedRobot
        For joints outside of loops that do not slide or turn about an axis, elastic joints, drives and
        thrusters, by name.
    """

    def __init__(self, robot: Robot, friction_speed: float | None = None) -> None:
        self.robot, self.model, self._data = robot, robot.model, robot.model.createData()
        _check(robot)
        self.speeds = np.full(robot.nv, 0.1 if friction_speed is None else friction_speed)
        if not (np.isfinite(self.speeds).all() and (self.speeds > 0.0).all()):
            raise InvalidValue("friction_speed", friction_speed, "a positive finite number [rad/s, m/s]")
        losses = np.zeros((2, robot.nv))
        for loss in robot.resistances:
            losses[:, loss.dof] = loss.damping, loss.friction
            if friction_speed is None:
                self.speeds[loss.dof] = loss.speed
        bodies = [inertia.toDynamicParameters() for inertia in list(robot.model.inertias)[1:]]
        self.values = np.concatenate([*bodies, np.asarray(robot.model.armature), *losses])
        self.independent, self.dependent = _split(robot)
        owners = [_owner(robot, int(dof)) for dof in self.independent]
        self.names = tuple(robot.joint_names[owner] for owner in owners)
        self._places = [robot.configuration_indices(name) for name in self.names]

    @property
    def n(self) -> int:
        """Number of independent coordinates."""
        return len(self.independent)

    def place(self, y: Array, near: Array) -> Array:
        """Configurations (K, nq) with other independent coordinates (K, n); the loops do not close."""
        qs = np.array(near)
        for at, column in zip(self._places, y.T, strict=True):
            if at.stop - at.start == 1:
                qs[:, at.start] = column
            else:
                qs[:, at.start], qs[:, at.start + 1] = np.cos(column), np.sin(column)
        return qs

    def with_speeds(self, speeds: Array) -> InverseDynamics:
        """The same dynamics with other speeds of the smooth Coulomb friction, shape (nv,) [rad/s, m/s]."""
        other = copy(self)
        other.speeds = np.array(speeds)
        return other

    def coordinates(self, q: Array) -> Array:
        """Independent coordinates of a configuration, shape (n,)."""
        return np.array([joints.displacement(self.model, self.model.getJointId(n), q) for n in self.names])

    def follow(self, y: Array, first: Array | None = None) -> Array:
        """Configurations along a course of the independent coordinates (K, n), from the initial pose on.

        Raises
        ------
        InvalidValue
            Where the loops do not close, or jump to another way of closing.
        """
        now = np.array(self.robot.q0 if first is None else first)
        if not len(self.dependent):
            return self.place(y, np.broadcast_to(now, (len(y), len(now))))
        found, start = np.empty((len(y), len(now))), self.coordinates(now)
        for k, target in enumerate(y):
            count = max(1, int(np.ceil(np.abs(target - start).max() / _WALK)))
            for share in np.arange(1, count + 1) / count:
                there = self.close((start + share * (target - start))[None], now[None])[0]
                if np.abs(difference(self.model, now, there)).max() > _JUMP:
                    raise self._gap_error(target, "ones that its loops follow to without a jump")
                now = there
            found[k], start = now, target
        return found

    def close(self, y: Array, near: Array) -> Array:
        """Configurations (K, nq) that close the loops for independent coordinates, near others."""
        return self._close(y, near)[0] if len(self.dependent) else self.place(y, near)

    def _close(self, y: Array, near: Array) -> tuple[Array, Array]:
        """These, and the Jacobians of the loops there."""
        qs = self.place(y, near)
        for _ in range(_STEPS):
            residual, jacobian = self._loops(qs)
            if np.abs(residual).max() < _CLOSED:
                return qs, jacobian
            block = jacobian[:, :, self.dependent]
            if not np.abs(np.linalg.det(block)).min() > _SINGULAR:
                break
            step = np.zeros((len(qs), self.robot.nv))
            step[:, self.dependent] = -np.linalg.solve(block, residual[:, :, None])[:, :, 0]
            step *= np.minimum(1.0, 1.0 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
            qs = self._integrate(qs, step)
        worst = int(np.abs(residual).max(axis=1).argmax())
        raise self._gap_error(y[worst], "ones for which its loops close")

    def _gap_error(self, y: Array, expected: str) -> InvalidValue:
        where = ", ".join(f"{name} = {value:.4g}" for name, value in zip(self.names, y, strict=True))
        return InvalidValue(f"positions of {self.robot.name!r}", where, expected)

    def motion(self, y: Array, yd: Array, ydd: Array, near: Array) -> JointMotion:
        """The motion of all joints for that of the independent coordinates, each shape (K, n)."""
        qs, jacobian = self._close(y, near) if len(self.dependent) else (self.place(y, near), None)
        G = np.zeros((len(y), self.robot.nv, self.n))
        G[:, self.independent, np.arange(self.n)] = 1.0
        if jacobian is None:
            return JointMotion(qs, yd @ G[0].T, ydd @ G[0].T, G)
        block = jacobian[:, :, self.dependent]
        G[:, self.dependent] = -np.linalg.solve(block, jacobian[:, :, self.independent])
        v = np.einsum("kij,kj->ki", G, yd)
        h = _SHIFT / np.maximum(np.abs(v).max(axis=1), 1.0)[:, None]
        change = self._loops(self._integrate(qs, h * v))[1] - self._loops(self._integrate(qs, -h * v))[1]
        bias = np.einsum("kij,kj->ki", change, v) / (2.0 * h)
        a = np.einsum("kij,kj->ki", G, ydd)
        a[:, self.dependent] -= np.linalg.solve(block, bias[:, :, None])[:, :, 0]
        return JointMotion(qs, v, a, G)

    def regressor(self, motion: JointMotion) -> Array:
        """Rows times parameters are the torques of the independent coordinates, shape (K, n, parameters)."""
        nv, bodies = self.robot.nv, PER_BODY * (self.model.njoints - 1)
        full = np.zeros((len(motion.v), nv, bodies + 3 * nv))
        for k, (q, v, a) in enumerate(zip(motion.qs, motion.v, motion.a, strict=True)):
            full[k, :, :bodies] = pin.computeJointTorqueRegressor(self.model, self._data, q, v, a)
        at = np.arange(nv)
        full[:, at, bodies + at] = motion.a
        full[:, at, bodies + nv + at] = motion.v
        full[:, at, bodies + 2 * nv + at] = np.tanh(motion.v / self.speeds)
        return np.asarray(np.einsum("kij,kip->kjp", motion.G, full))

    def speed_slopes(self, motion: JointMotion, values: Array) -> Array:
        """Derivatives of the rows in the logarithms of the friction speeds, shape (K, n, nv)."""
        ratio = motion.v / self.speeds
        slopes = -self._losses(values)[1] * ratio * (1.0 - np.tanh(ratio) ** 2)
        return np.asarray(motion.G.transpose(0, 2, 1) * slopes[:, None])

    def compute_applied_torques(self, motion: JointMotion, u: Array) -> Array:
        """Torques of motors, springs and dampers on the independent coordinates, shape (K, n)."""
        forces = u @ self.robot.actuation.selection.T
        if self.robot.forces:
            forces = forces + [
                force_elements(self.model, q, v, self.robot.forces)
                for q, v in zip(motion.qs, motion.v, strict=True)
            ]
        return np.asarray(np.einsum("kij,ki->kj", motion.G, forces))

    def slopes(self, motion: JointMotion, values: Array, u: Array) -> tuple[Array, Array, Array]:
        """Derivatives of the rows in y, its rates and accelerations, each shape (K, n, n)."""
        model = self.with_values(values)
        if not (len(self.dependent) or self.robot.forces):
            return self._slopes_of_tree(motion, values)

        def rows(there: JointMotion) -> Array:
            return self._torques(model, there, values) - self.compute_applied_torques(there, u)

        return self.differences(rows, motion)

    def differences(
        self, values: Callable[[JointMotion], Array], motion: JointMotion
    ) -> tuple[Array, Array, Array]:
        """Differentiate what depends on a motion time by time, and is linear in accelerations.

        Parameters
        ----------
        values : callable
            Of a motion, shape (K, ...).
        motion : JointMotion

        Returns
        -------
        dy, dyd, dydd : ndarray, shape (K, ..., n)
            Derivatives in the independent coordinates, their rates and accelerations, by differences.
        """
        y = np.array([self.coordinates(q) for q in motion.qs])
        yd, ydd = motion.v[:, self.independent], motion.a[:, self.independent]
        parts: list[list[Array]] = [[], [], []]
        here = values(motion)
        for j in range(self.n):
            h = np.zeros(self.n)
            h[j] = _SHIFT
            pairs = ((y + h, yd), (y - h, yd)), ((y, yd + h), (y, yd - h))
            for part, sides in zip(parts, pairs, strict=False):
                ahead, behind = (values(self.motion(*side, ydd, motion.qs)) for side in sides)
                part.append((ahead - behind) / (2.0 * _SHIFT))
            parts[2].append(values(motion._replace(a=motion.a + motion.G[:, :, j])) - here)
        dy, dyd, dydd = (np.stack(part, axis=-1) for part in parts)
        return dy, dyd, dydd

    def with_values(self, values: Array) -> pin.Model:
        """Copy of the model with the inertias and rotors of these parameters."""
        model, nv = pin.Model(self.model), self.robot.nv
        bodies = values[: PER_BODY * (model.njoints - 1)].reshape(-1, PER_BODY)
        for joint, body in enumerate(bodies, start=1):
            model.inertias[joint] = inertia_of(body)
        model.armature = values[bodies.size : bodies.size + nv]
        return model

    def _loops(self, qs: Array) -> tuple[Array, Array]:
        residual, jacobian = self.robot.closure_along(qs)
        kept = list(self.robot.kept_rows)
        return residual[:, kept], jacobian[:, kept]

    def _integrate(self, qs: Array, steps: Array) -> Array:
        return np.array([pin.integrate(self.model, q, step) for q, step in zip(qs, steps, strict=True)])

    def _losses(self, values: Array) -> tuple[Array, Array]:
        damping, friction = values[-2 * self.robot.nv :].reshape(2, -1)
        return damping, friction

    def _torques(self, model: pin.Model, motion: JointMotion, values: Array) -> Array:
        damping, friction = self._losses(values)
        torques = damping * motion.v + friction * np.tanh(motion.v / self.speeds)
        torques += [
            pin.rnea(model, self._data, q, v, a)
            for q, v, a in zip(motion.qs, motion.v, motion.a, strict=True)
        ]
        return np.asarray(np.einsum("kij,ki->kj", motion.G, torques))

    def _slopes_of_tree(self, motion: JointMotion, values: Array) -> tuple[Array, Array, Array]:
        (damping, friction), nv = self._losses(values), self.robot.nv
        # Pinocchio adds bodies up, and takes their masses for positive; estimates on the way need not be.
        masses = PER_BODY * np.arange(self.model.njoints - 1)
        least = float(values[masses].min())
        if least < 0.0:
            added = np.zeros_like(values)
            added[masses] = 1.0 - 2.0 * least
            ours, theirs = (self._slopes_of_tree(motion, each) for each in (values + added, added))
            return tuple(a - b for a, b in zip(ours, theirs, strict=True))  # type: ignore[return-value]
        model = self.with_values(values)
        found = np.empty((3, len(motion.v), nv, nv))
        for k, (q, v, a) in enumerate(zip(motion.qs, motion.v, motion.a, strict=True)):
            found[:, k] = pin.computeRNEADerivatives(model, self._data, q, v, a)
        upper = np.triu(found[2])  # of the mass matrix Pinocchio sets these entries alone
        found[2] = upper + np.triu(upper, 1).transpose(0, 2, 1)
        at = np.arange(nv)
        steep = 1.0 - np.tanh(motion.v / self.speeds) ** 2
        found[1][:, at, at] += damping + friction / self.speeds * steep
        chosen = np.ix_(self.independent, self.independent)
        return tuple(each[:, chosen[0], chosen[1]] for each in found)  # type: ignore[return-value]


def inertia_of(parameters: Array) -> pin.Inertia:
    """A body of ten parameters, of any sign: estimates on the way need not be those of a body."""
    numbers = np.array(parameters)
    if abs(numbers[0]) < 1e-9:  # its centre of mass is the first moment by the mass
        numbers[0] = 1e-9
    return pin.Inertia.FromDynamicParameters(numbers)


def _check(robot: Robot) -> None:
    where = f"robot {robot.name!r}"
    mimics = list(robot.model.mimicking_joints)
    if mimics:
        raise UnsupportedRobot(
            f"{where}: joint {robot.model.names[mimics[0]]!r} mimics another; load it with mimic = false"
        )
    for what, names in (
        ("elastic joint", [joint.name for joint in robot.elastic]),
        ("drive", [drive.name for drive in robot.drives]),
        ("actuator", [actuator.name for actuator in robot.actuation.frame_actuators]),
        ("loss of a mimic joint", [loss.name for loss in robot.resistances if loss.ratio != 1.0]),
    ):
        if names:
            raise UnsupportedRobot(
                f"{where}: {what} {names[0]!r}: identification takes motors in joints alone"
            )
    if not robot.nu:
        raise UnsupportedRobot(f"{where}: it has no motors, and no torques to be measured")


def _owner(robot: Robot, dof: int) -> int:
    """The joint that an independent velocity component belongs to, counted without the universe."""
    all_joints = list(enumerate(robot.joint_names, start=1))
    number, name = next((k, n) for k, n in all_joints if dof in _dofs(robot, n))
    size = robot.model.joints[number].nv
    if size != 1:
        raise UnsupportedRobot(
            f"robot {robot.name!r}: joint {name!r} has {size} velocities, and no loop says "
            "where it is; identification needs one that slides or turns there"
        )
    return number - 1


def _dofs(robot: Robot, name: str) -> range:
    where = robot.velocity_indices(name)
    return range(where.start, where.stop)


def _split(robot: Robot) -> tuple[IntArray, IntArray]:
    """Independent and dependent velocity components: as few with motors among the latter as may be."""
    jacobian = np.array(robot.constraint_jacobian(robot.q0))
    driven = robot.actuation.selection.any(axis=1)
    groups, chosen = (np.flatnonzero(~driven), np.flatnonzero(driven)), np.zeros(0, dtype=np.intp)
    left = jacobian
    for group in groups:
        if not (robot.nc - len(chosen) and len(group)):
            continue
        _, upper, order = qr(left[:, group], mode="economic", pivoting=True)
        size = np.abs(np.diag(upper))
        count = int((size > 1e-9 * max(np.abs(jacobian).max(), 1e-300)).sum())
        chosen = np.concatenate([chosen, group[order[: min(count, robot.nc - len(chosen))]]])
        basis = np.linalg.qr(jacobian[:, chosen])[0]
        left = jacobian - basis @ (basis.T @ jacobian)
    dependent = np.sort(chosen)
    return np.setdiff1d(np.arange(robot.nv), dependent), dependent

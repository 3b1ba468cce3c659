"""Symbolic kinematics of a robot at one moment: what a term of a user's own may look at."""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from mbocp._arrays import dataclass
from mbocp.exceptions import ProblemError, suggest
from mbocp.lie.groups import RigidBody, RotationMatrix
from mbocp.mechanics import JointMechanics
from mbocp.robot import Robot
from mbocp.symbolic import Reference

_ALIGNED: Reference = "local_world_aligned"
_WORDS = {"u": "controls", "a": "accelerations", "t": "time"}


@dataclass(frozen=True, eq=False)
class Kinematics:
    """A robot at one moment, symbolic: every method gives `casadi.SX`, vectors are columns.

    Frames are given by name. Positions are in the world [m]; twists and Jacobians are linear before angular,
    by default of the frame's origin in the axes of the world ("local_world_aligned"), else "local" or "world"
    as in `pinocchio.ReferenceFrame`.

    Attributes
    ----------
    robot : Robot
    where : str
        What kind of term asks, for messages.
    q : casadi.SX, shape (nq,)
        Configuration [m, rad, unit quaternion xyzw, cosine and sine]; rotation matrices take the place of
        quaternions in natural coordinates, and with ``rotations = "dcm"``.
    v : casadi.SX, shape (nv,)
        Velocity [m/s, rad/s].
    symbols : mapping of str to casadi.SX
        Of u, a and t as far as there are any here.
    parameters : mapping of str to casadi.SX
        The term's own.
    mechanics : JointMechanics
    wrenches : dict of str to casadi.SX, optional
        Forces and torques of constraints that have been asked for, by name; None where there are none.
    """

    robot: Robot
    where: str
    q: ca.SX
    v: ca.SX
    symbols: Mapping[str, ca.SX]
    parameters: Mapping[str, ca.SX]
    mechanics: JointMechanics
    wrenches: dict[str, ca.SX] | None = None

    @property
    def u(self) -> ca.SX:
        """Control of the step, shape (nu,) [N, N m]; at a node that of the step before it."""
        return self._there("u")

    @property
    def a(self) -> ca.SX:
        """Acceleration of the joints, shape (nv,) [m/s^2, rad/s^2]."""
        return self._there("a")

    @property
    def t(self) -> ca.SX:
        """Time [s]."""
        return self._there("t")

    def __getitem__(self, name: str) -> ca.SX:
        """One of the term's own parameters, a column."""
        if name not in self.parameters:
            known = suggest(name, self.parameters) if self.parameters else "it has none"
            raise ProblemError(f"{self.where}: there is no parameter {name!r}: {known}")
        return self.parameters[name]

    def position(self, frame: str) -> ca.SX:
        """Origin of a frame, shape (3,) [m]."""
        return self.mechanics.frame_position(self.robot.frame_id(frame), self.q)

    def rotation(self, frame: str) -> ca.SX:
        """Axes of a frame in the world, its columns, shape (3, 3)."""
        return self.mechanics.frame_rotation(self.robot.frame_id(frame), self.q)

    def pose_error(
        self, frame: str, position: ArrayLike | ca.SX, rotation: ArrayLike | ca.SX | None = None
    ) -> ca.SX:
        """Twist that leads from a pose to that of a frame, shape (6,) [m, rad], linear first: log(P^-1 F).

        `rotation`, shape (3, 3), has the pose's axes as columns; those of the world unless told. Smooth where
        the frame is turned by less than pi.
        """
        body = RigidBody(RotationMatrix())
        at = self._symbolic("position", position, (3, 1))
        turned = ca.SX.eye(3) if rotation is None else self._symbolic("rotation", rotation, (3, 3))
        poses = ((at, turned), (self.position(frame), self.rotation(frame)))
        return body.difference(*(ca.vertcat(p, ca.vec(R)) for p, R in poses))

    def jacobian(self, frame: str, reference: Reference = _ALIGNED) -> ca.SX:
        """Jacobian J of a frame, shape (6, nv), so that its velocity is J v."""
        function = self.mechanics.functions.frame_jacobian(self.robot.frame_id(frame), reference)
        return self.mechanics.evaluate(function, self.q)

    def velocity(self, frame: str, reference: Reference = _ALIGNED) -> ca.SX:
        """Velocity of a frame, shape (6,) [m/s, rad/s]."""
        return self.jacobian(frame, reference) @ self.v

    def acceleration(self, frame: str) -> ca.SX:
        """Rate of the velocity in the axes of the world, shape (6,) [m/s^2, rad/s^2], without gravity."""
        velocity = self.velocity(frame)
        along = ca.jtimes(velocity, self.q, self.mechanics.space.rate(self.q, self.v))
        return self.jacobian(frame) @ self.a + along

    def momentum(self, frame: str) -> ca.SX:
        """Momentum of the body that carries a frame, about its origin, in the axes of the world, shape (6,).

        Linear before angular [kg m/s, N m s].
        """
        inertia = self.mechanics.frame_inertia(self.robot.frame_id(frame))
        h, R = inertia @ self.velocity(frame, "local"), self.rotation(frame)
        return ca.vertcat(R @ h[:3], R @ h[3:])

    def joint_momentum(self) -> ca.SX:
        """Canonical momentum p = M(q) v, shape (nv,) [kg m/s, N m s]."""
        return self.mechanics.momentum(self.q, self.v)

    def centre_of_mass(self) -> ca.SX:
        """Centre of mass in the world, shape (3,) [m]."""
        return self.mechanics.centre_of_mass(self.q)

    def centroidal_momentum(self) -> ca.SX:
        """Momentum about the centre of mass, axes of the world, shape (6,) [kg m/s, N m s]."""
        return self.mechanics.centroidal_momentum(self.q, self.v)

    def force(self, constraint: str) -> ca.SX:
        """Force and torque of a constraint, or of what is held, on its first frame, shape (6,) [N, N m].

        Those of the step, about the frame's origin, in the axes of the second frame, as
        `mbocp.problem.ContactForce` has them; zero where it does not act.
        """
        if self.wrenches is None:
            raise ProblemError(f"{self.where} has no forces of constraints; a running cost has")
        return self.wrenches.setdefault(constraint, ca.SX.sym(f"force of {constraint}", 6))

    def kinetic_energy(self) -> ca.SX:
        """Kinetic energy [J]."""
        return ca.dot(self.joint_momentum(), self.v) / 2

    def potential_energy(self) -> ca.SX:
        """Potential energy of gravity and of the force elements [J]."""
        return self.mechanics.potential_energy(self.q)

    def _there(self, name: str) -> ca.SX:
        if name not in self.symbols:
            raise ProblemError(f"{self.where} has no {_WORDS[name]} ({name})")
        return self.symbols[name]

    def _symbolic(self, name: str, given: ArrayLike | ca.SX, shape: tuple[int, int]) -> ca.SX:
        value = given if isinstance(given, ca.SX) else ca.SX(ca.DM(np.asarray(given, dtype=np.float64)))
        if value.shape != shape:
            raise ProblemError(f"{self.where}: pose_error: {name}: got shape {value.shape}, expected {shape}")
        return value

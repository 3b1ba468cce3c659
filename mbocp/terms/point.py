"""Where a term is evaluated, in symbols, and the sizes of what it speaks of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import field
from typing import NamedTuple

import casadi as ca

from mbocp._arrays import dataclass
from mbocp.exceptions import TranscriptionError
from mbocp.mechanics import Mechanics


class Sizes(NamedTuple):
    """Sizes of what the parameters speak of; in joint coordinates the last two repeat the first."""

    nz: int  # coordinates of a configuration
    nv: int  # its tangent directions
    nu: int
    joint_nz: int  # coordinates of the joints, which costs compare
    joint_nv: int  # velocities of the joints, which costs weigh

    @classmethod
    def of(cls, mechanics: Mechanics) -> Sizes:
        """Sizes of a robot in its coordinates."""
        joints = (mechanics.joint_space.nz, mechanics.robot.nv)
        return cls(mechanics.nq, mechanics.nv, mechanics.nu, *joints)


@dataclass(frozen=True)
class Point:
    """A state, and at a step its control: where a term is evaluated.

    Attributes
    ----------
    mechanics : JointMechanics or NaturalMechanics
    q, v : casadi.SX
        Configuration and velocity in the coordinates of `mechanics`.
    u : casadi.SX or None
        Control [N, N m]; there is none at the end.
    change : casadi.SX or None
        Of the controls since the step before, where the state has the previous controls.
    acceleration : callable or None
        Gives the accelerations of the joints, shape (robot.nv,) [m/s^2, rad/s^2].
    moment : casadi.SX or None
        Time [s], where a term looks at it.
    forces : callable or None
        Gives the forces of all constraints in the step, held frames among them [N, N m].
    ties : callable or None
        Configuration -> derivatives of all constraints of the step, shape (rows, nv), and which act, 1 or 0.
    remembered : mapping of str to casadi.SX
        What the state remembers of the step before, by name, see `mbocp.formulation.features.memory`.
    """

    mechanics: Mechanics
    q: ca.SX
    v: ca.SX
    u: ca.SX | None = None
    change: ca.SX | None = None
    acceleration: Callable[[], ca.SX] | None = None
    moment: ca.SX | None = None
    forces: Callable[[], ca.SX] | None = None
    ties: Callable[[ca.SX], tuple[ca.SX, ca.SX]] | None = None
    remembered: Mapping[str, ca.SX] = field(default_factory=dict)

    @property
    def control(self) -> ca.SX:
        """Control of the step, shape (nu,) [N, N m]."""
        return self._there(self.u, "a control")

    @property
    def control_change(self) -> ca.SX:
        """Control less that of the step before, shape (nu,)."""
        return self._there(self.change, "a change of the control")

    @property
    def powers(self) -> ca.SX:
        """Power of each control, u_i (B(q)' v)_i, shape (nu,) [W]."""
        return self.control * (self.pushes().T @ self.v)

    @property
    def time(self) -> ca.SX:
        """Time [s]."""
        return self._there(self.moment, "the time")

    def pushes(self) -> ca.SX:
        """B(q), shape (nv, nu): forces are affine in u."""
        u = ca.SX.sym("u", self.mechanics.nu)
        return ca.jacobian(self.mechanics.force(self.q, self.v, u), u)

    def joint_configuration(self) -> ca.SX:
        """Configuration of the joints; in natural coordinates with rotation matrices."""
        return self.mechanics.joint_coordinates(self.q)

    def joint_velocity(self) -> ca.SX:
        """Velocities of the joints, shape (robot.nv,) [m/s, rad/s]."""
        return self.mechanics.joint_velocity(self.q, self.v)

    def joint_momentum(self) -> ca.SX:
        """Canonical momenta of the joints, shape (robot.nv,) [kg m/s, N m s]."""
        return self.mechanics.joint_momentum(self.q, self.mechanics.momentum(self.q, self.v))

    def joint_acceleration(self) -> ca.SX:
        """Accelerations of the joints, shape (robot.nv,) [m/s^2, rad/s^2]."""
        if self.acceleration is None:
            raise TranscriptionError("a term asks for accelerations where there are none")
        return self.acceleration()

    def constraint_forces(self) -> ca.SX:
        """Forces of all constraints in the step, zero where they do not act [N, N m]."""
        if self.forces is None:
            raise TranscriptionError("a term asks for forces of constraints where there are none")
        return self.forces()

    def constraints(self) -> tuple[ca.SX, ca.SX]:
        """Derivatives of all constraints in the step, shape (rows, nv), and which act, 1 or 0."""
        if self.ties is None:
            raise TranscriptionError("a term asks for constraints where there are none")
        return self.ties(self.q)

    def joint_difference(self, goal: ca.SX, parts: tuple[int, ...] | None) -> ca.SX:
        """Tangent vector of the joints from `goal`, of the parts that matter.

        A logarithm has no derivative at a half-turn, so that parts without a weight are not compared.
        """
        return self.mechanics.joint_difference(goal, self.q, parts)

    @staticmethod
    def _there(value: ca.SX | None, what: str) -> ca.SX:
        if value is None:
            raise TranscriptionError(f"a term asks for {what} where there is none")
        return value

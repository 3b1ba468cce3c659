r"""Forward dynamics: what explicit integrators need, dq/dt and the rate of the speeds.

Without drives the speeds s are the velocities v. Where controls prescribe velocity components (drives), s are
the free components of v and the speeds of the drives whose acceleration is the control:

.. math:: v = V(q)\, s + U(q)\, u.

Holonomic constraints act through projected accelerations: lambda is such that
:math:`\ddot\Phi + 2 \gamma \dot\Phi + \gamma^2 \Phi = 0`, with :math:`\gamma = 0` unless it is stabilised.
Where some of them are let go, or frames are held, rows :math:`J(q)\,v = 0` of the velocities are kept in
their place, with :math:`\gamma = 0`: see `mbocp.mechanics.held_frames`.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from mbocp.exceptions import UnsupportedRobot
from mbocp.mechanics.held_frames import ActiveRows, write_held_jacobian
from mbocp.mechanics.joint_mechanics import JointMechanics
from mbocp.robot import Robot


class ForwardMechanics(JointMechanics):
    """Symbolic forward dynamics of `robot`.

    Parameters
    ----------
    robot : Robot
    rotations : str
    acting : ActiveRows, optional
        Rows that act; without, those of all of the robot's constraints.
    numbers : casadi.SX, optional
        See `JointMechanics`.

    Attributes
    ----------
    ns : int
        Number of speeds.
    num_tied : int
        Number of rows that act.

    Raises
    ------
    UnsupportedRobot
        If the robot has both drives and holonomic constraints.
    """

    def __init__(
        self,
        robot: Robot,
        rotations: str = "quaternion",
        *,
        acting: ActiveRows | None = None,
        numbers: ca.SX | None = None,
    ) -> None:
        super().__init__(robot, rotations, numbers=numbers)
        self._acting = acting
        self.num_tied = self.nc if acting is None else len(acting.own) + len(acting.rows)
        if robot.drives and robot.nc:
            raise UnsupportedRobot(
                f"robot {robot.name!r} has drives ({robot.drives[0].name!r}, ...) and holonomic constraints "
                f"({robot.constraints[0].name!r}, ...), which do not go together yet: take one of them out"
            )
        driven = set(robot.driven)
        self._free = [i for i in range(self.nv) if i not in driven]
        self._accelerated = [k for k, d in enumerate(robot.drives) if d.control == "acceleration"]
        self._at_drives = self.nu - len(robot.drives)  # where the drives' controls begin in u
        self.ns = len(self._free) + len(self._accelerated)

    def end_difference(self, goal: ca.SX, q: ca.SX) -> ca.SX:
        """What an end condition holds at zero, Eq. (37) of [Manara2017]_, shape (nv,).

        Explicit schemes may leave the groups: null-space projected, the difference is smooth everywhere.
        """
        return self.space.projection(goal, q)

    def velocity(self, q: ca.SX, s: ca.SX, u: ca.SX) -> ca.SX:
        """Velocity v = V(q) s + U(q) u, shape (nv,)."""
        if not self.robot.drives:
            return s
        return self._move(q, s, self._drive_speeds(s, u))

    def speed_rate(self, q: ca.SX, s: ca.SX, u: ca.SX, gamma: ca.SX) -> ca.SX:
        """ds/dt, shape (ns,), with Baumgarte's rate `gamma` [1/s] of the holonomic constraints."""
        if self.robot.drives:
            return self._hybrid(q, s, u)
        force = self.force(q, s, u)
        free = self.forward_dynamics(q, s, force)
        if self.num_tied == 0:
            return free
        return free - self.inverse_mass_matrix(q) @ self._tie_rows(q).T @ self._lambda(q, s, free, gamma)

    def multipliers(self, q: ca.SX, v: ca.SX, u: ca.SX, gamma: ca.SX) -> ca.SX:
        """Multipliers lambda of the holonomic constraints, shape (nc,)."""
        return self._lambda(q, v, self.forward_dynamics(q, v, self.force(q, v, u)), gamma)

    def project_velocity(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """The velocity that keeps the constraints and is nearest to v in kinetic energy, shape (nv,)."""
        if self.num_tied == 0:
            return v
        jacobian = self._tie_rows(q)
        moved = self.inverse_mass_matrix(q) @ jacobian.T
        return v - moved @ _solve(jacobian @ moved, jacobian @ v)

    def _tie_rows(self, q: ca.SX) -> ca.SX:
        """Derivatives of the rows that act in tangent coordinates, shape (num_tied, nv)."""
        own = self.constraint_jacobian(q)
        if self._acting is None:
            return own
        held = write_held_jacobian(self._acting.held if self._acting.rows else (), self, q)
        return ca.vertcat(own[list(self._acting.own), :], held[list(self._acting.rows), :])

    def _lambda(self, q: ca.SX, v: ca.SX, free: ca.SX, gamma: ca.SX) -> ca.SX:
        jacobian = self._tie_rows(q)
        rate = jacobian @ v
        wanted = jacobian @ free + self._along(rate, q, v)
        if self._acting is None:
            wanted += 2 * gamma * rate + gamma**2 * self.constraints(q)
        return _solve(jacobian @ self.inverse_mass_matrix(q) @ jacobian.T, wanted)

    def _hybrid(self, q: ca.SX, s: ca.SX, u: ca.SX) -> ca.SX:
        """Free accelerations from the free rows of the inverse dynamics; the driven ones are known."""
        num_free = len(self._free)
        pushed = ca.vertcat(*[u[self._at_drives + k] for k in self._accelerated])
        v = self.velocity(q, s, u)
        rates = ca.SX.zeros(len(self.robot.drives))
        for row, k in enumerate(self._accelerated):
            rates[k] = pushed[row]
        known = self._move(q, ca.SX.zeros(self.ns), rates) + self._along(v, q, v)
        if not num_free:
            return pushed
        # M of the free components from the inverse dynamics, which is linear in a: its recursion in the
        # joints' own axes leaves constants constant; the composite-body algorithm goes through the world.
        a = ca.SX.sym("a", self.nv)
        mass = ca.jacobian(self.inverse_dynamics(q, v, a)[self._free], a)[:, self._free]
        missing = self.force(q, v, u) - self.inverse_dynamics(q, v, known)
        return ca.vertcat(_solve(mass, missing[self._free]), pushed)

    def _drive_speeds(self, s: ca.SX, u: ca.SX) -> ca.SX:
        speeds = [
            s[len(self._free) + self._accelerated.index(k)]
            if k in self._accelerated
            else u[self._at_drives + k]
            for k in range(len(self.robot.drives))
        ]
        return ca.vertcat(*speeds)

    def _move(self, q: ca.SX, s: ca.SX, drive_speeds: ca.SX) -> ca.SX:
        """Velocity of free speeds and of the drives' columns."""
        v = ca.SX.zeros(self.nv)
        for row, i in enumerate(self._free):
            v[i] = s[row]
        for k, drive in enumerate(self.robot.drives):
            dofs = list(drive.dofs)
            if drive.frame_id is None:
                v[dofs] += drive_speeds[k]
                continue
            towards = self.frame_rotation(drive.frame_id, q) @ ca.DM(np.asarray(drive.direction))
            column = self.frame_translation_jacobian(drive.frame_id, q)[:, dofs].T @ towards
            v[dofs] += column * drive_speeds[k]
        return v

    def _along(self, expression: ca.SX, q: ca.SX, v: ca.SX) -> ca.SX:
        """Rate of an expression in the symbols q while they move with v and all else stands still."""
        return ca.jtimes(expression, q, self.space.rate(q, v))


def _solve(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Solution of a small symmetric positive definite system, by L D L' without pivots."""
    if matrix.shape[0] == 1:
        return right / matrix
    size = matrix.shape[0]
    lower, diagonal = ca.SX.eye(size), [ca.SX(0)] * size
    for j in range(size):
        diagonal[j] = matrix[j, j] - sum(lower[j, k] ** 2 * diagonal[k] for k in range(j))
        for i in range(j + 1, size):
            known = sum(lower[i, k] * lower[j, k] * diagonal[k] for k in range(j))
            lower[i, j] = (matrix[i, j] - known) / diagonal[j]
    y = [right[i] for i in range(size)]
    for i in range(size):
        y[i] -= sum(lower[i, k] * y[k] for k in range(i))
    x = [y[i] / diagonal[i] for i in range(size)]
    for i in reversed(range(size)):
        x[i] -= sum(lower[k, i] * x[k] for k in range(i + 1, size))
    return ca.vertcat(*x)

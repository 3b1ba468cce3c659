r"""Natural coordinates: positions and directors, a constant mass matrix, constraints for all that is rigid.

The equations are those of the paper, (1)-(3), with :math:`p = M v` and a constant M for any robot. Every body
has twelve numbers (see `bodies`), and six constraints keep its directors orthonormal. A joint is the
constraints that it imposes: 5 for revolute, continuous and prismatic joints, 3 for ball, planar and
translation joints, none for a free-flyer, one more for a joint that mimics another. Loops add theirs.
Nothing is of more than second degree but couplings and planar joints between two bodies.

A joint's torque acts on the directors through a matrix that is linear in them: a torque tau about the axis a
of the body gives :math:`f_{d_i} = \tfrac{\tau}{2} D (a \times e_i)`, which is on the constraints
:math:`\tfrac{\tau}{2} \sum_j a_j\, d_j \times d_i`; the parent gets the opposite.

Rotors that turn with a joint (`armature` of the Pinocchio model) have the energy :math:`\tfrac12 a_j \dot
\theta_j^2`, whose part of M is the only one that varies.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.mechanics.forces import force_element_energy, force_element_force, resistance_torque
from mbocp.mechanics.natural_coordinates.bodies import SIZE, Body, BodyTree
from mbocp.mechanics.natural_coordinates.body_kinematics import NaturalKinematics, constant
from mbocp.mechanics.natural_coordinates.joint_rows import JointRow, follower_row, joint_rows
from mbocp.robot import Robot
from mbocp.robot.parts import Label

_ORTHONORMAL = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


class NaturalMechanics(NaturalKinematics):
    """Symbolic equations of motion of a robot in natural coordinates.

    Offers what `mbocp.mechanics.JointMechanics` does: every method takes and returns `casadi.SX`, vectors are
    columns. q are the natural coordinates, v their rates.

    Parameters
    ----------
    robot : Robot

    Attributes
    ----------
    tree : BodyTree
    nq, nv, ns, nu, nc : int
        Sizes of coordinates, of their rates and speeds (the same), controls, constraints.
    joint_space : ConfigurationSpace
        What `joint_coordinates` are coordinates of.
    num_loops : int
        How many of the constraints, the last ones, are those of `robot.constraints`.

    Raises
    ------
    UnsupportedRobot
        If natural coordinates cannot describe the robot, naming the joint.
    """

    is_vector_space = True

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self.nu, self.ns = robot.nu, self.nv
        self.num_loops = robot.nc
        self._mass = _mass_matrix(self.tree)
        q = ca.SX.sym("q", self.nq)
        rows = list(self._tree_rows(q))
        self.groups = _groups(rows, self.tree, self.num_loops)
        self.constraint_labels: tuple[Label, ...] = (
            *(Label(f"{row.body.name} {row.name}", row.unit) for row in rows),
            *robot.constraint_labels,
        )
        self.nc = len(self.constraint_labels)
        loops = self._loops(q)
        self._constraints = ca.Function("Phi", [q], [ca.vertcat(*(row.value for row in rows), loops)])

    # Equations of motion

    def velocity(self, q: ca.SX, s: ca.SX, u: ca.SX) -> ca.SX:
        """Rates of the coordinates of a state's speeds: the speeds themselves, shape (nv,)."""
        return s

    @property
    def numbers(self) -> ca.SX:
        """Values of `robot.varying`: constants of the equations."""
        return ca.SX(ca.DM(self.robot.varying_values))

    @property
    def symbols(self) -> ca.SX:
        """None of them is a symbol: shape (0, 1)."""
        return ca.SX.zeros(0, 1)

    def mass_matrix(self, q: ca.SX) -> ca.SX:
        """M, shape (nv, nv); constant but for rotors."""
        rotors, g = self._rotors(q)
        return self._mass + g.T @ (_scale(rotors, g)) if rotors.size else self._mass

    def mass_at(self, z: Array) -> Array:
        """M at coordinates z as numbers, shape (nv, nv)."""
        q = ca.SX.sym("q", self.nq)
        return ca.Function("M", [q], [self.mass_matrix(q)])(z).full()

    def momentum(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Momentum p = M v, shape (nv,)."""
        return self.mass_matrix(q) @ v

    def inverse_dynamics(self, q: ca.SX, v: ca.SX, a: ca.SX) -> ca.SX:
        """M a less the force of gravity, shape (nv,): only rotors add what is quadratic in the velocities."""
        total = self._mass @ a - self._gravity()
        rotors, g = self._rotors(q)
        if rotors.size:
            at = ca.SX.sym("q", self.nq)
            turning = ca.Function(
                "turning", [at, w := ca.SX.sym("v", self.nv)], [ca.jtimes(self._rotors(at)[1] @ w, at, w)]
            )
            total += g.T @ (ca.SX(ca.DM(rotors)) * (g @ a + turning(q, v)))
        return total

    def force(self, q: ca.SX, v: ca.SX, u: ca.SX) -> ca.SX:
        """B(q) u plus the forces of force elements and losses of joints, shape (nv,)."""
        actuation = self.robot.actuation
        total = ca.SX.zeros(self.nv)
        for column in range(actuation.selection.shape[1]):
            effort = np.asarray(actuation.selection[:, column])
            for body in self.tree.bodies:
                width = body.axes.shape[1] if body.at_v >= 0 else 0
                part = effort[body.at_v : body.at_v + width]
                if np.any(part):
                    total += self._joint_force(body, part, q) * u[column]
        for k, actuator in enumerate(actuation.frame_actuators):
            frame = self.robot.model.frames[actuator.frame_id]
            rotation, direction = frame.placement.rotation, np.asarray(actuator.direction)
            joint, at = int(frame.parentJoint), self.placement(int(frame.parentJoint), q)
            wrench = self.push(
                joint, at.axes @ constant(rotation @ direction[:3]), frame.placement.translation, q
            )
            wrench += self.twist(joint, rotation @ direction[3:], q)
            total += wrench * u[actuation.selection.shape[1] + k]
        for index in range(len(self.robot.forces)):
            total += force_element_force(index, self, q, v)
        return total + self._losses(q, v) if self.robot.resistances else total

    def gravity(self, q: ca.SX) -> ca.SX:
        """Refuse: forces on the coordinates of bodies are no torques of joints.

        Raises
        ------
        ProblemError
        """
        raise ProblemError(
            'cost.effort_about_gravity: torques of gravity are for coordinates = "joint"; take these'
        )

    def element_numbers(self, index: int) -> dict[str, ca.SX]:
        """Stiffness, length at rest and the like of a force element: constants."""
        element = self.robot.forces[index]
        return {key: ca.SX(getattr(element, key)) for key in element.units}

    def potential_energy(self, q: ca.SX) -> ca.SX:
        """Potential energy of gravity and of the force elements [J]."""
        energy = -ca.dot(self._gravity(), q) + self._gravity_at_zero()
        for index in range(len(self.robot.forces)):
            energy += force_element_energy(index, self, q)
        return energy

    def tangent_map(self, q: ca.SX) -> ca.SX:
        """Derivative of q in its tangent space: the identity."""
        return ca.SX.eye(self.nv)

    def constraints(self, q: ca.SX) -> ca.SX:
        """Phi(q), shape (nc,): body by body orthonormality and joint, then the robot's own constraints."""
        return self._constraints(q)

    def constraint_jacobian(self, q: ca.SX) -> ca.SX:
        """dPhi_dq, shape (nc, nv); linear in q but for couplings."""
        return self.derivative(self.constraints, q)

    def gear_ratio(self, dof: int) -> ca.SX:
        """Turns of the motor for one of a joint with this velocity; 1 without a gear."""
        return ca.SX(next((motor.gear_ratio for motor in self.robot.motors if motor.dof == dof), 1.0))

    # Parts

    def _rotors(self, q: ca.SX) -> tuple[Array, ca.SX]:
        """Inertias of the rotors that there are, shape (k, 1), and their rates per v, shape (k, nv)."""
        inertias = np.asarray(self.robot.model.armature, dtype=float)
        turning = np.flatnonzero(inertias)
        if not turning.size:
            return np.zeros((0, 1)), ca.SX.zeros(0, self.nv)
        at, v = ca.SX.sym("q", self.nq), ca.SX.sym("v", self.nv)
        rates = ca.jacobian(self.joint_velocity(at, v)[turning.tolist()], v)
        return inertias[turning][:, None], ca.Function("rotors", [at], [rates])(q)

    def _tree_rows(self, q: ca.SX) -> Iterator[JointRow]:
        for body in self.tree.turning:
            D = self.placement(body.joint, q).axes
            for i, j in _ORTHONORMAL:
                value = (ca.dot(D[:, i], D[:, j]) - (i == j)) / (2 if i == j else 1)
                yield JointRow(body, f"d{i + 1}.d{j + 1}", "", value)
            parent = self.placement(body.parent, q)
            axes = parent.axes @ constant(body.rotation)
            away = (
                self.placement(body.joint, q).origin
                - parent.origin
                - parent.axes @ constant(body.translation)
            )
            yield from joint_rows(body, axes, away, D)
            if body.leader:
                own, others = (self.joint_displacement(j, q) for j in (body.joint, body.leader))
                yield follower_row(body, own, others)

    def _loops(self, q: ca.SX) -> ca.SX:
        if not self.robot.constraints:
            return ca.SX.zeros(0, 1)
        rows = ca.vertcat(*(c.equations(self, q) for c in self.robot.constraints))
        return rows[list(self.robot.kept_rows)]

    def _gravity(self) -> ca.SX:
        """Generalised force of gravity, constant, shape (nv,)."""
        g = np.asarray(self.robot.model.gravity.linear)
        force = np.zeros(self.nv)
        for body in self.tree.bodies:
            if body.slides:
                force[: len(self.tree.sliding)] += body.mass * self.sliding[body.joint][2].T @ g
            else:
                force[body.at : body.at + 3] = body.mass * g
        return ca.sparsify(ca.SX(ca.DM(force)))

    def _gravity_at_zero(self) -> float:
        g, energy = np.asarray(self.robot.model.gravity.linear), 0.0
        for body in self.tree.bodies:
            if body.slides:
                rotation, origin, _ = self.sliding[body.joint]
                energy -= body.mass * float(g @ (origin + rotation @ body.lever))
        return energy

    def _losses(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Generalised force of the joints' damping and friction, through their velocities."""
        total, velocity = ca.SX.zeros(self.nv), self.joint_velocity(q, v)
        for resistance in self.robot.resistances:
            body = next(b for b in self.tree.bodies if b.moves(resistance.dof))
            unit = np.eye(body.axes.shape[1])[resistance.dof - body.at_v]
            total += self._joint_force(body, unit, q) * resistance_torque(resistance, velocity)
        return total

    def _joint_force(self, body: Body, effort: Array, q: ca.SX) -> ca.SX:
        """Generalised force of a unit control that acts on a joint with `effort` on its velocities."""
        wrench = np.linalg.pinv(body.axes).T @ effort  # in the body's axes at its origin
        force, moment = np.where(np.abs(wrench) < 1e-14, 0.0, wrench).reshape(2, 3)
        if body.slides:
            out = np.zeros(self.nv)
            first = self.tree.sliding.index(body.at_v)
            out[first : first + effort.size] = effort
            return ca.sparsify(ca.SX(ca.DM(out)))
        at = self.placement(body.joint, q)
        total = self.push(body.joint, at.axes @ constant(force), np.zeros(3), q)
        total += self.twist(body.joint, moment, q)
        if not body.parent:
            return total
        parent = self.placement(body.parent, q)
        turned = body.kind in ("revolute", "continuous", "prismatic")
        if np.any(force):  # the reaction, at the same point of the parent
            where: Array | ca.SX = body.translation  # on the line along which a prismatic joint pushes
            along = parent.axes @ constant(body.rotation @ force) if turned else at.axes @ constant(force)
            if not turned:
                where = parent.axes.T @ (at.origin - parent.origin)
            total -= self.push(body.parent, along, where, q)
        if np.any(moment):
            about = body.rotation @ moment if turned else parent.axes.T @ (at.axes @ constant(moment))
            total -= self.twist(body.parent, about, q)
        return total


def _scale(factors: Array, rows: ca.SX) -> ca.SX:
    """Rows times a factor each."""
    return ca.diag(ca.SX(ca.DM(factors))) @ rows


def _mass_matrix(tree: BodyTree) -> ca.SX:
    M, count = np.zeros((tree.n, tree.n)), len(tree.sliding)
    for body in tree.bodies:
        if body.slides:
            moves = tree.sliding_placement(body.joint)[2]
            M[:count, :count] += body.mass * moves.T @ moves
        else:
            M[body.at : body.at + 3, body.at : body.at + 3] = body.mass * np.eye(3)
            M[body.at + 3 : body.at + SIZE, body.at + 3 : body.at + SIZE] = np.kron(body.euler, np.eye(3))
    return ca.sparsify(ca.SX(ca.DM(M)))


def _groups(
    rows: Sequence[JointRow], tree: BodyTree, num_loops: int
) -> tuple[tuple[int, int, tuple[int, ...]], ...]:
    """First row, number and own columns of each body's constraints, parents first; then the loops'."""
    found = []
    for body in tree.turning:
        mine = [i for i, row in enumerate(rows) if row.body is body]
        if mine:
            found.append((mine[0], len(mine), tuple(range(body.at, body.at + SIZE))))
    if num_loops:
        found.append((len(rows), num_loops, tuple(range(tree.n))))
    return tuple(found)

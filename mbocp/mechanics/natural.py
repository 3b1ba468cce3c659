r"""Natural coordinates: positions and directors, a constant mass matrix, constraints for all that is rigid.

The equations are those of the paper, (1)-(3), with :math:`p = M v` and a constant M for any URDF: every body
is twelve numbers (see `mbocp.mechanics.bodies`), six constraints keep its directors orthonormal, its joint is
the constraints that it imposes: 5 for revolute, continuous and prismatic joints, 3 for ball, planar and
translation joints, none for a free-flyer, one more for a joint that mimics another. Loops come on top.
Nothing is of more than second degree but couplings and planar joints between two bodies.

A joint's torque acts on the directors through a matrix that is linear in them: a torque tau about the axis a
of the body gives :math:`f_{d_i} = \tfrac{\tau}{2} D (a \times e_i)`, which is on the constraints
:math:`\tfrac{\tau}{2} \sum_j a_j\, d_j \times d_i`; the parent gets the opposite.

Rotors that turn with a joint (`armature` of the Pinocchio model) have the energy :math:`\tfrac12 a_j \dot
\theta_j^2`, whose part of M is the only one that varies.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from mbocp._arrays import Array
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics.bodies import SIZE, Body, BodyTree, body_tree
from mbocp.mechanics.forces import force_element_energy, force_element_force
from mbocp.mechanics.natural_joints import JointRow, joint_rows, perpendiculars
from mbocp.robot import Robot
from mbocp.robot.constraint_equations import constraint_rows
from mbocp.robot.parts import Label

__all__ = ["NaturalMechanics", "Placement"]

_ROUND_OFF = 1e-14
_ORTHONORMAL = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2))


@dataclass(frozen=True)
class Placement:
    """Frame of a body in the world: origin [m] and axes (columns)."""

    origin: ca.SX
    axes: ca.SX


class NaturalMechanics:
    """Symbolic equations of motion of a robot in natural coordinates.

    Offers what `mbocp.mechanics.JointMechanics` does: every method takes and returns `casadi.SX`, vectors are
    columns. q are the natural coordinates, v their rates.

    Parameters
    ----------
    robot : Robot

    Attributes
    ----------
    tree : BodyTree
    nq, nv, nu, nc : int
        Sizes of coordinates, of their rates (the same), controls, constraints.
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
        self.robot = robot
        self.tree: BodyTree = body_tree(robot)
        self.nq = self.nv = self.tree.n
        self.nu = robot.nu
        self.num_loops = robot.nc
        self.joint_space = ConfigurationSpace(robot.model, "dcm")
        self._mass = _mass_matrix(self.tree)
        self._sliding = {
            b.joint: self.tree.sliding_placement(b.joint) for b in self.tree.bodies if b.slides
        } | {0: self.tree.sliding_placement(0)}
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

    # Names

    @property
    def coordinate_labels(self) -> tuple[Label, ...]:
        """Name and unit of each coordinate."""
        slides = [self.robot.v_labels[i].name for i in self.tree.sliding]
        turning = [
            Label(f"{body.name} {part}{letter}", "m" if part == "r" else "")
            for body in self.tree.turning
            for part in ("r", "d1", "d2", "d3")
            for letter in "xyz"
        ]
        return (*(Label(name, "m") for name in slides), *turning)

    # Configurations

    def integrate(self, q: ca.SX, dv: ca.SX) -> ca.SX:
        """Coordinates moved, q + dv."""
        return q + dv

    def difference(self, q0: ca.SX, q1: ca.SX) -> ca.SX:
        """What leads from q0 to q1."""
        return q1 - q0

    def derivative(self, function: Callable[[ca.SX], ca.SX], q: ca.SX) -> ca.SX:
        """Derivative of `function` at q, which may be any expression."""
        at = ca.SX.sym("q", self.nq)
        return ca.Function("derivative", [at], [ca.jacobian(function(at), at)])(q)

    def placement(self, joint: int, q: ca.SX) -> Placement:
        """Frame of the body that hangs on a joint; the world's for 0."""
        if joint in self._sliding:
            rotation, origin, moves = self._sliding[joint]
            s = q[: len(self.tree.sliding)]
            return Placement(ca.SX(ca.DM(origin)) + ca.sparsify(ca.SX(ca.DM(moves))) @ s, _constant(rotation))
        body = self.tree.body(joint)
        D = ca.reshape(q[body.at + 3 : body.at + SIZE], 3, 3)
        return Placement(q[body.at : body.at + 3] - D @ _constant(body.lever), D)

    def frame_position(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Position of a frame's origin in the world, shape (3,) [m]."""
        frame = self.robot.model.frames[frame_id]
        at = self.placement(int(frame.parentJoint), q)
        return at.origin + at.axes @ _constant(frame.placement.translation)

    def frame_rotation(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Axes of a frame in the world, shape (3, 3)."""
        frame = self.robot.model.frames[frame_id]
        return self.placement(int(frame.parentJoint), q).axes @ _constant(frame.placement.rotation)

    def frame_translation_jacobian(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Velocity of a frame's origin in world axes per rate of the coordinates, shape (3, nv)."""
        return self.derivative(lambda at: self.frame_position(frame_id, at), q)

    def relative(self, body: Body, q: ca.SX) -> Placement:
        """Frame of a body in its joint's own frame on the parent: the joint's displacement."""
        parent, at = self.placement(body.parent, q), self.placement(body.joint, q)
        axes = parent.axes @ _constant(body.rotation)
        base = parent.origin + parent.axes @ _constant(body.translation)
        return Placement(axes.T @ (at.origin - base), axes.T @ at.axes)

    def joint_displacement(self, joint_id: int, q: ca.SX) -> ca.SX:
        """Displacement of a joint with one axis [rad, m]; an angle is between -pi and pi."""
        body = self.tree.body(joint_id)
        if body.slides:
            return q[self.tree.sliding.index(body.at_v)]
        moved = self.relative(body, q)
        if body.kind == "prismatic":
            return ca.dot(_constant(body.axis), moved.origin)
        cosine, sine = turn(body, moved.axes)
        return ca.atan2(sine, cosine)

    # Equations of motion

    def mass_matrix(self, q: ca.SX) -> ca.SX:
        """M, shape (nv, nv); constant but for rotors."""
        rotors, g = self._rotors(q)
        return self._mass + g.T @ (_scaled(rotors, g)) if rotors.size else self._mass

    def mass_at(self, z: Array) -> Array:
        """M at coordinates z as numbers, shape (nv, nv)."""
        q = ca.SX.sym("q", self.nq)
        found: Array = ca.Function("M", [q], [self.mass_matrix(q)])(z).full()
        return found

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
        """B(q) u plus the force elements', shape (nv,)."""
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
            wrench = self._push(
                joint, at.axes @ _constant(rotation @ direction[:3]), frame.placement.translation, q
            )
            wrench += self._twist(joint, rotation @ direction[3:], q)
            total += wrench * u[actuation.selection.shape[1] + k]
        for element in self.robot.forces:
            total += force_element_force(element, self, q, v)
        return total

    def potential_energy(self, q: ca.SX) -> ca.SX:
        """Potential energy of gravity and of the force elements [J]."""
        energy = -ca.dot(self._gravity(), q) + self._gravity_at_zero()
        for element in self.robot.forces:
            energy += force_element_energy(element, self, q)
        return energy

    def constraints(self, q: ca.SX) -> ca.SX:
        """Phi(q), shape (nc,): body by body orthonormality and joint, then the robot's own constraints."""
        return self._constraints(q)

    def constraint_jacobian(self, q: ca.SX) -> ca.SX:
        """dPhi_dq, shape (nc, nv); linear in q but for couplings."""
        return self.derivative(self.constraints, q)

    # Joint quantities

    def joint_coordinates(self, q: ca.SX) -> ca.SX:
        """Joint configuration with rotation matrices, as `mbocp.lie.ConfigurationSpace` has it with "dcm"."""
        found = []
        for body in self.tree.bodies:
            if body.leader:
                continue
            if body.slides:
                at = self.tree.sliding.index(body.at_v)
                found.append(q[at : at + body.axes.shape[1]])
            else:
                found.append(self._coordinates(body, q))
        return ca.vertcat(*found)

    def joint_velocity(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Velocities of the joints, shape (robot.nv,) [rad/s, m/s]."""
        out = ca.SX.zeros(self.robot.nv)
        for body in self.tree.bodies:
            if body.leader:
                continue
            width = body.axes.shape[1]
            if body.slides:
                at = self.tree.sliding.index(body.at_v)
                out[body.at_v : body.at_v + width] = v[at : at + width]
            else:
                twist = self._relative_twist(body, q, v)
                out[body.at_v : body.at_v + width] = _constant(np.linalg.pinv(body.axes)) @ twist
        return out

    def joint_difference(self, goal: ca.SX, q: ca.SX, parts: Sequence[int] | None = None) -> ca.SX:
        """Tangent vector of the joints from `goal` to q, shape (robot.nv,); angles the shorter way round.

        Parameters
        ----------
        goal : casadi.SX
            As `joint_coordinates` returns it.
        parts : sequence of int, optional
            Parts of the joints' configuration space that matter; zeros for the others.
        """
        at = self.joint_coordinates(q)
        wanted = range(len(self.joint_space.parts)) if parts is None else parts
        away = self.joint_space.partial_difference(goal, at, wanted)
        for body in self.tree.turning:
            if body.kind == "revolute" and not body.leader:
                angle = away[body.at_v]
                away[body.at_v] = ca.atan2(ca.sin(angle), ca.cos(angle))
        return away

    def joint_momentum(self, q: ca.SX, p: ca.SX) -> ca.SX:
        """Canonical momenta of the joints, J' p, shape (robot.nv,)."""
        return self.joint_motions(q).T @ p

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
            axes = parent.axes @ _constant(body.rotation)
            away = (
                self.placement(body.joint, q).origin
                - parent.origin
                - parent.axes @ _constant(body.translation)
            )
            yield from joint_rows(body, axes, away, D)
            if body.leader:
                own = self.joint_displacement(body.joint, q)
                yield JointRow(
                    body,
                    "follows",
                    "rad" if body.kind == "revolute" else "m",
                    own - body.ratio * self.joint_displacement(body.leader, q),
                )

    def _loops(self, q: ca.SX) -> ca.SX:
        if not self.robot.constraints:
            return ca.SX.zeros(0, 1)
        rows = ca.vertcat(*(constraint_rows(c, self, q) for c in self.robot.constraints))
        return rows[list(self.robot.kept_rows)]

    def _gravity(self) -> ca.SX:
        """Generalised force of gravity, constant, shape (nv,)."""
        g = np.asarray(self.robot.model.gravity.linear)
        force = np.zeros(self.nv)
        for body in self.tree.bodies:
            if body.slides:
                force[: len(self.tree.sliding)] += body.mass * self._sliding[body.joint][2].T @ g
            else:
                force[body.at : body.at + 3] = body.mass * g
        return ca.sparsify(ca.SX(ca.DM(force)))

    def _gravity_at_zero(self) -> float:
        g, energy = np.asarray(self.robot.model.gravity.linear), 0.0
        for body in self.tree.bodies:
            if body.slides:
                rotation, origin, _ = self._sliding[body.joint]
                energy -= body.mass * float(g @ (origin + rotation @ body.lever))
        return energy

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
        total = self._push(body.joint, at.axes @ _constant(force), np.zeros(3), q)
        total += self._twist(body.joint, moment, q)
        if not body.parent:
            return total
        parent = self.placement(body.parent, q)
        turned = body.kind in ("revolute", "continuous", "prismatic")
        if np.any(force):  # the reaction, at the same point of the parent
            where: Array | ca.SX = body.translation  # on the line along which a prismatic joint pushes
            along = parent.axes @ _constant(body.rotation @ force) if turned else at.axes @ _constant(force)
            if not turned:
                where = parent.axes.T @ (at.origin - parent.origin)
            total -= self._push(body.parent, along, where, q)
        if np.any(moment):
            about = body.rotation @ moment if turned else parent.axes.T @ (at.axes @ _constant(moment))
            total -= self._twist(body.parent, about, q)
        return total

    def _push(self, joint: int, force: ca.SX, point: Array | ca.SX, q: ca.SX) -> ca.SX:
        """Force in world axes on a point of a body, given in the body's frame."""
        out = ca.SX.zeros(self.nv)
        if joint in self._sliding:
            out[: len(self.tree.sliding)] = ca.sparsify(ca.SX(ca.DM(self._sliding[joint][2]))).T @ force
            return out
        body = self.tree.body(joint)
        arm = (_constant(point) if isinstance(point, np.ndarray) else point) - _constant(body.lever)
        out[body.at : body.at + 3] = force
        out[body.at + 3 : body.at + SIZE] = ca.vec(force @ arm.T)
        return out

    def _twist(self, joint: int, moment: Array | ca.SX, q: ca.SX) -> ca.SX:
        """Moment on a body, given in the body's own axes."""
        out = ca.SX.zeros(self.nv)
        if joint in self._sliding:
            return out
        body = self.tree.body(joint)
        a = _constant(moment) if isinstance(moment, np.ndarray) else moment
        out[body.at + 3 : body.at + SIZE] = ca.vec(self.placement(joint, q).axes @ ca.skew(a)) / 2
        return out

    def _rates(self, joint: int, q: ca.SX, v: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Velocity of a body's origin and its angular velocity, in world axes."""
        if joint in self._sliding:
            moves = ca.sparsify(ca.SX(ca.DM(self._sliding[joint][2])))
            return moves @ v[: len(self.tree.sliding)], ca.SX.zeros(3)
        body = self.tree.body(joint)
        D, rates = self.placement(joint, q).axes, ca.reshape(v[body.at + 3 : body.at + SIZE], 3, 3)
        spin = sum((ca.cross(D[:, k], rates[:, k]) for k in range(3)), start=ca.SX.zeros(3)) / 2
        return v[body.at : body.at + 3] - rates @ _constant(body.lever), spin

    def _relative_twist(self, body: Body, q: ca.SX, v: ca.SX) -> ca.SX:
        """Motion of a body against its parent in its own frame, linear before angular, shape (6,)."""
        at, parent = self.placement(body.joint, q), self.placement(body.parent, q)
        linear, angular = self._rates(body.joint, q, v)
        base, spin = self._rates(body.parent, q, v)
        linear = linear - base - ca.cross(spin, at.origin - parent.origin)
        return ca.vertcat(at.axes.T @ linear, at.axes.T @ (angular - spin))

    def joint_motions(self, q: ca.SX) -> ca.SX:
        """Derivative J of the coordinates in the joints' motions, shape (nv, robot.nv)."""
        J = ca.SX.zeros(self.nv, self.robot.nv)
        for body in self.tree.bodies:
            owner, ratio = (self.tree.body(body.leader), body.ratio) if body.leader else (body, 1.0)
            for k in range(body.axes.shape[1]):
                J[:, owner.at_v + k] += ratio * self._moved_by(body, k, q)
        return J

    def _moved_by(self, body: Body, component: int, q: ca.SX) -> ca.SX:
        """How everything beyond a joint moves with one of its velocities, shape (nv,)."""
        out = ca.SX.zeros(self.nv)
        at = self.placement(body.joint, q)
        linear, spin = (at.axes @ _constant(part) for part in body.axes[:, component].reshape(2, 3))
        if body.slides:
            out[self.tree.sliding.index(body.at_v) + component] = 1
        for other in self.tree.turning:
            if body.joint in self.robot.model.supports[other.joint]:
                r, D = q[other.at : other.at + 3], self.placement(other.joint, q).axes
                out[other.at : other.at + 3] = linear + ca.cross(spin, r - at.origin)
                out[other.at + 3 : other.at + SIZE] = ca.vertcat(*(ca.cross(spin, D[:, k]) for k in range(3)))
        return out

    def _coordinates(self, body: Body, q: ca.SX) -> ca.SX:
        moved = self.relative(body, q)
        if body.kind in ("revolute", "continuous"):
            cosine, sine = turn(body, moved.axes)
            return ca.vertcat(cosine, sine) if body.kind == "continuous" else ca.atan2(sine, cosine)
        if body.kind == "prismatic":
            return ca.dot(_constant(body.axis), moved.origin)
        if body.kind == "planar":
            cosine, sine = (
                (moved.axes[0, 0] + moved.axes[1, 1]) / 2,
                (moved.axes[1, 0] - moved.axes[0, 1]) / 2,
            )
            return ca.vertcat(moved.origin[:2], cosine, sine)
        if body.kind == "translation":
            return moved.origin
        matrix = ca.vec(moved.axes)
        return matrix if body.kind == "spherical" else ca.vertcat(moved.origin, matrix)


def turn(body: Body, axes: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Cosine and sine of the angle of a joint with one axis, from the rotation that it makes."""
    first, second = perpendiculars(body.axis)
    return (
        ca.dot(_constant(first), axes @ _constant(first)),
        ca.dot(_constant(second), axes @ _constant(first)),
    )


def _scaled(factors: Array, rows: ca.SX) -> ca.SX:
    """Rows times a factor each."""
    return ca.diag(ca.SX(ca.DM(factors))) @ rows


def _constant(value: ArrayLike) -> ca.SX:
    """A constant with structural zeros; what turns by right angles leaves round-off behind."""
    array = np.asarray(value, dtype=float)
    return ca.sparsify(ca.SX(ca.DM(np.where(np.abs(array) < _ROUND_OFF, 0.0, array))))


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

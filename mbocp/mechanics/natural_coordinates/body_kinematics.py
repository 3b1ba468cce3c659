"""Bodies in natural coordinates: where they are, how they move, what their joints do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from mbocp._arrays import Array
from mbocp.lie import ConfigurationSpace
from mbocp.lie.groups import vee
from mbocp.mechanics.natural_coordinates.bodies import SIZE, Body, BodyTree, body_tree
from mbocp.mechanics.natural_coordinates.joint_rows import perpendiculars
from mbocp.robot import Robot
from mbocp.robot.parts import Label

_ROUND_OFF = 1e-14


class Placement(NamedTuple):
    """Frame of a body in the world: origin [m] and axes (columns)."""

    origin: ca.SX
    axes: ca.SX


class NaturalKinematics:
    """Symbolic kinematics of a robot in natural coordinates q, with their rates v.

    Parameters
    ----------
    robot : Robot

    Attributes
    ----------
    tree : BodyTree
    nq, nv : int
        Number of coordinates, and of their rates (the same).
    joint_space : ConfigurationSpace
        What `joint_coordinates` are coordinates of.

    Raises
    ------
    UnsupportedRobot
        If natural coordinates cannot describe the robot, naming the joint.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.tree: BodyTree = body_tree(robot)
        self.nq = self.nv = self.tree.n
        self.joint_space = ConfigurationSpace(robot.model, "dcm")
        self.sliding = {
            joint: self.tree.sliding_placement(joint)
            for joint in (0, *(b.joint for b in self.tree.bodies if b.slides))
        }

    # Coordinates

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

    def integrate(self, q: ca.SX, dv: ca.SX) -> ca.SX:
        """Coordinates moved, q + dv."""
        return q + dv

    def difference(self, q0: ca.SX, q1: ca.SX) -> ca.SX:
        """What leads from q0 to q1."""
        return q1 - q0

    def end_difference(self, goal: ca.SX, q: ca.SX) -> ca.SX:
        """What an end condition holds at zero: what leads from the goal to q."""
        return self.difference(goal, q)

    def derivative(self, function: Callable[[ca.SX], ca.SX], q: ca.SX) -> ca.SX:
        """Derivative of `function` at q, which may be any expression."""
        at = ca.SX.sym("q", self.nq)
        return ca.Function("derivative", [at], [ca.jacobian(function(at), at)])(q)

    # Places

    def placement(self, joint: int, q: ca.SX) -> Placement:
        """Frame of the body that hangs on a joint; the world's for 0."""
        if joint in self.sliding:
            rotation, origin, moves = self.sliding[joint]
            s = q[: len(self.tree.sliding)]
            return Placement(ca.SX(ca.DM(origin)) + ca.sparsify(ca.SX(ca.DM(moves))) @ s, constant(rotation))
        body = self.tree.body(joint)
        D = ca.reshape(q[body.at + 3 : body.at + SIZE], 3, 3)
        return Placement(q[body.at : body.at + 3] - D @ constant(body.lever), D)

    def frame_position(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Position of a frame's origin in the world, shape (3,) [m]."""
        frame = self.robot.model.frames[frame_id]
        at = self.placement(int(frame.parentJoint), q)
        return at.origin + at.axes @ constant(frame.placement.translation)

    def centre_of_mass(self, q: ca.SX) -> ca.SX:
        """Centre of mass in the world, shape (3,) [m]."""
        total, first = 0.0, ca.SX.zeros(3)
        for joint, inertia in self._masses():
            at = self.placement(joint, q)
            first += inertia.mass * (at.origin + at.axes @ constant(inertia.lever))
            total += inertia.mass
        return first / total

    def centroidal_momentum(self, q: ca.SX, v: ca.SX) -> ca.SX:
        """Momentum about the centre of mass, axes of the world, linear first, shape (6,) [kg m/s, N m s].

        With the second moments of a body, J = tr(I)/2 1 - I, the angular part is the axial vector of D J D'.
        """
        c = self.centre_of_mass(q)
        linear, angular = ca.SX.zeros(3), ca.SX.zeros(3)
        for joint, inertia in self._masses():
            at = self.placement(joint, q)
            centre = at.origin + at.axes @ constant(inertia.lever)
            p = inertia.mass * ca.jtimes(centre, q, v)
            moments = np.trace(inertia.inertia) / 2 * np.eye(3) - inertia.inertia
            turning = ca.reshape(ca.jtimes(ca.vec(at.axes), q, v), 3, 3) @ constant(moments) @ at.axes.T
            linear += p
            angular += ca.cross(centre - c, p) + 2 * vee(turning)
        return ca.vertcat(linear, angular)

    def _masses(self) -> Iterator[tuple[int, pin.Inertia]]:
        """Joints that carry bodies with mass, and these."""
        inertias = self.robot.model.inertias
        return ((joint, inertias[joint]) for joint in range(1, len(inertias)) if inertias[joint].mass > 0.0)

    def frame_rotation(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Axes of a frame in the world, shape (3, 3)."""
        frame = self.robot.model.frames[frame_id]
        return self.placement(int(frame.parentJoint), q).axes @ constant(frame.placement.rotation)

    def frame_translation_jacobian(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Velocity of a frame's origin in world axes per rate of the coordinates, shape (3, nv)."""
        return self.derivative(lambda at: self.frame_position(frame_id, at), q)

    def frame_rotation_jacobian(self, frame_id: int, q: ca.SX) -> ca.SX:
        """Angular velocity of a frame in world axes per rate of the coordinates, shape (3, nv).

        Half the sum of the products d x d' of its axes d.
        """
        axes = self.frame_rotation(frame_id, q)
        rates = self.derivative(lambda at: ca.vec(self.frame_rotation(frame_id, at)), q)
        turns = [ca.skew(axes[:, i]) @ rates[3 * i : 3 * i + 3, :] / 2 for i in range(3)]
        return turns[0] + turns[1] + turns[2]

    def relative(self, body: Body, q: ca.SX) -> Placement:
        """Frame of a body in its joint's own frame on the parent: the joint's displacement."""
        parent, at = self.placement(body.parent, q), self.placement(body.joint, q)
        axes = parent.axes @ constant(body.rotation)
        base = parent.origin + parent.axes @ constant(body.translation)
        return Placement(axes.T @ (at.origin - base), axes.T @ at.axes)

    def joint_displacement(self, joint_id: int, q: ca.SX) -> ca.SX:
        """Displacement of a joint with one axis [rad, m]; an angle is between -pi and pi."""
        body = self.tree.body(joint_id)
        if body.slides:
            return q[self.tree.sliding.index(body.at_v)]
        moved = self.relative(body, q)
        if body.kind == "prismatic":
            return ca.dot(constant(body.axis), moved.origin)
        cosine, sine = turn(body, moved.axes)
        return ca.atan2(sine, cosine)

    # Motions and forces

    def push(self, joint: int, force: ca.SX, point: Array | ca.SX, q: ca.SX) -> ca.SX:
        """Force in world axes on a point of a body, given in the body's frame."""
        out = ca.SX.zeros(self.nv)
        if joint in self.sliding:
            out[: len(self.tree.sliding)] = ca.sparsify(ca.SX(ca.DM(self.sliding[joint][2]))).T @ force
            return out
        body = self.tree.body(joint)
        arm = (constant(point) if isinstance(point, np.ndarray) else point) - constant(body.lever)
        out[body.at : body.at + 3] = force
        out[body.at + 3 : body.at + SIZE] = ca.vec(force @ arm.T)
        return out

    def twist(self, joint: int, moment: Array | ca.SX, q: ca.SX) -> ca.SX:
        """Moment on a body, given in the body's own axes."""
        out = ca.SX.zeros(self.nv)
        if joint in self.sliding:
            return out
        body = self.tree.body(joint)
        a = constant(moment) if isinstance(moment, np.ndarray) else moment
        out[body.at + 3 : body.at + SIZE] = ca.vec(self.placement(joint, q).axes @ ca.skew(a)) / 2
        return out

    def rates(self, joint: int, q: ca.SX, v: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Velocity of a body's origin and its angular velocity, in world axes."""
        if joint in self.sliding:
            moves = ca.sparsify(ca.SX(ca.DM(self.sliding[joint][2])))
            return moves @ v[: len(self.tree.sliding)], ca.SX.zeros(3)
        body = self.tree.body(joint)
        D, rates = self.placement(joint, q).axes, ca.reshape(v[body.at + 3 : body.at + SIZE], 3, 3)
        spin = sum((ca.cross(D[:, k], rates[:, k]) for k in range(3)), start=ca.SX.zeros(3)) / 2
        return v[body.at : body.at + 3] - rates @ constant(body.lever), spin

    def relative_twist(self, body: Body, q: ca.SX, v: ca.SX) -> ca.SX:
        """Motion of a body against its parent in its own frame, linear before angular, shape (6,)."""
        at, parent = self.placement(body.joint, q), self.placement(body.parent, q)
        linear, angular = self.rates(body.joint, q, v)
        base, spin = self.rates(body.parent, q, v)
        linear = linear - base - ca.cross(spin, at.origin - parent.origin)
        return ca.vertcat(at.axes.T @ linear, at.axes.T @ (angular - spin))

    # Joints

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
                twist = self.relative_twist(body, q, v)
                out[body.at_v : body.at_v + width] = constant(np.linalg.pinv(body.axes)) @ twist
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

    def joint_motions(self, q: ca.SX) -> ca.SX:
        """Derivative J of the coordinates in the joints' motions, shape (nv, robot.nv)."""
        J = ca.SX.zeros(self.nv, self.robot.nv)
        for body in self.tree.bodies:
            owner, ratio = (self.tree.body(body.leader), body.ratio) if body.leader else (body, 1.0)
            for k in range(body.axes.shape[1]):
                J[:, owner.at_v + k] += ratio * self._motion_by(body, k, q)
        return J

    def _motion_by(self, body: Body, component: int, q: ca.SX) -> ca.SX:
        """How everything beyond a joint moves with one of its velocities, shape (nv,)."""
        out = ca.SX.zeros(self.nv)
        at = self.placement(body.joint, q)
        linear, spin = (at.axes @ constant(part) for part in body.axes[:, component].reshape(2, 3))
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
            return ca.dot(constant(body.axis), moved.origin)
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
    return (ca.dot(constant(first), axes @ constant(first)), ca.dot(constant(second), axes @ constant(first)))


def constant(value: ArrayLike) -> ca.SX:
    """A constant with structural zeros; what turns by right angles leaves round-off behind."""
    array = np.asarray(value, dtype=float)
    return ca.sparsify(ca.SX(ca.DM(np.where(np.abs(array) < _ROUND_OFF, 0.0, array))))

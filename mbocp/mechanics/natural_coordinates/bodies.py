r"""The bodies of a robot in natural coordinates: what each consists of, and how its joint ties it.

A moving body has twelve numbers: the position r of its centre of mass and its three directors, the columns of
its rotation D (de Sapio and others; director scale 1). Its kinetic energy is

.. math:: T = \tfrac12 m |\dot r|^2 + \tfrac12 \sum_{kl} E_{kl}\, \dot d_k \cdot \dot d_l,
          \qquad E = \tfrac12 \operatorname{tr}(I)\,1 - I,

with the Euler tensor E of its inertia I about the centre of mass: the mass matrix is constant. Bodies that
only slide (prismatic and translation joints all the way down to the world) keep their joint coordinates,
in which nothing is redundant and the mass matrix is constant already: a point mass has three numbers.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.exceptions import UnsupportedRobot
from mbocp.robot import Robot
from mbocp.robot.joints import joint_kind
from mbocp.robot.large import make_working_data

SIZE = 12  # numbers of a body
TURNING = ("revolute", "continuous")  # joints whose displacement is an angle, known up to full turns
_ROUND_OFF = 1e-12
_PROBE_DISPLACEMENT = 0.1  # [rad, m] displacement at which a follower's motion is looked at


@dataclass(frozen=True, eq=False)
class Body:
    """One moving body and the joint that ties it to its parent.

    Attributes
    ----------
    joint : int
        Of the Pinocchio model; the body is what hangs on it.
    name : str
        Of the joint.
    kind : str
        Word of the joint's kind; a follower's is "revolute" or "prismatic".
    parent : int
        Joint of the parent body, 0 for the world.
    at : int
        Where its numbers begin in the coordinates; -1 for a body that slides.
    mass : float
        [kg].
    lever : ndarray, shape (3,)
        Centre of mass in the joint's frame [m].
    euler : ndarray, shape (3, 3)
        Euler tensor about the centre of mass, in the joint's axes [kg m^2].
    rotation, translation : ndarray, shapes (3, 3), (3,)
        Placement of the joint in the parent's frame at zero displacement.
    axes : ndarray, shape (6, n)
        Motion of the joint for each of its velocities, linear before angular, in the body's frame; of a
        follower for a unit displacement of its own.
    at_q, at_v : int
        Where the joint's numbers begin in q and v; -1 for a follower.
    leader, ratio : int, float
        Joint that a follower (mimic joint) goes with, and how fast; 0 for others. Its displacement is zero
        where the leader's is.
    """

    joint: int
    name: str
    kind: str
    parent: int
    at: int
    mass: float
    lever: Array
    euler: Array
    rotation: Array
    translation: Array
    axes: Array
    at_q: int
    at_v: int
    leader: int = 0
    ratio: float = 0.0

    @property
    def slides(self) -> bool:
        """Whether it keeps its joint coordinates."""
        return self.at < 0

    def moves(self, dof: int) -> bool:
        """Whether a velocity component of the robot is one of its joint's own."""
        return bool(0 <= self.at_v <= dof < self.at_v + self.axes.shape[1])

    @property
    def axis(self) -> Array:
        """Direction of a joint with one axis, in its own frame, shape (3,)."""
        linear, angular = self.axes[:3, 0], self.axes[3:, 0]
        along: Array = linear if self.kind == "prismatic" else angular
        return along / np.linalg.norm(along)


@dataclass(frozen=True, eq=False)
class BodyTree:
    """All bodies of a robot, and where their numbers are: sliding coordinates, then twelve a body.

    Attributes
    ----------
    robot : Robot
    bodies : tuple of Body
        In the order of the joints: parents first.
    sliding : ndarray of int, shape (ns,)
        Which numbers of v (and of q: `sliding_q`) the first ns coordinates are.
    n : int
        Number of coordinates.
    """

    robot: Robot
    bodies: tuple[Body, ...]
    sliding: tuple[int, ...]
    sliding_q: tuple[int, ...]

    @property
    def n(self) -> int:
        """Number of coordinates."""
        return len(self.sliding) + SIZE * sum(not body.slides for body in self.bodies)

    @property
    def turning(self) -> tuple[Body, ...]:
        """Bodies with twelve numbers."""
        return tuple(body for body in self.bodies if not body.slides)

    def body(self, joint: int) -> Body:
        """Body on a joint (not the world, 0)."""
        return self.bodies[joint - 1]

    def sliding_placement(self, joint: int) -> tuple[Array, Array, Array]:
        """R, p0, A of a sliding body's (or the world's) frame: rotation R, origin p0 + A s."""
        model = self.robot.model
        if joint == 0:
            return np.eye(3), np.zeros(3), np.zeros((3, len(self.sliding)))
        q = pin.neutral(model)
        data = make_working_data(model)
        pin.computeJointJacobians(model, data, q)
        jacobian = pin.getJointJacobian(model, data, joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, model.nv)
        at = data.oMi[joint]
        origin = at.translation.copy()
        moves = np.asarray(jacobian[:3][:, list(self.sliding)])
        return at.rotation.copy(), origin, moves

    def coordinates(self, qs: Array) -> Array:
        """Natural coordinates of joint configurations, shape (k, n) from (k, nq)."""
        model = self.robot.model
        data = make_working_data(model)
        out = np.empty((len(qs), self.n))
        out[:, : len(self.sliding)] = qs[:, list(self.sliding_q)]
        turning = self.turning
        for row, q in zip(out, qs, strict=True):
            pin.forwardKinematics(model, data, q)
            for body in turning:
                at = data.oMi[body.joint]
                row[body.at : body.at + 3] = at.translation + at.rotation @ body.lever
                row[body.at + 3 : body.at + SIZE] = at.rotation.ravel(order="F")
        return out

    def jacobian(self, q: Array) -> Array:
        """Derivative of the natural coordinates along the joints' tangent space, shape (n, nv)."""
        model = self.robot.model
        data = make_working_data(model)
        pin.computeJointJacobians(model, data, q)
        out = np.zeros((self.n, model.nv))
        for i, dof in enumerate(self.sliding):
            out[i, dof] = 1.0
        for body in self.turning:
            at = data.oMi[body.joint]
            J = pin.getJointJacobian(model, data, body.joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, model.nv)
            linear, angular = J[:3], J[3:]
            arms = [at.rotation @ body.lever, *at.rotation.T]
            for k, arm in enumerate(arms):
                block = np.cross(angular.T, arm).T
                out[body.at + 3 * k : body.at + 3 * k + 3] = block + linear if k == 0 else block
        return out


def body_tree(robot: Robot) -> BodyTree:
    """Bodies of a robot.

    Raises
    ------
    UnsupportedRobot
        For what natural coordinates cannot describe, naming the joint: helical joints, drives, followers of
        a leader that may turn by more than half a turn, other than by whole turns.
    """
    model = robot.model
    _refuse(robot)
    placements = _placements(model, pin.neutral(model))
    data = make_working_data(model)
    pin.computeJointJacobians(model, data, pin.neutral(model))
    bodies: list[Body] = []
    sliding: list[tuple[int, int]] = []
    at = 0
    for joint in range(1, model.njoints):
        parent, kind = int(model.parents[joint]), joint_kind(model, joint).word
        slides = kind in ("prismatic", "translation") and (parent == 0 or bodies[parent - 1].slides)
        if slides:
            first = model.joints[joint]
            sliding += [(first.idx_v + i, first.idx_q + i) for i in range(first.nv)]
        bodies.append(_body(robot, joint, kind, -1 if slides else at, placements[joint], data))
        at += 0 if slides else SIZE
    for body in bodies:
        if body.leader:
            _refuse_unknown_turns(robot, body, bodies[body.leader - 1])
    shifted = [body if body.slides else replace(body, at=body.at + len(sliding)) for body in bodies]
    return BodyTree(robot, tuple(shifted), tuple(v for v, _ in sliding), tuple(q for _, q in sliding))


def _refuse(robot: Robot) -> None:
    model = robot.model
    for joint in range(1, model.njoints):
        name = model.names[joint]
        if joint_kind(model, joint).word == "helical":
            raise UnsupportedRobot(
                f"robot {robot.name!r}: joint {name!r} is helical, which natural coordinates do not know; "
                'take coordinates = "joint"'
            )
    if robot.drives:
        raise UnsupportedRobot(
            f"robot {robot.name!r}: drives ({', '.join(d.name for d in robot.drives)}) prescribe motions of "
            'joints, which natural coordinates do not have; take coordinates = "joint"'
        )


def _refuse_unknown_turns(robot: Robot, follower: Body, leader: Body) -> None:
    """Refuse a follower whose place needs the number of full turns of its leader, which coordinates lack."""
    turns_whole = follower.kind in TURNING and abs(follower.ratio - round(follower.ratio)) < _ROUND_OFF
    if leader.kind not in TURNING or turns_whole:
        return
    where, limits = robot.configuration_indices(leader.name), robot.limits
    lower, upper = limits.position_lower[where], limits.position_upper[where]
    if leader.kind == "continuous" or lower.min() < -np.pi or upper.max() > np.pi:
        raise UnsupportedRobot(
            f"robot {robot.name!r}: joint {follower.name!r} follows {leader.name!r} at the ratio "
            f"{follower.ratio:.6g}, and {leader.name!r} may leave -pi ... pi: natural coordinates know an "
            'angle up to full turns; limit that joint in its file, or take coordinates = "joint"'
        )


def _placements(model: pin.Model, q: Array) -> list[pin.SE3]:
    data = make_working_data(model)
    pin.forwardKinematics(model, data, q)
    return [placement.copy() for placement in data.liMi]


def _body(robot: Robot, joint: int, kind: str, at: int, placement: pin.SE3, data: Any) -> Body:
    model = robot.model
    moved, inertia = model.joints[joint], model.inertias[joint]
    at_q, at_v, leader, ratio = moved.idx_q, moved.idx_v, 0, 0.0
    if kind == "mimic":
        kind, axes, leader, ratio = _follower(robot, joint)
        at_q = at_v = -1
    else:
        jacobian = pin.getJointJacobian(model, data, joint, pin.LOCAL).reshape(6, model.nv)
        axes = jacobian[:, moved.idx_v : moved.idx_v + moved.nv]
    return Body(
        joint=joint,
        name=model.names[joint],
        kind=kind,
        parent=int(model.parents[joint]),
        at=at,
        mass=float(inertia.mass),
        lever=frozen_array(inertia.lever),
        euler=frozen_array(0.5 * np.trace(inertia.inertia) * np.eye(3) - inertia.inertia),
        rotation=frozen_array(placement.rotation),
        translation=frozen_array(placement.translation),
        axes=frozen_array(np.where(np.abs(axes) < _ROUND_OFF, 0.0, axes)),
        at_q=at_q,
        at_v=at_v,
        leader=leader,
        ratio=ratio,
    )


def _follower(robot: Robot, joint: int) -> tuple[str, Array, int, float]:
    """Kind, axis, leader and ratio of a mimic joint, from how it moves with each velocity."""
    model = robot.model
    rest = _placements(model, pin.neutral(model))[joint]
    for other in range(1, model.njoints):
        if other == joint or joint_kind(model, other).word not in ("revolute", "continuous", "prismatic"):
            continue
        step = np.zeros(model.nv)
        step[model.joints[other].idx_v] = _PROBE_DISPLACEMENT
        moved = _placements(model, pin.integrate(model, pin.neutral(model), step))[joint]
        twist = pin.log6(rest.inverse() * moved).vector / _PROBE_DISPLACEMENT
        if np.linalg.norm(twist) > _ROUND_OFF:
            kind = "revolute" if np.linalg.norm(twist[3:]) > _ROUND_OFF else "prismatic"
            ratio = float(np.linalg.norm(twist[3:] if kind == "revolute" else twist[:3]))
            return kind, (twist / ratio)[:, None], other, ratio
    raise UnsupportedRobot(
        f"robot {robot.name!r}: mimic joint {model.names[joint]!r} follows no joint with one axis; natural "
        'coordinates need one; take coordinates = "joint"'
    )

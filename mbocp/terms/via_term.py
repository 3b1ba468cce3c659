r"""Via points: what holds of the robot at one node inside the horizon.

Rows, with D a matrix that leaves out those that others and the constraints of the robot decide:

.. math::
    D_q \begin{pmatrix} W^T (q - q^*) \\ p_f - p^* \\ (R^{*T} R_f - R_f^T R^*)^\vee / 2 \\ B^T a
    \end{pmatrix} = 0, \qquad
    D_v \begin{pmatrix} v - v^* \\ \dot p_f - \dot p^* \\ \omega_f - \omega^* \end{pmatrix} = 0,

and with tolerances :math:`|p_f - p^*| \le \delta` for each coordinate, and the cosine of the angle that is
left at least that of the cone. All of them are polynomials in the placement, since path functions are
evaluated at every node, far from the via point, too. Sines vanish at half-turns as well, which a bound on the
cosine excludes.
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca

from mbocp._arrays import dataclass
from mbocp.lie.configuration import JointSpace
from mbocp.lie.groups import vee
from mbocp.terms.bounded import Structure
from mbocp.terms.frame_end import FrameShape
from mbocp.terms.point import Point


@dataclass(frozen=True)
class ViaFrameShape:
    """What is asked of a frame at a via point, without numbers.

    Attributes
    ----------
    shape : FrameShape
    has_box, has_cone : bool
        Whether position and orientation have a tolerance.
    """

    shape: FrameShape
    has_box: bool
    has_cone: bool

    @property
    def exact_rows(self) -> int:
        """Equations on the pose."""
        turning = {"orientation": 3, "axis": 2, "": 0}[self.shape.turn]
        return len(self.shape.coordinates) * (not self.has_box) + turning * (not self.has_cone)

    @property
    def box_rows(self) -> int:
        """Coordinates within a box."""
        return len(self.shape.coordinates) * self.has_box

    def placement(self, at: Point, p: Mapping[str, ca.SX]) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Errors of the position, sines of the rotation that is left, and the cosine of its angle."""
        position, R = self.shape.place(at)
        errors = sines = cosine = ca.SX.zeros(0, 1)
        if self.shape.coordinates:
            errors = (position - p["position"])[list(self.shape.coordinates)]
        if self.shape.turn == "axis":
            a = R @ p["axis"]
            sines, cosine = ca.reshape(p["normals"], 3, 2).T @ a, ca.dot(p["direction"], a)
        elif self.shape.turn:
            E = ca.reshape(p["rotation"], 3, 3).T @ R
            sines, cosine = vee(E), (ca.trace(E) - 1) / 2
        return errors, sines, cosine


@dataclass(frozen=True)
class ViaTerm(Structure):
    """The structure of a via point, as `mbocp.terms.PathTerm` is that of a path constraint.

    Attributes
    ----------
    frames : tuple of ViaFrameShape
    has_q, has_v : bool
        Whether it speaks of the configuration and the velocity of joints.
    nq, nv : int
        Numbers of a configuration in the coordinates of the joints, and of a velocity.
    guarded : tuple of int
        Parts of the configuration, by index, that are to be less than a right angle from what is asked.
    num_pose, num_rate : int
        Equations that are kept.
    """

    frames: tuple[ViaFrameShape, ...]
    has_q: bool
    has_v: bool
    nq: int
    nv: int
    guarded: tuple[int, ...]
    num_pose: int
    num_rate: int

    kind = "via"

    @property
    def has_velocity(self) -> bool:  # type: ignore[override]
        """Whether it depends on the velocity."""
        return self.num_rate > 0

    @property
    def pose_rows(self) -> int:
        """Equations on the configuration before D."""
        return self.nv * self.has_q + sum(frame.exact_rows for frame in self.frames)

    @property
    def rate_rows(self) -> int:
        """Equations on the velocity before D."""
        return self.nv * self.has_v + sum(frame.shape.rate_rows for frame in self.frames)

    @property
    def rows(self) -> int:
        """Number of its values."""
        boxes = sum(frame.box_rows for frame in self.frames)
        return self.num_pose + self.num_rate + boxes + len(self.guarded) + self.num_angles

    @property
    def num_angles(self) -> int:
        """Cosines of angles of frames, at the end of its values."""
        return sum(bool(frame.shape.turn) for frame in self.frames)

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each parameter; matrices by columns."""
        return {
            **({"q": self.nq} if self.has_q else {}),
            **({"v": self.nv} if self.has_v else {}),
            **{f"{k}.{n}": size for k, f in enumerate(self.frames) for n, size in f.shape.sizes.items()},
            "D_pose": self.num_pose * self.pose_rows,
            "D_rate": self.num_rate * self.rate_rows,
        }

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Equations, boxes and cosines, one below the other."""
        poses, rates, boxes, cosines = ([ca.SX.zeros(0, 1)] for _ in range(4))
        if self.has_q:
            space, q = at.mechanics.joint_space, at.joint_configuration()
            poses.append(space.projection(p["q"], q))
            cosines += [_turn_below(space.parts[i], p["q"], q) for i in self.guarded]
        if self.has_v:
            rates.append(at.joint_velocity() - p["v"])
        for k, frame in enumerate(self.frames):
            own = {name: p[f"{k}.{name}"] for name in frame.shape.sizes}
            position, sines, cosine = frame.placement(at, own)
            (boxes if frame.has_box else poses).append(position)
            if not frame.has_cone:
                poses.append(sines)
            cosines.append(cosine)
            rates.append(frame.shape.rates(at, own))
        return ca.vertcat(
            ca.reshape(p["D_pose"], self.num_pose, self.pose_rows) @ ca.vertcat(*poses),
            ca.reshape(p["D_rate"], self.num_rate, self.rate_rows) @ ca.vertcat(*rates),
            *boxes,
            *cosines,
        )


def _turn_below(part: JointSpace, goal: ca.SX, z: ca.SX) -> ca.SX:
    """What is positive where a part is turned by less than a right angle."""
    guards = part.group.guards(goal[part.at_z], z[part.at_z])
    if guards:
        return guards[0]
    attitude = slice(part.at_z.stop - 4, part.at_z.stop)  # a unit quaternion: cos = 2 (q* . q)^2 - 1
    return 2 * ca.dot(goal[attitude], z[attitude]) ** 2 - 1

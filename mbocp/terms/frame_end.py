r"""Goals of frames: end conditions on pose and velocity, or what it costs to miss them.

Rows of a pose, in the axes of a reference frame r that stands still or moves:

.. math::
    R_r^T (p_f - p_r) - p^* \quad [\mathrm{m}], \qquad
    2\, \frac{(D - D^T)^\vee}{1 + \mathrm{tr}\, D} = 2 \tan\tfrac{\theta}{2}\, n \quad
    \text{with } D = R^{*T} R_r^T R_f

where theta is the angle and n the axis of the rotation from the orientation that is asked for. An axis a that
is to point along d has the two rows

.. math:: 2\, \frac{B^T a}{1 + d^T a}, \qquad B^T d = 0,

the stereographic image of a, of length :math:`2 \tan(\theta/2)`. Both are the angle itself to second order,
smooth for :math:`\theta < \pi`, and vanish at the goal alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass, largest_entry
from mbocp.exceptions import ProblemError
from mbocp.robot import Robot
from mbocp.robot.poses.target import normals_to
from mbocp.terms.frame_goal import FrameGoal
from mbocp.terms.point import Point


@dataclass(frozen=True)
class FrameShape:
    """What is asked of a frame, without numbers.

    Attributes
    ----------
    frame, reference : int
        Indices of the frame and of that in whose axes its pose is; 0 is the world.
    coordinates : tuple of int
        Coordinates of its origin.
    turn : {"orientation", "axis", ""}
        What is asked of its axes.
    velocity, angular_velocity : bool
    """

    frame: int
    reference: int
    coordinates: tuple[int, ...]
    turn: str
    velocity: bool
    angular_velocity: bool

    @classmethod
    def of(cls, goal: FrameGoal, robot: Robot) -> FrameShape:
        """The shape of a goal."""
        target = goal.target
        return cls(
            frame=robot.frame_id(target.name),
            reference=robot.frame_id(target.relative_to),
            coordinates=tuple(int(i) for i in target.coordinates),
            turn="orientation"
            if target.orientation is not None
            else "axis"
            if target.axis is not None
            else "",
            velocity=goal.velocity is not None,
            angular_velocity=goal.angular_velocity is not None,
        )

    @property
    def pose_rows(self) -> int:
        """Rows on the pose."""
        return len(self.coordinates) + {"orientation": 3, "axis": 2, "": 0}[self.turn]

    @property
    def rate_rows(self) -> int:
        """Rows on the velocity."""
        return 3 * (self.velocity + self.angular_velocity)

    @property
    def sizes(self) -> dict[str, int]:
        """Size of each parameter."""
        turning = {"orientation": {"rotation": 9}, "axis": {"axis": 3, "direction": 3, "normals": 6}, "": {}}
        return {
            **({"position": 3} if self.coordinates else {}),
            **turning[self.turn],
            **({"rates": self.rate_rows} if self.rate_rows else {}),
        }

    @staticmethod
    def numbers(goal: FrameGoal) -> dict[str, Array]:
        """Value of each parameter, and of others that the shape has no use for; matrices by columns."""
        target = goal.target
        found = {"rates": goal.rates, "rotation": target.rotation.ravel(order="F")}
        if target.position is not None:
            found["position"] = np.nan_to_num(target.position)
        if target.axis is not None and target.direction is not None:
            found |= {"axis": target.axis, "direction": target.direction}
            found["normals"] = normals_to(target.direction).ravel(order="F")
        return found

    def numbers_at(self, name: str, pose: Array) -> dict[str, Array]:
        """Values of the parameters that say where a frame is to be.

        Parameters
        ----------
        name : str
            The frame.
        pose : ndarray, shape (4, 4) or (3,)
            Homogeneous matrix in its reference frame, or the position alone [m].

        Raises
        ------
        ProblemError
            If a direction of an axis is asked for, whose numbers are not those of a pose.
        """
        found = {}
        if self.coordinates:
            found["position"] = pose if pose.shape == (3,) else pose[:3, 3]
        if self.turn == "orientation" and pose.shape != (3,):
            found["rotation"] = pose[:3, :3].ravel(order="F")
        if self.turn == "axis" and pose.shape != (3,):
            raise ProblemError(f"goal.{name}: has an axis and a direction; give its position (3,) alone")
        return found

    def pose(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Rows that are zero at the pose."""
        position, R = self.place(at)
        rows = [(position - p["position"])[list(self.coordinates)]] if self.coordinates else []
        return ca.vertcat(ca.SX.zeros(0, 1), *rows, *([self._turn(R, p)] if self.turn else []))

    def place(self, at: Point) -> tuple[ca.SX, ca.SX]:
        """Origin [m] and axes of the frame in those of the reference frame."""
        mechanics = at.mechanics
        position, R = mechanics.frame_position(self.frame, at.q), mechanics.frame_rotation(self.frame, at.q)
        if self.reference:
            R_r = mechanics.frame_rotation(self.reference, at.q)
            position = R_r.T @ (position - mechanics.frame_position(self.reference, at.q))
            R = R_r.T @ R
        return position, R

    def _turn(self, R: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
        if self.turn == "axis":
            a = R @ p["axis"]
            return 2 * (ca.reshape(p["normals"], 3, 2).T @ a) / (1 + ca.dot(p["direction"], a))
        D = ca.reshape(p["rotation"], 3, 3).T @ R
        vee = ca.vertcat(D[2, 1] - D[1, 2], D[0, 2] - D[2, 0], D[1, 0] - D[0, 1])
        return 2 * vee / (1 + ca.trace(D))

    def rates(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """Rows that are zero at the velocity."""
        mechanics, jacobians = at.mechanics, []
        if self.velocity:
            jacobians.append(mechanics.frame_translation_jacobian(self.frame, at.q))
        if self.angular_velocity:
            jacobians.append(mechanics.frame_rotation_jacobian(self.frame, at.q))
        return ca.vertcat(*jacobians) @ at.v - p["rates"] if jacobians else ca.SX.zeros(0, 1)


@dataclass(frozen=True, eq=False)
class FrameProjections:
    """Which combinations of the rows of all frames are end conditions: those that nothing else decides.

    Attributes
    ----------
    pose : ndarray, shape (k, rows of all poses)
    rate : ndarray, shape (l, rows of all velocities)
    """

    pose: Array
    rate: Array

    def labels(self, goals: Sequence[FrameGoal]) -> tuple[str, ...]:
        """What each condition is mostly about."""
        poses = [label for goal in goals for label in goal.pose_labels]
        rates = [label for goal in goals for label in goal.rate_labels]
        return tuple(
            names[largest_entry(row)] for D, names in ((self.pose, poses), (self.rate, rates)) for row in D
        )


@dataclass(frozen=True)
class FrameEnd:
    """Goals of frames as exact conditions, or as a cost of missing them.

    Attributes
    ----------
    shapes : tuple of FrameShape
    num_pose, num_rate : int
        Conditions on poses and on velocities; of a cost zero.
    is_cost : bool
    goals : tuple of FrameGoal
        The numbers, which the functions do not depend on.
    projections : FrameProjections or None
        Of conditions.
    scale : float
        Of the weights of a cost.
    """

    shapes: tuple[FrameShape, ...]
    num_pose: int
    num_rate: int
    is_cost: bool
    goals: tuple[FrameGoal, ...] = field(compare=False)
    projections: FrameProjections | None = field(compare=False, default=None)
    scale: float = field(compare=False, default=0.0)

    remembers: ClassVar[tuple[str, ...]] = ()  # they are functions of the last configuration and velocity

    @classmethod
    def conditions(
        cls, goals: tuple[FrameGoal, ...], robot: Robot, projections: FrameProjections
    ) -> FrameEnd:
        """Exact conditions."""
        shapes = tuple(FrameShape.of(goal, robot) for goal in goals)
        return cls(shapes, len(projections.pose), len(projections.rate), False, goals, projections)

    @classmethod
    def cost(cls, goals: tuple[FrameGoal, ...], robot: Robot, scale: float) -> FrameEnd:
        """Half the weighted squares of the errors, times a factor."""
        shapes = tuple(FrameShape.of(goal, robot) for goal in goals)
        return cls(shapes, 0, 0, True, goals, None, scale)

    @property
    def signature(self) -> dict[str, Any]:
        """What its functions depend on."""
        shapes = [dataclasses.asdict(shape) for shape in self.shapes]
        return {
            "term": "frames",
            "shapes": shapes,
            "rows": (self.num_pose, self.num_rate),
            "cost": self.is_cost,
        }

    @property
    def rows(self) -> int:
        """Number of conditions."""
        return self.num_pose + self.num_rate

    @property
    def weights(self) -> tuple[str, ...]:
        """Weights of a cost."""
        return (self._key("weights"),) if self.is_cost else ()

    def parameters(self) -> dict[str, int]:
        """Numbers of each frame, then the projections of conditions or the weights of a cost."""
        found = {
            self._key(f"{k}.{name}"): size
            for k, shape in enumerate(self.shapes)
            for name, size in shape.sizes.items()
        }
        poses, rates = (
            sum(getattr(shape, f"{kind}_rows") for shape in self.shapes) for kind in ("pose", "rate")
        )
        if self.is_cost:
            return found | {self._key("weights"): len(self.shapes)}
        return found | {
            self._key("D_pose"): self.num_pose * poses,
            self._key("D_rate"): self.num_rate * rates,
        }

    def numbers(self) -> dict[str, Array]:
        """Value of each parameter."""
        found = {
            self._key(f"{k}.{name}"): value
            for k, goal in enumerate(self.goals)
            for name, value in FrameShape.numbers(goal).items()
        }
        if self.projections is None:
            weights = self.scale * np.array([goal.weight for goal in self.goals])
            return found | {self._key("weights"): weights}
        D = self.projections
        return found | {
            self._key("D_pose"): D.pose.ravel(order="F"),
            self._key("D_rate"): D.rate.ravel(order="F"),
        }

    def numbers_at(self, name: str, pose: Array) -> dict[str, Array]:
        """Values of the parameters that say where a frame is to be, see `FrameShape.numbers_at`."""
        return {
            self._key(f"{k}.{key}"): value
            for k, (goal, shape) in enumerate(zip(self.goals, self.shapes, strict=True))
            if goal.name == name
            for key, value in shape.numbers_at(name, pose).items()
        }

    def expression(self, at: Point, p: Mapping[str, ca.SX]) -> ca.SX:
        """The cost, or the rows."""
        own = [
            {name: p[self._key(f"{k}.{name}")] for name in shape.sizes} for k, shape in enumerate(self.shapes)
        ]
        pairs = list(zip(self.shapes, own, strict=True))
        poses, rates = [s.pose(at, n) for s, n in pairs], [s.rates(at, n) for s, n in pairs]
        if self.is_cost:
            squares = [ca.sumsqr(a) + ca.sumsqr(b) for a, b in zip(poses, rates, strict=True)]
            return ca.dot(p[self._key("weights")], ca.vertcat(*squares)) / 2
        pose, rate = ca.vertcat(*poses), ca.vertcat(*rates)
        return ca.vertcat(
            ca.reshape(p[self._key("D_pose")], self.num_pose, pose.numel()) @ pose,
            ca.reshape(p[self._key("D_rate")], self.num_rate, rate.numel()) @ rate,
        )

    def _key(self, name: str) -> str:
        return f"{'frames_cost' if self.is_cost else 'frames'}.{name}"

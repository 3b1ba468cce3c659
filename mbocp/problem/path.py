"""Inequalities that frames of the robot keep along the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, frozen_array
from mbocp.exceptions import DimensionMismatch, InvalidValue, ProblemError
from mbocp.problem._checks import check_choice, check_finite
from mbocp.problem.goal import Goal
from mbocp.robot import Label, Robot
from mbocp.robot.large import working_data

__all__ = ["PATH_KINDS", "PathConstraint", "PathKind", "check_path"]

PathKind: TypeAlias = Literal["position", "distance", "speed"]

PATH_KINDS: tuple[PathKind, ...] = ("position", "distance", "speed")
_ROUND_OFF = 1e-9  # [m, m/s] by which a start may miss its bound
_AXES = "xyz"


@dataclass(frozen=True, kw_only=True, eq=False)
class PathConstraint:
    r"""Bounds on where a frame is, how far from something, or how fast.

    .. math:: \underline{h} \le h(q_n, v_n) \le \overline{h}, \qquad n = 1, \ldots, N

    with, for the origin p(q) of `frame` in the axes of the world:

    - ``position``: the coordinates `axes` of p;
    - ``distance``: :math:`|p - p_b|` from the origin of the frame `other`, or from `point`;
    - ``speed``: :math:`|\dot p|`.

    Attributes
    ----------
    name : str
        What it is called in messages, results and plots.
    kind : {"position", "distance", "speed"}
    frame : int
        Index of the frame.
    other : int, optional
        Index of the other frame of a distance.
    point : ndarray, shape (3,)
        In the world; of a distance without `other` [m].
    axes : tuple of int
        Rows of a position: 0, 1, 2 for x, y, z.
    lower, upper : ndarray, shape (rows,)
        [m] or [m/s]; infinite where there is none.
    """

    name: str
    kind: PathKind
    frame: int
    other: int | None = None
    point: Array = field(default_factory=lambda: frozen_array(np.zeros(3)))
    axes: tuple[int, ...] = ()
    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        key = f"path {self.name!r}"
        check_choice(f"{key}: kind", self.kind, PATH_KINDS)
        object.__setattr__(self, "point", frozen_array(self.point, shape=(3,), name=f"{key}: point"))
        check_finite(f"{key}: point", self.point)
        if self.kind != "position" and self.axes:
            raise ProblemError(f"{key}: axes belong to a position, got kind {self.kind!r}")
        rows = len(self.axes) if self.kind == "position" else 1
        if not rows:
            raise ProblemError(f"{key}: bounds nothing; give x, y or z as [lower, upper]")
        for side in ("lower", "upper"):
            value = frozen_array(getattr(self, side), shape=(rows,), name=f"{key}: {side}")
            object.__setattr__(self, side, value)
        for lo, hi in zip(self.lower, self.upper, strict=True):
            if not lo < hi or not (np.isfinite(lo) or np.isfinite(hi)):
                raise InvalidValue(key, [float(lo), float(hi)], "a finite bound, the lower below the upper")

    @property
    def rows(self) -> int:
        """Number of inequalities."""
        return len(self.lower)

    @property
    def labels(self) -> tuple[Label, ...]:
        """Name and unit of each row."""
        if self.kind == "position":
            return tuple(Label(f"{self.name}.{_AXES[i]}", "m") for i in self.axes)
        return (Label(self.name, "m/s" if self.kind == "speed" else "m"),)

    def values(self, robot: Robot, q: Array, v: Array) -> Array:
        """h(q, v), shape (rows,) [m, m/s]."""
        data = working_data(robot.model)
        pin.forwardKinematics(robot.model, data, q, v)
        pin.updateFramePlacements(robot.model, data)
        position = data.oMf[self.frame].translation
        if self.kind == "position":
            return np.array([position[i] for i in self.axes])
        if self.kind == "distance":
            end = self.point if self.other is None else data.oMf[self.other].translation
            return np.array([np.linalg.norm(position - end)])
        velocity = pin.getFrameVelocity(robot.model, data, self.frame, pin.LOCAL_WORLD_ALIGNED)
        return np.array([np.linalg.norm(velocity.linear)])

    def check_frames(self, robot: Robot) -> None:
        """Refuse frames that `robot` does not have."""
        for index in (self.frame, *((self.other,) if self.other is not None else ())):
            if not 0 <= index < len(robot.frame_names):
                raise DimensionMismatch(f"path {self.name!r}: frame {index}", index, len(robot.frame_names))


def check_path(
    robot: Robot, path: Sequence[PathConstraint], q_start: Array, v_start: Array, goal: Goal
) -> None:
    """Refuse constraints that exclude the start, or an exact goal that says enough to tell."""
    names = [constraint.name for constraint in path]
    for name in names:
        if names.count(name) > 1:
            raise ProblemError(f"path {name!r}: there are several of this name; give each its own")
    for constraint in path:
        constraint.check_frames(robot)
        _refuse_outside(constraint, constraint.values(robot, q_start, v_start), "start")
        if not (goal.is_exact and goal.q_active.all()):
            continue
        if constraint.kind != "speed":
            _refuse_outside(constraint, constraint.values(robot, goal.q, np.zeros(robot.nv)), "goal")
        elif goal.rate_active.all():
            v = goal.value if goal.rate == "v" else robot.velocity_from_momentum(goal.q, goal.value)
            _refuse_outside(constraint, constraint.values(robot, goal.q, v), "goal")


def _refuse_outside(constraint: PathConstraint, values: Array, where: str) -> None:
    outside = (values < constraint.lower - _ROUND_OFF) | (values > constraint.upper + _ROUND_OFF)
    if outside.any():
        i = int(np.flatnonzero(outside)[0])
        above = values[i] > constraint.upper[i]
        bound = constraint.upper[i] if above else constraint.lower[i]
        label = constraint.labels[i]
        raise ProblemError(
            f"path {constraint.name!r}: at the {where} {label.name} is {values[i]:.6g} {label.unit}, "
            f"{'above' if above else 'below'} its bound {bound:.6g}; move the {where}, or the bound"
        )

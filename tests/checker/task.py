"""What is to be solved, in plain numbers that the checker understands without mbocp."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tests.checker.system import Array

__all__ = ["FramePose", "PathBound", "Point", "Task"]


@dataclass(frozen=True, eq=False)
class PathBound:
    """A bound on a frame: coordinates `axes` of its position, its distance from a point, its speeds or axes.

    "line": its two offsets from the line through `point` along `direction`, or their length with a tolerance;
    "kept": the rotation vector from `rotation`, or its length; "orientation": angle of `axis` to `direction`.
    """

    kind: str
    frame: str
    lower: Array
    upper: Array
    axes: tuple[int, ...] = ()
    point: Array = field(default_factory=lambda: np.zeros(3))
    direction: Array = field(default_factory=lambda: np.zeros(3))
    axis: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array | None = None
    first: int = 1
    last: int | None = None

    def nodes(self, num_steps: int) -> range:
        """Nodes at which it holds."""
        return range(self.first, (num_steps if self.last is None else self.last) + 1)


@dataclass(frozen=True, eq=False)
class FramePose:
    """Where a frame is to be: coordinates (NaN: free) and axes; exactly, or within a box and a cone."""

    frame: str
    position: Array
    rotation: Array | None = None
    box: float = 0.0
    cone: float = 0.0


@dataclass(frozen=True, eq=False)
class Point:
    """What holds at one node: some directions of q and v, and poses of frames."""

    node: int
    q: Array
    q_active: Array
    v: Array
    v_active: Array
    frames: tuple[FramePose, ...] = ()


@dataclass(frozen=True, eq=False)
class Task:
    """An optimal control problem; what is left out (NaN, infinite, zero) does not act.

    Attributes
    ----------
    q_goal, v_goal : ndarray, shapes (nq,), (nv,)
        Where the motion ends; `q_active`, `v_active` (nv,) say in which directions.
    effort, control_rate : ndarray, shape (nu,)
    velocity : ndarray, shape (nv,)
    tracking : ndarray, shape (nv,)
        Weights of the distance from `q_target`.
    terminal : ndarray, shape (nv,)
        Weights of the distance of the end from `q_goal`, instead of an exact end.
    u_limits, v_limits, q_limits : ndarray, shape (2, ...)
        Lower and upper.
    points : tuple of Point
        On the way, or at the end.
    acceleration, jerk, effort_rate, power : ndarray, shape (2, ...), or None
        Lower and upper, in every step.
    duration_range : (float, float) or None
        Bounds of a duration that is found; `time` weighs it.
    """

    scheme: str
    coordinates: str
    duration: float
    num_steps: int
    q_start: Array
    v_start: Array
    q_goal: Array
    v_goal: Array
    q_active: Array
    v_active: Array
    effort: Array
    velocity: Array
    control_rate: Array
    tracking: Array
    q_target: Array
    terminal: Array
    potential: float
    u_limits: Array
    v_limits: Array
    q_limits: Array
    path: tuple[PathBound, ...] = ()
    points: tuple[Point, ...] = ()
    acceleration: Array | None = None
    jerk: Array | None = None
    effort_rate: Array | None = None
    power: Array | None = None
    duration_range: tuple[float, float] | None = None
    time: float = 0.0

    @property
    def dt(self) -> float:
        return self.duration / self.num_steps

    @property
    def is_bounded(self) -> bool:
        limits = (self.u_limits, self.v_limits, self.q_limits)
        further = (self.acceleration, self.jerk, self.effort_rate, self.power, self.duration_range)
        if self.path or self.points or any(one is not None for one in further):
            return True
        return any(bool(np.isfinite(side).any()) for side in limits)

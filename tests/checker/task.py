"""What is to be solved, in plain numbers that the checker understands without mbocp."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from tests.checker.system import Array

__all__ = ["Ball", "Followed", "FramePose", "PathBound", "Point", "Shape", "Stop", "Task"]


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
class Ball:
    """A sphere on a link that is to keep away from shapes."""

    name: str
    frame: str
    center: Array
    radius: float


@dataclass(frozen=True, eq=False)
class Shape:
    """A sphere (its radius) or a box (its sides) in the world to keep away from, by a margin [m]."""

    name: str
    kind: str
    sizes: Array
    position: Array
    rotation: Array
    margin: float
    smoothing: float


@dataclass(frozen=True, eq=False)
class Followed:
    """Points of a path that a frame follows from its first to its last, exactly or in a tube [m]."""

    frame: str
    points: Array
    tolerance: float = 0.0


@dataclass(frozen=True)
class Stop:
    """A node whose time is found, between two times [s]; steps before it are as long as each other."""

    node: int
    earliest: float = 0.0
    latest: float = np.inf


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
    balls, shapes : tuple of Ball, tuple of Shape
        What keeps away from what.
    stops : tuple of Stop
        In the order of their nodes.
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
    balls: tuple[Ball, ...] = ()
    shapes: tuple[Shape, ...] = ()
    followed: tuple[Followed, ...] = ()
    stops: tuple[Stop, ...] = ()

    @property
    def phases(self) -> tuple[range, ...]:
        """Steps that are as long as each other, by number from 1, of the lengths that are found."""
        if not self.stops:
            return (range(1, self.num_steps + 1),) if self.duration_range is not None else ()
        ends = [0, *(stop.node for stop in self.stops), self.num_steps]
        return tuple(range(a + 1, b + 1) for a, b in pairwise(ends))

    @property
    def ends_at_rest(self) -> bool:
        """Whether limits of jerks hold on the way to no acceleration at the end, too."""
        return self.jerk is not None and not self.terminal.any()

    @property
    def dt(self) -> float:
        return self.duration / self.num_steps

    @property
    def is_bounded(self) -> bool:
        limits = (self.u_limits, self.v_limits, self.q_limits)
        further = (self.acceleration, self.jerk, self.effort_rate, self.power, self.duration_range)
        if self.path or self.points or self.shapes or self.followed or self.stops:
            return True
        if any(one is not None for one in further):
            return True
        return any(bool(np.isfinite(side).any()) for side in limits)

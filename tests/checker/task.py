"""What is to be solved, in plain numbers that the checker understands without mbocp."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from tests.checker.system import Array

__all__ = ["PathBound", "Task"]


@dataclass(frozen=True, eq=False)
class PathBound:
    """A bound on a frame: coordinates `axes` of its position, its distance from a point, or its speed."""

    kind: str
    frame: str
    lower: Array
    upper: Array
    axes: tuple[int, ...] = ()
    point: Array = field(default_factory=lambda: np.zeros(3))


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

    @property
    def dt(self) -> float:
        return self.duration / self.num_steps

    @property
    def is_bounded(self) -> bool:
        limits = (self.u_limits, self.v_limits, self.q_limits)
        return bool(self.path) or any(bool(np.isfinite(side).any()) for side in limits)

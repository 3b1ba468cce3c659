"""What a motion was to go through, for a replay: via points and lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mbocp._arrays import Array

if TYPE_CHECKING:
    from mbocp.problem import Problem
    from mbocp.terms import FrameGoal

__all__ = ["Marks", "ViaMark", "marks_of"]


@dataclass(frozen=True, eq=False)
class ViaMark:
    """A pose of a frame on the way.

    Attributes
    ----------
    share : float
        Part of the motion that is over there.
    goal : FrameGoal
        Pose and tolerances.
    """

    share: float
    goal: FrameGoal


@dataclass(frozen=True, eq=False)
class Marks:
    """All that is drawn.

    Attributes
    ----------
    via : tuple of ViaMark
    lines : tuple of (ndarray, ndarray)
        Both ends of each, shape (3,) [m].
    """

    via: tuple[ViaMark, ...] = ()
    lines: tuple[tuple[Array, Array], ...] = ()


def marks_of(problem: Problem) -> Marks:
    """Poses of frames at the via points of a problem, and the lines of its path constraints."""
    via = (
        ViaMark(point.node / problem.num_steps, frame)
        for point in problem.waypoints
        for frame in point.via.goal.poses
    )
    numbers = (constraint.numbers for constraint in problem.frame_constraints)
    return Marks(tuple(via), tuple((n["a"], n["b"]) for n in numbers if {"a", "b"} <= set(n)))

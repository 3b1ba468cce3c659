"""Larger margins for motions that touch something between nodes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar, Protocol, TypeVar

from mbocp.exceptions import ProblemError
from mbocp.problem.clearance import SelfCollision
from mbocp.robot.collision.obstacle import Obstacle

__all__ = ["with_larger_margin"]

P = TypeVar("P", bound="WithObstacles")


class WithObstacles(Protocol):
    """Fields of `mbocp.problem.Problem`."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    # fmt: off
    @property
    def obstacle(self) -> tuple[Obstacle, ...]: ...
    @property
    def self_collision(self) -> SelfCollision | bool | None: ...
    # fmt: on


def with_larger_margin(problem: P, between: str, more: float) -> P | None:
    """The problem with more room between two things, which keep their pairs; None if an end is too near.

    Parameters
    ----------
    problem : Problem
    between : str
        Both, as `mbocp.problem.approach.Approach` says it.
    more : float
        [m].
    """
    names = [o for o in problem.obstacle if between.endswith(f" and {o.name}")]
    try:
        if names:
            raised = (replace(o, margin=o.margin + more) if o in names else o for o in problem.obstacle)
            return replace(problem, obstacle=tuple(raised))
        own = problem.self_collision
        if not isinstance(own, SelfCollision):
            return None
        return replace(problem, self_collision=replace(own, margin=own.margin + more))
    except ProblemError:  # the start or the goal has not as much room: the motion stays as it is
        return None

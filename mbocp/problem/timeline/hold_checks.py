"""What of holds, releases and impacts is refused, by name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from mbocp.exceptions import InvalidValue, ProblemError, suggest
from mbocp.integrators import SCHEMES
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.timeline.hold import Hold, Release, Spans
from mbocp.robot import Robot

__all__ = ["check_holds"]


class _Switched(Protocol):
    """What a problem says of its switches, see `mbocp.problem.Problem`."""

    # fmt: off
    @property
    def robot(self) -> Robot: ...
    @property
    def scheme(self) -> str: ...
    @property
    def coordinates(self) -> str: ...
    @property
    def num_steps(self) -> int: ...
    @property
    def holds(self) -> tuple[Hold, ...]: ...
    @property
    def releases(self) -> tuple[Release, ...]: ...
    @property
    def impacts(self) -> tuple[int, ...]: ...
    # fmt: on


def check_holds(problem: _Switched) -> None:
    """Refuse holds of unknown frames or names, outside the horizon, or with schemes that take none.

    Raises
    ------
    InvalidValue, ProblemError, UnknownFrame
    """
    holds, releases, N = problem.holds, problem.releases, problem.num_steps
    if not (holds or releases or problem.impacts):
        return
    _check_mechanics(problem)
    own = [constraint.name for constraint in problem.robot.constraints]
    names = [*own, *(hold.name for hold in holds)]
    for hold in holds:
        if names.count(hold.name) > 1:
            raise ProblemError(f"hold {hold.name!r}: there are several of this name; give each its own")
        hold.constraint(problem.robot)
        _check_spans(f"hold {hold.name!r}", hold.spans, N)
    released = [release.constraint for release in releases]
    for release in releases:
        key = f"release {release.constraint!r}"
        if release.constraint not in own:
            raise ProblemError(
                f"{key}: robot {problem.robot.name!r} has no constraint of this name: "
                f"{suggest(release.constraint, dict.fromkeys(own), 40)}"
            )
        if released.count(release.constraint) > 1:
            raise ProblemError(f"{key}: there are several of it; say all its spans in one")
        _check_spans(key, release.spans, N)
    _check_impacts(problem.impacts, N)


def _check_mechanics(problem: _Switched) -> None:
    if not SCHEMES[problem.scheme].takes_holds:
        able = " | ".join(f'"{name}"' for name, data in SCHEMES.items() if data.takes_holds)
        raise ProblemError(
            f'integrator.scheme: "{problem.scheme}" takes no constraints that begin or end along the way; '
            f"take {able}"
        )
    if not COORDINATES[problem.coordinates].takes_holds:
        able = " | ".join(f'"{name}"' for name, data in COORDINATES.items() if data.takes_holds)
        raise ProblemError(
            f'coordinates: "{problem.coordinates}" take no constraints that begin or end along the way; take '
            f"{able}"
        )


def _check_spans(key: str, spans: Spans, num_steps: int) -> None:
    if spans and spans[-1][1] > num_steps:
        raise InvalidValue(f"{key}: spans", list(spans), f"steps within the horizon of {num_steps}")


def _check_impacts(impacts: Sequence[int], num_steps: int) -> None:
    for step in impacts:
        if not 0 <= step < num_steps:
            raise InvalidValue("impacts", step, f"a step within the horizon of {num_steps}")
    if len(impacts) >= num_steps:
        raise ProblemError("impacts: no step is left that takes time; take more steps")

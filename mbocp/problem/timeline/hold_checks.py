"""What of holds, releases and impacts is refused, by name."""

from __future__ import annotations

from collections.abc import Sequence

from mbocp.exceptions import InvalidValue, ProblemError, suggest
from mbocp.integrators import SCHEMES
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.timeline.hold import Spans
from mbocp.problem.timeline.phase_holds import Switches
from mbocp.robot import Robot


def check_holds(robot: Robot, scheme: str, coordinates: str, num_steps: int, switches: Switches) -> None:
    """Refuse holds of unknown frames or names, outside the horizon, or with schemes that take none.

    Raises
    ------
    InvalidValue, ProblemError, UnknownFrame
    """
    holds, releases, impacts = switches
    if not (holds or releases or impacts):
        return
    _check_mechanics(scheme, coordinates)
    own = [constraint.name for constraint in robot.constraints]
    names = [*own, *(hold.name for hold in holds)]
    for hold in holds:
        if names.count(hold.name) > 1:
            raise ProblemError(f"hold {hold.name!r}: there are several of this name; give each its own")
        hold.constraint(robot)
        _check_spans(f"hold {hold.name!r}", hold.spans, num_steps)
    released = [release.constraint for release in releases]
    for release in releases:
        key = f"release {release.constraint!r}"
        if release.constraint not in own:
            raise ProblemError(
                f"{key}: robot {robot.name!r} has no constraint of this name: "
                f"{suggest(release.constraint, dict.fromkeys(own), 40)}"
            )
        if released.count(release.constraint) > 1:
            raise ProblemError(f"{key}: there are several of it; say all its spans in one")
        _check_spans(key, release.spans, num_steps)
    _check_impacts(impacts, num_steps)


def _check_mechanics(scheme: str, coordinates: str) -> None:
    if not SCHEMES[scheme].takes_holds:
        able = " | ".join(f'"{name}"' for name, data in SCHEMES.items() if data.takes_holds)
        raise ProblemError(
            f'integrator.scheme: "{scheme}" takes no constraints that begin or end along the way; take {able}'
        )
    if not COORDINATES[coordinates].takes_holds:
        able = " | ".join(f'"{name}"' for name, data in COORDINATES.items() if data.takes_holds)
        raise ProblemError(
            f'coordinates: "{coordinates}" take no constraints that begin or end along the way; take {able}'
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

"""From holds, releases and impacts to the rows that act in each step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.exceptions import InconsistentStart, InvalidValue, ProblemError, suggest
from mbocp.integrators import SCHEMES
from mbocp.mechanics.held_frames import HeldFrame, compute_held_jacobians
from mbocp.mechanisms.consistent_states import CONSISTENCY_TOLERANCE, find_independent_rows, poses_around
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.timeline.hold import Hold, Release, Schedule, Spans, holds_in
from mbocp.problem.timeline.switches import Begin, SwitchTable, rows_of_frames
from mbocp.robot import Robot
from mbocp.robot.rotors import kinds_of_ends


def switch_table(robot: Robot, schedule: Schedule, num_steps: int, start: tuple[Array, Array]) -> SwitchTable:
    """Find the rows that act in each step; of those that others imply, the first.

    Parameters
    ----------
    start : tuple of ndarray
        Configuration and velocity of the start.

    Raises
    ------
    ProblemError
        If a hold holds nothing that moves, or a constraint cannot be released alone.
    InconsistentStart
        If what acts from the start does not fit it.
    """
    holds, releases, impacts = schedule
    held = tuple(hold.as_frame(robot) for hold in holds)
    own, wanted = _own_rows(robot, releases, num_steps), _rows_that_act(holds, held, num_steps)
    q = start[0]
    _check_holds_something(robot, holds, held, q)
    rows, known = np.zeros_like(wanted), dict[bytes, BoolArray]()
    for step in range(num_steps):
        key = own[step].tobytes() + b"|" + wanted[step].tobytes()
        if key not in known:
            known[key] = find_independent_rows(robot, q, held, own[step], wanted[step])
        rows[step] = known[key]
    is_impact = np.zeros(num_steps, dtype=np.bool_)
    is_impact[list(impacts)] = True
    begins = (*_begins(holds, held, rows), *_begin_again(robot, releases, num_steps))
    found = SwitchTable(robot, schedule, held, own, rows, is_impact, begins)
    _check_start(found, *start)
    return found


def _own_rows(robot: Robot, releases: Sequence[Release], num_steps: int) -> BoolArray:
    acts = np.ones((num_steps, robot.nc), dtype=np.bool_)
    names = _names_of_rows(robot)
    for release in releases:
        mine = [place for place, row in enumerate(robot.kept_rows) if names[row] == release.constraint]
        for first, last in release.spans:
            acts[first:last, mine] = False
        _check_release(robot, release)
    return acts


def _names_of_rows(robot: Robot) -> list[str]:
    """Return the name of the constraint that each row of the robot belongs to."""
    return [constraint.name for constraint in robot.constraints for _ in constraint.rows]


def _check_release(robot: Robot, release: Release) -> None:
    """Refuse to release what implies rows of others that the robot leaves out."""
    others = [row for row, name in enumerate(_names_of_rows(robot)) if name != release.constraint]
    kept = [row for row in robot.kept_rows if row in set(others)]
    jacobian = robot.closure_jacobian(robot.q0)
    ranks = [np.linalg.matrix_rank(jacobian[rows], tol=1e-6) if rows else 0 for rows in (others, kept)]
    if ranks[0] != ranks[1]:
        raise ProblemError(
            f"release {release.constraint!r}: other constraints of robot {robot.name!r} lean on it: rows of "
            "theirs are left out because it implies them; close the loop with a hold in its place"
        )


def _rows_that_act(holds: Sequence[Hold], held: Sequence[HeldFrame], num_steps: int) -> BoolArray:
    steps = range(num_steps)
    columns = [
        np.repeat([[holds_in(hold.spans, step)] for step in steps], len(frame.rows), axis=1)
        for hold, frame in zip(holds, held, strict=True)
    ]
    return np.hstack(columns) if columns else np.zeros((num_steps, 0), dtype=np.bool_)


def _begins(holds: Sequence[Hold], held: Sequence[HeldFrame], rows: BoolArray) -> list[Begin]:
    found = []
    for hold, frame, where in zip(holds, held, rows_of_frames(held), strict=True):
        for first, _ in hold.spans:
            acting = tuple(int(row) for row in np.flatnonzero(rows[first, where]))
            if first > 0 and acting:
                found.append(Begin(first, frame, acting))
    return found


def _begin_again(robot: Robot, releases: Sequence[Release], num_steps: int) -> list[Begin]:
    found, kept = [], set(robot.kept_rows)
    for release in releases:
        count = 0
        for constraint in robot.constraints:
            rows = tuple(i for i in range(len(constraint.rows)) if count + i in kept)
            count += len(constraint.rows)
            if constraint.name == release.constraint:
                again = [last for _, last in release.spans if last < num_steps]
                found += [Begin(step, HeldFrame(constraint, False), rows) for step in again]
    return found


def _check_holds_something(robot: Robot, holds: Sequence[Hold], held: Sequence[HeldFrame], q: Array) -> None:
    if not held:
        return
    moved = (
        np.abs(compute_held_jacobians(robot, held, poses_around(robot, q))).max(axis=2)
        > CONSISTENCY_TOLERANCE
    )
    for hold, where in zip(holds, rows_of_frames(held), strict=True):
        if not moved[:, where].any():
            raise ProblemError(
                f"hold {hold.name!r}: nothing moves frame {hold.frame!r} against {hold.to!r}; hold another "
                "frame, or leave it out"
            )
        from_start = any(first == 0 for first, _ in hold.spans)
        if from_start and not moved[0, where].any():
            raise ProblemError(
                f"hold {hold.name!r}: the start is a singular pose, in which nothing moves frame "
                f"{hold.frame!r} against {hold.to!r}; begin in another one"
            )


def _check_start(table: SwitchTable, q: Array, v: Array) -> None:
    """Refuse a start that what acts from there does not allow; an impact asks for positions alone."""
    acts = table.rows[0]
    if not acts.any():
        return
    residual = table.residuals(q[None], q[None])[0]
    rate = np.zeros_like(residual) if table.is_impact[0] else table.jacobians(q[None])[0] @ v
    for values, key, per in ((residual, "start.q", ""), (rate, "start.v", "/s")):
        worst = int(np.argmax(np.abs(values) * acts))
        if np.abs(values[worst]) * acts[worst] > CONSISTENCY_TOLERANCE:
            label = table.labels[worst]
            advice = (
                "begin with the frames in one place, or hold them where they are"
                if key == "start.q"
                else "begin with a velocity that it allows, or with an impact"
            )
            raise InconsistentStart(
                f"{key}: violates hold {label.name!r}, which acts from the start, by {values[worst]:.3g} "
                f"{label.unit}{per}; {advice}"
            )


def check_schedule(robot: Robot, scheme: str, coordinates: str, num_steps: int, schedule: Schedule) -> None:
    """Refuse holds of unknown frames or names, outside the horizon, or with schemes that take none.

    Raises
    ------
    InvalidValue, ProblemError, UnknownFrame
    """
    holds, releases, impacts = schedule
    _check_mechanics(scheme, coordinates)
    own = [constraint.name for constraint in robot.constraints]
    names = [*own, *(hold.name for hold in holds)]
    for hold in holds:
        if names.count(hold.name) > 1:
            raise ProblemError(f"hold {hold.name!r}: there are several of this name; give each its own")
        held = hold.constraint(robot)
        if True in kinds_of_ends(robot.model, held.frame_ids):
            words = "forces hold, and with dynamics = false there are none; take path constraints"
            raise ProblemError(f"hold {hold.name!r}: {words}")
        _check_spans(f"hold {hold.name!r}", hold.spans, num_steps)
    released = [release.constraint for release in releases]
    for release in releases:
        key = f"release {release.constraint!r}"
        if release.constraint not in own:
            raise ProblemError(
                f"{key}: robot {robot.name!r} has no constraint of this name: "
                f"{suggest(release.constraint, dict.fromkeys(own), 40)}"
            )
        freed = robot.constraints[own.index(release.constraint)]
        if True in kinds_of_ends(robot.model, freed.frame_ids, freed.joint_ids):
            raise ProblemError(
                f"{key}: with dynamics = false the joints of a loop follow its motors; keep it"
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


def check_landings(table: SwitchTable, coordinates: str) -> None:
    """Refuse what begins without an impact where coordinates have no soft landing.

    Raises
    ------
    ProblemError
    """
    soft = [begin for begin in table.begins if not table.is_impact[begin.step]]
    if soft and not COORDINATES[coordinates].lands_softly:
        raise ProblemError(
            f"hold {soft[0].frame.constraint.name!r}: natural coordinates have no soft landing; let it "
            'begin with an impact, or take coordinates = "joint"'
        )

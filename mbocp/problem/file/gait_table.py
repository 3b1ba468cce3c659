"""A gait in a word: `[gait]`, from which the phases follow.

Feet swing in turn, some at once. In between all may stand, or none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, NamedTuple

import numpy as np

from mbocp._arrays import Array
from mbocp._keys import Key, Kind, Table
from mbocp._text import show
from mbocp.exceptions import InvalidValue, ProblemError, locate
from mbocp.problem._checks import check_integer, whole
from mbocp.problem.file.ground_table import GroundTable, check_foot
from mbocp.problem.file.phase_table import PhaseTable
from mbocp.problem.file.value_kinds import Duration
from mbocp.problem.timeline.times import duration_from
from mbocp.robot import Robot
from mbocp.robot.kinematics import WORLD

_FL, _FR, _HL, _HR = "front left", "front right", "hind left", "hind right"
_GAITS: Mapping[
    str, Mapping[int, Sequence[Sequence[str]]]
] = {  # feet that swing in turn, by how many there are
    "walk": {2: [["left"], ["right"]], 4: [[_HL], [_FL], [_HR], [_FR]]},
    "trot": {4: [[_FL, _HR], [_FR, _HL]]},
    "pace": {4: [[_FL, _HL], [_FR, _HR]]},
    "bound": {4: [[_FL, _FR], [_HL, _HR]]},
    "hop": {2: [["left", "right"]], 4: [[_FL, _FR, _HL, _HR]]},
}
_NUM_SIDES = 2  # feet that stand left and right, without others behind them
_NUM_FLOATING = 7  # numbers of the configuration of a floating base


def _swings(value: Any) -> Any:
    """A gait's name, or the feet that swing in turn."""
    if isinstance(value, str) and value not in _GAITS:
        raise ValueError(f"got {show(value)}, expected {', '.join(map(repr, _GAITS))}, or lists of feet")
    return value


class GaitTable(Table):
    """How feet swing in turn; phases follow from it, and `[[phase]]` is left out."""

    swings: Annotated[
        str | list[list[str]],
        Kind("string or list of lists", _swings, str | list[list[str]]),
        Key(
            '`"walk"`, `"trot"`, `"pace"`, `"bound"`, `"hop"`; or [feet](contact.md#gaits) that swing at once'
        ),
    ]
    cycles: Annotated[int, whole(1), Key("how often each foot swings")] = 1
    duration: Annotated[Duration, Key("of each swing", "s")]
    stance: Annotated[Duration, Key("how long all feet stand before each swing", "s", "not at all")] = None
    flight: Annotated[
        Duration, Key("how long all feet are in the air after each swing", "s", "not at all")
    ] = None
    stand: Annotated[
        Duration,
        Key("how long all feet stand at the end, unless the gait goes on", "s", "as long as a swing"),
    ] = None
    steps: Annotated[int, whole(2), Key("of a swing")]
    repeats: Annotated[
        bool, Key("it goes on for ever, as [receding horizons](receding_horizon.md#legs) take it")
    ] = False


class _Piece(NamedTuple):
    """A phase of a gait, before it has steps."""

    name: str
    duration: float | Mapping[str, float]
    stands: list[str]


def phases_of_gait(
    gait_table: GaitTable | None,
    phase_table: list[PhaseTable],
    ground_table: GroundTable | None,
    is_cycle: bool,
    robot: Robot,
    said_q_start: Array,
) -> list[PhaseTable]:
    """Return the phases: those of the gait, or those that are given.

    A gait that is periodic or repeats begins and ends in the middle of its first swing, so that what acts at
    its end acts at its start.

    Raises
    ------
    ProblemError
        If there are phases beside the gait, or no ground, or feet that the gait is not for.
    """
    gait = gait_table
    if gait is None:
        return phase_table
    if phase_table:
        raise ProblemError("gait: the phases follow from it; leave out [[phase]], or write all of them")
    if ground_table is None:
        raise ProblemError("gait: which feet does it move? Say it in [ground]")
    check_integer("gait.cycles", gait.cycles, 1)
    check_integer("gait.steps", gait.steps, 2)
    feet, cut = list(ground_table.feet), 0
    pieces: list[_Piece] = []
    for k, swing in enumerate(_swings_of(gait, ground_table, robot, said_q_start) * gait.cycles, start=1):
        if gait.stance is not None:
            pieces.append(_Piece(f"stance_{k}", gait.stance, feet))
        cut = len(pieces) if k == 1 else cut
        pieces.append(_Piece(f"swing_{k}", gait.duration, [foot for foot in feet if foot not in swing]))
        if gait.flight is not None:
            pieces.append(_Piece(f"flight_{k}", gait.flight, []))
    if is_cycle:
        middle = pieces[cut]
        halves = [middle._replace(name=name, duration=_half(middle.duration)) for name in ("begin", "end")]
        pieces = [halves[0], *pieces[cut + 1 :], *pieces[:cut], halves[1]]
    else:
        pieces.append(_Piece("stand", gait.duration if gait.stand is None else gait.stand, feet))
    for before, piece in pairwise(pieces):
        if not before.stands and not piece.stands:
            raise ProblemError(f"gait: no foot stands in {before.name} nor in {piece.name}; give a stance")
    rate = gait.steps / _seconds(gait.duration, "gait.duration")
    return [
        PhaseTable(
            name=piece.name,
            steps=max(2, round(rate * _seconds(piece.duration, f"gait: {piece.name}"))),
            duration=piece.duration,
            contacts=piece.stands,
        )
        for piece in pieces
    ]


def _swings_of(gait: GaitTable, ground: GroundTable, robot: Robot, q_start: Array) -> list[Sequence[str]]:
    """Names of the feet that swing at once, in turn."""
    if not isinstance(gait.swings, str):
        for swing in gait.swings:
            for name in swing:
                check_foot("gait.swings", name, ground)
        if not gait.swings or not all(gait.swings):
            raise ProblemError("gait.swings: got a swing without feet; name those that swing at once")
        return list(gait.swings)
    known, count = _GAITS[gait.swings], len(ground.feet)
    if count not in known:
        numbers = " or ".join(map(str, known))
        raise ProblemError(
            f"gait.swings: {gait.swings!r} is for {numbers} feet, and [ground] has {count}; "
            "list the feet that swing at once, in turn"
        )
    at = _feet_by_place(gait.swings, ground, robot, q_start)
    return [[at[place] for place in swing] for swing in known[count]]


def _feet_by_place(gait: str, ground: GroundTable, robot: Robot, q_start: Array) -> dict[str, str]:
    """Name of the foot at each place about the middle of them, in the axes of the base."""
    base = robot.joint_names[0]
    at_q = robot.configuration_indices(base)
    axes = base if at_q.stop - at_q.start == _NUM_FLOATING else WORLD
    with locate("ground.feet"):
        feet = [robot.frame_placement(frame, q_start, axes) for frame in ground.feet.values()]
    places = np.array([foot.translation for foot in feet])
    away = places - places.mean(axis=0)
    found = {}
    for name, (x, y, _) in zip(ground.feet, away, strict=True):
        words = ["left" if y > 0.0 else "right"]
        words = ["front" if x > 0.0 else "hind", *words] if len(away) > _NUM_SIDES else words
        found[" ".join(words)] = name
    if len(found) != len(away):
        wanted = "left and right" if len(away) == _NUM_SIDES else "front and hind, left and right"
        raise ProblemError(
            f"gait.swings: {gait!r} is for feet {wanted} of each other, unlike these at the start; list "
            "the feet that swing at once, in turn"
        )
    return found


def _half(duration: float | Mapping[str, float]) -> float | dict[str, float]:
    if isinstance(duration, Mapping):
        return {word: value / 2 for word, value in duration.items()}
    return duration / 2


def _seconds(duration: Any, key: str) -> float:
    """Of a duration that is given, or the guess of one that is found."""
    found: float = duration_from(duration, key)["duration"]
    if not found > 0.0:
        raise InvalidValue(key, found, "a number > 0 [s]")
    return found

"""`[goal.frame]` and poses of frames elsewhere: their keys, from what is written to goals, and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import numpy as np

from mbocp._keys import Key, Table
from mbocp.exceptions import locate
from mbocp.robot.kinematics import WORLD
from mbocp.robot.poses.target import target_from_words
from mbocp.terms.frame_goal import FrameGoal
from mbocp.terms.written import Finite, NonNegative, Quaternion, Triple, TripleOrZero, VectorOrNumber


class FramePoseTable(Table):
    """Pose of a frame, or parts of it."""

    name: Annotated[str, Key("a frame of the robot: `mbocp robots NAME` lists them")]
    position: Annotated[
        Triple,
        Key(
            "where its origin is to be: all of it, or some coordinates",
            "m",
            "free",
            "3 numbers, or numbers",
            ("x", "y", "z"),
        ),
    ] = None
    x: Finite | None = None
    y: Finite | None = None
    z: Finite | None = None
    orientation: Annotated[
        Quaternion,
        Key(
            "unit quaternion xyzw; or roll, pitch, yaw about the fixed axes x, y, z",
            "rad",
            "free",
            "4 or 3 numbers",
            ("rpy",),
        ),
    ] = None
    rpy: Triple = None
    axis: Annotated[
        Triple,
        Key(
            "an axis in the frame that is to point along a direction; any length",
            "",
            "free",
            "3 numbers each",
            ("direction",),
        ),
    ] = None
    direction: Triple = None
    relative_to: Annotated[
        str | None, Key("frame in whose axes all these are; it may move", "", '`"world"`')
    ] = None


class FrameGoalTable(FramePoseTable):
    """Pose and velocity of a frame at t = T, or parts of them."""

    velocity: Annotated[
        TripleOrZero,
        Key(
            "of the frame's origin and of the frame, in the axes of the world",
            "m/s; rad/s",
            "free",
            beside=("angular_velocity",),
        ),
    ] = None
    angular_velocity: TripleOrZero = None
    position_tolerance: Annotated[
        VectorOrNumber,
        Key("how far each coordinate may be from its goal: a box", "m", "exact", "number, or 3"),
    ] = None
    orientation_tolerance: Annotated[
        Finite | None, Key("angle by which orientation or axis may be off: a cone", "rad", "exact")
    ] = None
    weight: Annotated[
        NonNegative | None, Key("of the squares of its errors, times half of `cost.terminal`", "", "1")
    ] = None


_FURTHER = [name for name in FrameGoalTable.model_fields if name not in FramePoseTable.model_fields]


def frames_from(tables: Sequence[FramePoseTable], *, key: str = "goal.frame") -> tuple[FrameGoal, ...]:
    """Make the goals from the tables at `key`.

    Raises
    ------
    InvalidValue, DimensionMismatch
        If a value cannot be right, or nothing is asked for.
    """
    found = []
    for table in tables:
        words = table.model_dump(exclude_none=True)
        with locate(key):
            rates = {name: words.pop(name) for name in _FURTHER if name in words}
            found.append(FrameGoal(target=target_from_words(words), **rates))
    return tuple(found)


def write_frame(goal: FrameGoal) -> dict[str, Any]:
    """Return the table that reads back as the same goal."""
    target = goal.target
    table: dict[str, Any] = {"name": target.name}
    if target.position is not None:
        whole = np.isfinite(target.position).all()
        some = {"xyz"[i]: target.position[i] for i in target.coordinates}
        table |= {"position": target.position} if whole else some
    for key in ("orientation", "axis", "direction"):
        table[key] = getattr(target, key)
    if target.relative_to != WORLD:
        table["relative_to"] = target.relative_to
    table |= {key: getattr(goal, key) for key in _FURTHER if key != "weight"}
    if goal.weight != 1.0:
        table["weight"] = goal.weight
    return {key: value for key, value in table.items() if value is not None}

"""Goals of frames as people write them: `[goal.frame]`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbocp.problem.file.messages import located
from mbocp.robot.kinematics import WORLD
from mbocp.robot.poses.target import target_from_words
from mbocp.terms import FrameGoal
from mbocp.terms.frame_goal import FURTHER_KEYS

if TYPE_CHECKING:
    from mbocp.problem.file.schema import FramePoseTable


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
        with located(key):
            rates = {name: words.pop(name) for name in FURTHER_KEYS if name in words}
            found.append(FrameGoal(target=target_from_words(words), **rates))
    return tuple(found)


def frame_tables(frames: Sequence[FrameGoal]) -> list[dict[str, Any]]:
    """Return the tables that read back as the same goals."""
    return [_table(frame) for frame in frames]


def _table(goal: FrameGoal) -> dict[str, Any]:
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
    table |= {key: getattr(goal, key) for key in FURTHER_KEYS if key != "weight"}
    if goal.weight != 1.0:
        table["weight"] = goal.weight
    return {key: value for key, value in table.items() if value is not None}

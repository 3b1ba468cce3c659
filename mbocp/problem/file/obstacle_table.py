"""Obstacles and self-collision as people write them: `[[obstacle]]`, `self_collision`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from mbocp._text import shown
from mbocp.exceptions import ProblemError
from mbocp.problem.clearance import SelfCollision
from mbocp.problem.file.messages import located
from mbocp.robot.collision.obstacle import SIZES, Obstacle

if TYPE_CHECKING:
    from mbocp.problem.file.schema import ObstacleTable, SelfCollisionTable

__all__ = ["obstacle_tables", "obstacles_from", "self_collision_from", "self_collision_table"]

_LENGTHS = tuple(dict.fromkeys(key for keys in SIZES.values() for key in keys))


def obstacles_from(tables: Sequence[ObstacleTable]) -> tuple[Obstacle, ...]:
    """Make the obstacles from the tables of `[[obstacle]]`.

    Raises
    ------
    ProblemError, InvalidValue
        If a key does not fit the shape, or a value cannot be right.
    """
    return tuple(_obstacle(table, i) for i, table in enumerate(tables))


def obstacle_tables(obstacles: Sequence[Obstacle]) -> list[dict[str, Any]]:
    """Return the tables that read back as the same obstacles."""
    return [obstacle.table for obstacle in obstacles]


def self_collision_from(
    written: bool | SelfCollisionTable | None, folder: Path | None = None
) -> SelfCollision | None:
    """Make what is said of links that meet; None: nothing."""
    if written is None or written is False:
        return None
    if written is True:
        return SelfCollision()
    srdf = None if written.srdf is None else (folder or Path()) / written.srdf
    for pair in written.disabled:
        if len(pair) != 2:
            raise ProblemError(f"self_collision.disabled: got {shown(pair)}, expected pairs of links")
    pairs = tuple((pair[0], pair[1]) for pair in written.disabled)
    return SelfCollision(written.margin, pairs, srdf)


def self_collision_table(own: SelfCollision | bool | None) -> dict[str, Any] | None:
    """Return the table that reads back as the same."""
    if not isinstance(own, SelfCollision):
        return None
    srdf = {} if own.srdf is None else {"srdf": str(own.srdf.resolve())}
    return {"margin": own.margin, "disabled": [list(pair) for pair in own.disabled], **srdf}


def _obstacle(table: ObstacleTable, index: int) -> Obstacle:
    key = f"obstacle.{index}"
    wanted = SIZES.get(table.shape, {})
    given = [name for name in _LENGTHS if getattr(table, name) is not None]
    sizes: list[float] = []
    if table.shape in SIZES:
        for name in given:
            if name not in wanted:
                used = " and ".join(wanted) or "no lengths"
                raise ProblemError(f'{key}.{name}: shape = "{table.shape}" does not use it, but {used}')
        for name in wanted:
            if name not in given:
                raise ProblemError(f'{key}.{name}: shape = "{table.shape}" needs it')
            value = getattr(table, name)
            sizes += value if isinstance(value, list) else [value]
    if table.rpy is not None and table.orientation is not None:
        raise ProblemError(f"{key}: give rpy or orientation, not both")
    orientation = table.orientation or [0.0, 0.0, 0.0, 1.0]
    if table.rpy is not None:
        orientation = pin.Quaternion(pin.rpy.rpyToMatrix(np.array(table.rpy))).coeffs().tolist()
    with located(key):
        return Obstacle(
            name=table.name or f"{table.shape} {index + 1}",
            shape=table.shape,
            sizes=np.array(sizes),
            position=np.array(table.position or [0.0] * 3),
            orientation=np.array(orientation),
            frame=table.frame or "world",
            margin=table.margin,
            smoothing=table.smoothing,
            movable=table.movable,
        )

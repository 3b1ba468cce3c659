"""The initial pose of a robot with holonomic constraints: its loops closed, its redundant rows found."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from mbocp._arrays import Array
from mbocp.exceptions import LoopNotClosed
from mbocp.robot.closing import SLACK, assemble, violations
from mbocp.robot.notices import InitialPoseWarning
from mbocp.robot.redundancy import without_redundant_rows

if TYPE_CHECKING:
    from mbocp.robot.robot import Robot

__all__ = ["close_loops"]

_TOLD = 1e-6  # [m, rad, m^2] violation of a pose that was meant to be right


def close_loops(robot: Robot, given: Sequence[str], *, is_whole: bool) -> Robot:
    """Return the robot with an initial pose that closes the loops, and without redundant rows.

    Parameters
    ----------
    robot : Robot
        With all rows of its constraints.
    given : sequence of str
        Joints whose initial position was written: they stay where they are if the loops can be closed so.
    is_whole : bool
        Whether the whole pose was written: then any joint may move.

    Raises
    ------
    LoopNotClosed
        If no pose near the initial one closes the loops.
    UnsupportedRobot
        If constraints say the same as others, or leave nothing that moves.

    Warns
    -----
    InitialPoseWarning
        If joints whose position was written had to move.
    """
    if not robot.constraints:
        return robot
    off = violations(robot, robot.q0, _TOLD)
    held = () if is_whole else tuple(given)
    try:
        q0 = assemble(robot, robot.q0, held, SLACK)
    except LoopNotClosed:
        if not held:
            raise
        q0, held, is_whole = assemble(robot, robot.q0, (), SLACK), (), True
    if off and is_whole:
        bad = ", ".join(f"{name!r} by {value:.3g} {unit}" for name, value, unit in off[:3])
        warnings.warn(
            f"robot {robot.name!r}: the initial pose violates {bad}; the nearest that closes the loops takes "
            "its place: give another in [initial] of its robot.toml, or fewer joints",
            InitialPoseWarning,
            stacklevel=2,
        )
    kept = without_redundant_rows(replace(robot, q0=q0))
    return replace(kept, q0=_closed(kept, q0, held))


def _closed(robot: Robot, q0: Array, held: Sequence[str]) -> Array:
    """To round-off; joints whose position was written with a few digits move if they must."""
    try:
        return assemble(robot, q0, held)
    except LoopNotClosed:
        return assemble(robot, q0)

"""The initial pose of a robot with holonomic constraints: its loops closed, its redundant rows found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array
from mbocp._warn import warn_caller
from mbocp.exceptions import LoopNotClosed
from mbocp.robot.loops.projection import REDUNDANT_ROW_TOLERANCE, assemble, violations
from mbocp.robot.loops.redundancy import redundant_rows
from mbocp.robot.poses.inverse_kinematics import closed_anywhere
from mbocp.robot.robot import Robot
from mbocp.robot.warnings import InitialPoseWarning


def close_loops(robot: Robot, given: Sequence[str]) -> Robot:
    """Return the robot with an initial pose that closes the loops, and without redundant rows.

    Parameters
    ----------
    robot : Robot
        With all rows of its constraints.
    given : sequence of str
        Joints whose initial position was written. They stay where they are if the loops can be closed so;
        else those of them that have a motor do, and the others say which assembly mode is meant.

    Raises
    ------
    LoopNotClosed
        If no pose near the initial one closes the loops.
    UnsupportedRobot
        If constraints say the same as others, or leave nothing that moves.

    Warns
    -----
    InitialPoseWarning
        If neither those with a motor could stay.
    """
    if not robot.constraints:
        return robot
    q0, held = _assemble(robot, given)
    posed = replace(robot, q0=q0)
    kept = replace(posed, redundant_rows=redundant_rows(posed))
    return replace(kept, q0=_close(kept, q0, held))


def _assemble(robot: Robot, given: Sequence[str]) -> tuple[Array, Sequence[str]]:
    """A pose that closes the loops up to few digits, and the joints that could be held."""
    moved = np.any(robot.actuation.selection != 0.0, axis=1)
    moved[list(robot.driven)] = True
    motors = [name for name in given if moved[robot.velocity_indices(name)].any()]
    for held in (given, motors) if motors else (given,):
        try:
            return assemble(robot, robot.q0, held, REDUNDANT_ROW_TOLERANCE), held
        except LoopNotClosed:
            # Robots that stand in a world for themselves are far from where their loops close.
            found = closed_anywhere(robot, robot.q0, held) if robot.parts else None
            if found is not None:
                return found, held
            if not held:
                raise
    q0 = assemble(robot, robot.q0, (), REDUNDANT_ROW_TOLERANCE)
    bad = ", ".join(
        f"{name!r} by {value:.3g} {unit}" for name, value, unit in violations(robot, robot.q0)[:3]
    )
    warn_caller(
        f"robot {robot.name!r}: the initial pose violates {bad}; the nearest that closes the loops takes its "
        "place: give another in [initial] of its robot.toml, or fewer joints",
        InitialPoseWarning,
    )
    return q0, ()


def _close(robot: Robot, q0: Array, held: Sequence[str]) -> Array:
    """To round-off; joints whose position was written with a few digits move if they must."""
    try:
        return assemble(robot, q0, held)
    except LoopNotClosed:
        return assemble(robot, q0)

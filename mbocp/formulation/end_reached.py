"""Whether a motion ends at the goal, or at another root of the end condition.

An end condition that is projected onto constraints, or that speaks of matrices, holds at more configurations
than the goal. Closed loops may be assembled another way; in natural coordinates a revolute joint may have
turned half around. That is no solution of what was asked for. Two ends beside the goal are:

- *Whole turns in natural coordinates.* They know where bodies are, and not how often a joint has turned. Goal
  and end are the same configuration of the robot.
- *Drift.* Explicit schemes leave the loops as time goes on. The end is on no other branch then, it is as far
  off as the loops are open.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.base import Formulation
from mbocp.mechanics.diagnostics import constraint_violation
from mbocp.problem.frames import errors_of_poses

__all__ = ["EndMissed", "end_missed"]

_REACHED = 1e-6  # tangent-space distance [m, rad] beyond which the end is not at the goal
_OPEN = (
    1e-3  # violation of the loops, by that distance, that speaks of drift: on another branch it is round-off
)


class EndMissed(NamedTuple):
    """An end condition holds beside the goal.

    Attributes
    ----------
    is_other_root : bool
        Whether the end is another configuration of the robot than the one asked for.
    words : str
        Where it is, and what to do.
    """

    is_other_root: bool
    words: str


def end_missed(formulation: Formulation, qs: Array) -> EndMissed | None:
    """How a motion that meets the end condition misses the goal, or None where it is there.

    Parameters
    ----------
    formulation : Formulation
    qs : ndarray, shape (N + 1, nq)
        Configurations [m, rad, unit quaternion].
    """
    goal = formulation.problem.goal
    if not goal.is_exact:
        return None
    if goal.q_active.any():
        missed = _joints_missed(formulation, qs)
        if missed is not None:
            return missed
    return _frames_missed(formulation, qs[-1]) if goal.poses else None


def _joints_missed(formulation: Formulation, qs: Array) -> EndMissed | None:
    goal, robot = formulation.problem.goal, formulation.problem.robot
    missing = robot.difference(goal.q, qs[-1])[goal.q_active]
    distance = float(np.linalg.norm(missing))
    if distance <= _REACHED:
        return None
    turns = missing / (2.0 * np.pi)
    if not formulation.counts_turns and np.abs(turns - turns.round()).max() <= _REACHED:
        return EndMissed(
            is_other_root=False,
            words="but whole turns away from goal.q: bodies do not know how often a joint has turned; start "
            "from a guess that turns as often, or take joint coordinates",
        )
    violation = constraint_violation(robot, qs[-1:], np.zeros((1, robot.nv))).position
    if violation > _OPEN * distance:
        return EndMissed(
            is_other_root=False,
            words=f"but the end is {distance:.3g} off goal.q, since the scheme drifts off the loops (by "
            f"{violation:.1e} there): take more steps",
        )
    return EndMissed(
        is_other_root=goal.guard,  # who takes the guard away asks for the condition as it stands
        words=f"but the end is {distance:.3g} off goal.q: the end condition, projected onto the constraints, "
        "has another root there; start from another guess",
    )


def _frames_missed(formulation: Formulation, q: Array) -> EndMissed | None:
    """How the last configuration misses the poses of frames.

    Their rows vanish at the goal alone. Where constraints decide some of them, those are not conditions.
    """
    robot, goal = formulation.problem.robot, formulation.problem.goal
    poses = [
        frame for frame in goal.conditions if frame.has_pose
    ]  # tolerances are bounds: the status has them
    if not poses:
        return None
    errors = errors_of_poses(robot, poses, q)
    worst = int(np.argmax(errors.positions + errors.angles))
    distance, angle = float(errors.positions[worst]), float(errors.angles[worst])
    if max(distance, angle) <= _REACHED:
        return None
    name = poses[worst].name
    off = f"but {name!r} ends {1e3 * distance:.3g} mm and {np.degrees(angle):.3g} deg off its goal"
    violation = constraint_violation(robot, q[None], np.zeros((1, robot.nv))).position
    if violation > _OPEN * max(distance, angle):
        return EndMissed(
            is_other_root=False,
            words=f"{off}, since the scheme drifts off the loops (by {violation:.1e} there): take more steps",
        )
    return EndMissed(
        is_other_root=goal.guard,
        words=f"{off}: the end condition, projected onto the constraints, has another root there; start from "
        "another guess",
    )

r"""Single steps that are wrong by so much that they are no motion of the robot.

Schemes of order one move by the velocity at one end of a step, h v, where the robot moves by the mean of both
ends to the next order. So a step of length h, between velocities :math:`v_0` and :math:`v_1`, is wrong by

.. math:: \frac{h}{2} |v_1 - v_0|,

without an integration. Of other schemes the longest steps of an open chain are followed along the flow of the
robot, see `mbocp.problem.step_flow`; of all robots `mbocp.accuracy` tells.
"""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array, IntArray
from mbocp.formulation.motion import Motion
from mbocp.integrators import SCHEMES
from mbocp.integrators.schemes import what_errs_less
from mbocp.problem import Problem
from mbocp.problem.between_nodes import is_open
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.step_flow import StepFlow
from mbocp.robot import Robot

WRONG_STEP = 0.4  # [rad] of one joint: beyond, it is no motion any more; a step may turn it by 1 rad
TOLD_STEP = 0.1  # [rad] beyond which it is told
_FOLLOWED = 16  # steps at most
_PARTS = 4  # of a step, by a scheme of fourth order
_SURE = 0.1  # of an error: what twice the parts may change of it
_BEGIN = "the step to t = "


def describe_wrong_step(problem: Problem, motion: Motion) -> tuple[str, bool]:
    """Say which step is wrong, and whether by far; "" if none is known to be.

    Where feet land at times that nobody knows velocities leap, and tell nothing of the way.

    Parameters
    ----------
    problem : Problem
    motion : Motion
        With the lengths of its steps as they take place: zero for impacts.
    """
    found = _errors(problem, motion)
    if found is None or not found[1].size:
        return "", False
    turns, errors = found
    step, worst = np.unravel_index(errors.argmax(), errors.shape)
    error, time = float(errors[step, worst]), float(motion.dts[: step + 1].sum())
    if not error > TOLD_STEP:
        return "", False
    words = words_of_wrong_step(error, problem.robot.v_labels[turns[worst]].name, time, problem.scheme)
    return words, error > WRONG_STEP


def _errors(problem: Problem, motion: Motion) -> tuple[list[int], Array] | None:
    """Velocity components that turn, and by how much each step is wrong there [rad]; None: nobody knows."""
    robot, order, table = problem.robot, SCHEMES[problem.scheme].order, problem.timeline.switches
    if order == 1 and not (table is not None and table.free_feet):
        turns = list(robot.angular)
        changes = np.abs(np.diff(motion.vs[:, turns], axis=0))
        return turns, changes * motion.dts[:, None] / (2.0 * problem.substeps)
    if is_open(problem) and COORDINATES[problem.coordinates].has_joint_states:
        turns = list(robot.angular)
        return turns, _errors_of_longest(robot, motion, turns)
    return None


def _errors_of_longest(robot: Robot, motion: Motion, turns: list[int]) -> Array:
    """What the steps are wrong by in which the robot turns farthest, shape (N, turns); zero of others."""
    speeds, errors = np.abs(motion.vs[:, turns]), np.zeros((len(motion.dts), len(turns)))
    farthest = (motion.dts[:, None] * np.maximum(speeds[:-1], speeds[1:])).max(axis=1, initial=0.0)
    chosen = np.argsort(-farthest)[:_FOLLOWED]
    chosen = chosen[np.isfinite(farthest[chosen]) & (farthest[chosen] > TOLD_STEP)]
    if not chosen.size:
        return errors
    found = _follow(robot, motion, chosen, _PARTS)[:, turns]
    if (found > TOLD_STEP).any():  # a robot may be too stiff to be followed so
        finer = _follow(robot, motion, chosen, 2 * _PARTS)[:, turns]
        found = np.where(np.abs(found - finer) <= _SURE * finer, finer, 0.0)
    errors[chosen] = found
    return errors


def _follow(robot: Robot, motion: Motion, chosen: IntArray, parts: int) -> Array:
    """What some steps are wrong by, shape (n, nv); NaN where the flow is not finite."""

    def controls(share: float) -> Array:
        return motion.us_at(np.array([share]))[chosen, 0]

    begins, dts = (motion.qs[chosen], motion.vs[chosen]), motion.dts[chosen, None]
    with np.errstate(over="ignore", invalid="ignore"):
        *_, (ends, _) = StepFlow.states(robot, begins, controls, dts, parts)
        missed = [robot.difference(q, end) for q, end in zip(motion.qs[chosen + 1], ends, strict=True)]
    return np.abs(np.array(missed))


def words_of_wrong_step(error: float, joint: str, time: float, scheme: str) -> str:
    """Say that the step to a time [s] is wrong by an error [rad] of a joint, and what to do about it."""
    wrong = f"{_BEGIN}{time:.4g} s is wrong by {error:.2g} rad at {joint}"
    return f"{wrong}: take {what_errs_less(scheme)}"


def tells_wrong_step(advice: str) -> bool:
    """Whether such words are in it."""
    return _BEGIN in advice

r"""Single steps that are wrong by so much that they are no motion of the robot.

Schemes of order one move by the velocity at one end of a step, h v, where the robot moves by the mean of both
ends to the next order. So a step of length h, between velocities :math:`v_0` and :math:`v_1`, is wrong by

.. math:: \frac{h}{2} |v_1 - v_0|,

without an integration. Of schemes of higher order the flow tells, see `mbocp.accuracy`.
"""

from __future__ import annotations

import numpy as np

from mbocp.formulation.motion import Motion
from mbocp.integrators import SCHEMES
from mbocp.problem import Problem

WRONG_STEP = 0.4  # [rad] of one joint: beyond, it is no motion any more; a step may turn it by 1 rad
_TOLD = 0.1  # [rad] beyond which it is told


def describe_wrong_step(problem: Problem, motion: Motion) -> tuple[str, bool]:
    """Say which step of a scheme of order one is wrong, and whether by far; "" if none is, or of others.

    Where feet land at times that nobody knows velocities leap, and tell nothing of the way.

    Parameters
    ----------
    problem : Problem
    motion : Motion
        With the lengths of its steps as they take place: zero for impacts.
    """
    robot = problem.robot
    turns = [i for i, label in enumerate(robot.v_labels) if label.unit == "rad/s"]
    table = problem.timeline.switches
    leaps = table is not None and bool(table.free_feet)
    if SCHEMES[problem.scheme].order > 1 or leaps or not turns:
        return "", False
    changes = np.abs(np.diff(motion.vs[:, turns], axis=0))
    errors = changes * motion.dts[:, None] / (2.0 * problem.substeps)
    step, worst = np.unravel_index(errors.argmax(), errors.shape)
    error, time = float(errors[step, worst]), float(motion.dts[: step + 1].sum())
    if not error > _TOLD:
        return "", False
    return words_of_wrong_step(error, robot.v_labels[turns[worst]].name, time), error > WRONG_STEP


def words_of_wrong_step(error: float, joint: str, time: float) -> str:
    """Say that the step to a time [s] is wrong by an error [rad] of a joint, and what to do about it."""
    wrong = f"the step to t = {time:.4g} s is wrong by {error:.2g} rad at {joint}"
    return f"{wrong}: take more steps, or a scheme of higher order"

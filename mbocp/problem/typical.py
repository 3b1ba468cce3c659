"""Forces that a problem takes, and the weight on velocities that goes with them."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, BoolArray
from mbocp.robot import Robot
from mbocp.robot.large import working_data

_BEND = 0.7  # of every joint [rad, m]
_SHARE = 0.1  # of the weight with which a radian in the whole time costs as much as the largest force


def typical_force(
    robot: Robot, q_start: Array, v_start: Array, q_goal: Array, is_asked: BoolArray, duration: float
) -> float:
    """Largest generalised force that gravity, or a motion from start to goal, takes [N, N m].

    Gravity is looked at in a bent pose, too: a pendulum that hangs takes none.

    Parameters
    ----------
    robot : Robot
    q_start, q_goal : ndarray, shape (nq,)
    v_start : ndarray, shape (nv,)
    is_asked : ndarray of bool, shape (nv,)
        Directions in which `q_goal` is where the motion goes.
    duration : float
        [s]
    """
    T = duration
    away = np.where(is_asked, np.abs(robot.difference(q_start, q_goal)), 0.0)
    accelerations = np.maximum(4.0 * away / T**2, np.abs(v_start) / T)
    data, still = working_data(robot.model), np.zeros(robot.nv)
    found = 0.0
    bent = robot.integrate(q_start, np.full(robot.nv, _BEND))
    for q in (q_start, np.asarray(q_goal), np.asarray(bent)):
        gravity = np.array(pin.rnea(robot.model, data, q, still, still))
        inertia = np.array(pin.rnea(robot.model, data, q, still, accelerations)) - gravity
        found = max(found, float(np.abs(gravity).max()), float(np.abs(inertia).max()))
    return found


def velocity_weight(robot: Robot, force: float, duration: float) -> Array:
    r"""Weight of each velocity, `cost.velocity = "auto"`, shape (nv,).

    .. math:: W = \tfrac{1}{10} F^2 T^2

    with the typical force F and the duration T. A detour of a radian then costs a tenth of what the largest
    force costs that is held all the time. So light links do not spin, heavy ones still save effort. Robots
    whose drives prescribe velocities get none: their controls are weighed already.
    """
    if robot.drives:
        return np.zeros(robot.nv)
    return np.full(robot.nv, _SHARE * (force * duration) ** 2)

"""A base that goes on at a speed, as the target of the tracking cost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import DimensionMismatch, InvalidValue, ProblemError
from mbocp.robot import Robot
from mbocp.robot.joints import joint_kind


def targets_at_speed(robot: Robot, nominal: Array, q: Array, speed: Any, times: Array) -> Array:
    """Return configurations whose base goes on from that of another one, shape (n, nq).

    Parameters
    ----------
    robot : Robot
        With a floating base.
    nominal : ndarray, shape (nq,)
        What stays: height and attitude of the base but for the heading, and all other joints.
    q : ndarray, shape (nq,)
        Where the base is now.
    speed : array_like, shape (3,)
        Forward and to the left [m/s], and of the heading [rad/s].
    times : ndarray, shape (n,)
        From now on [s].

    Raises
    ------
    ProblemError, DimensionMismatch, InvalidValue
    """
    if joint_kind(robot.model, 1).word != "floating":
        raise ProblemError(f"speed: robot {robot.name!r} has no floating base that could go")
    going = np.asarray(speed, dtype=np.float64)
    if going.shape != (3,):
        raise DimensionMismatch("speed", going.shape, (3,), "forward, to the left, of the heading")
    if not np.isfinite(going).all():
        raise InvalidValue("speed", going.tolist(), "finite numbers [m/s, m/s, rad/s]")
    base, wanted = pin.XYZQUATToSE3(q[:7]), pin.XYZQUATToSE3(nominal[:7])
    heading = np.arctan2(base.rotation[1, 0], base.rotation[0, 0])
    here = pin.SE3(pin.utils.rotate("z", heading), np.append(base.translation[:2], 0.0))
    wanted.translation = np.array([0.0, 0.0, wanted.translation[2]])
    twist = np.array([going[0], going[1], 0.0, 0.0, 0.0, going[2]])
    rows = np.tile(nominal, (len(times), 1))
    rows[:, :7] = [pin.SE3ToXYZQUAT(here * pin.exp6(twist * t) * wanted) for t in times]
    return rows

"""How fast an arm can be on the straight line between two configurations: TOPP-RA, and no motion at all.

TOPP-RA (Pham and Pham, 2018; the package `toppra`, `pip install mbocp[bench]`) finds the fastest timing of a
given path within limits of velocities, accelerations and torques.
"""

from __future__ import annotations

import importlib.util
import logging
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import Robot

__all__ = ["Straight", "fastest_on_line", "fastest_on_spline", "has_toppra", "slowest_joint_alone"]

_GRID = 1000  # intervals of the path


@dataclass(frozen=True, eq=False)
class Straight:
    """The fastest timing of a straight line.

    Attributes
    ----------
    duration : float
        [s].
    torque : float
        Largest torque at the ends of the intervals, by its limit.
    """

    duration: float
    torque: float


def has_toppra() -> bool:
    """Whether the package is there."""
    return importlib.util.find_spec("toppra") is not None


def slowest_joint_alone(distances: Array, velocity: Array, acceleration: Array | None) -> float:
    """Duration [s] that no motion from rest to rest can fall below: that of the joint that takes longest.

    Parameters
    ----------
    distances : ndarray, shape (n,)
        By which the joints turn [rad].
    velocity, acceleration : ndarray, shape (n,)
        Their limits [rad/s, rad/s^2]; no limit of accelerations where it is None.
    """
    d = np.abs(distances)
    if acceleration is None:
        return float(np.max(d / velocity))
    is_short = d < velocity**2 / acceleration  # never at full speed
    return float(
        np.max(np.where(is_short, 2.0 * np.sqrt(d / acceleration), d / velocity + velocity / acceleration))
    )


def fastest_on_line(
    robot: Robot, q0: Array, q1: Array, acceleration: Array | None, grid: int = _GRID
) -> Straight:
    """The fastest timing of the line from q0 to q1, from rest to rest.

    Velocities and torques are limited as the robot says, torques by Pinocchio's inverse dynamics (RNEA),
    without friction.

    Parameters
    ----------
    q0, q1 : ndarray, shape (n,)
        Angles [rad].
    acceleration : ndarray, shape (n,), or None
        Limits [rad/s^2].
    grid : int
        Intervals of the path.

    Raises
    ------
    RuntimeError
        If TOPP-RA finds no timing.
    """
    import toppra

    way = q1 - q0
    path = toppra.SimplePath(np.array([0.0, 1.0]), np.array([q0, q1]), np.array([way, way]))
    return _fastest(robot, path, np.linspace(0.0, 1.0, grid + 1), acceleration)


def fastest_on_spline(
    robot: Robot, corners: Array, acceleration: Array | None, grid: int = _GRID
) -> Straight:
    """The fastest timing of a cubic spline through some configurations, shape (m, n), from rest to rest.

    It leaves the lines between them, and need not rest in them; otherwise as `fastest_on_line`.
    """
    import toppra

    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    path = toppra.SplineInterpolator(along / along[-1], corners)
    return _fastest(robot, path, np.linspace(0.0, 1.0, grid + 1), acceleration)


def _fastest(robot: Robot, path: Any, nodes: Array, acceleration: Array | None) -> Straight:
    from toppra import algorithm, constraint

    logging.getLogger("toppra").setLevel(logging.ERROR)
    data, limits = robot.model.createData(), robot.limits

    def torque(q: Array, v: Array, a: Array) -> Array:
        return np.array(pin.rnea(robot.model, data, q, v, a))

    asked = [
        constraint.JointVelocityConstraint(_both(limits.velocity)),
        constraint.JointTorqueConstraint(torque, _both(limits.effort), np.zeros(robot.nv)),
    ]
    if acceleration is not None:
        asked.append(constraint.JointAccelerationConstraint(_both(acceleration)))
    _, rates, _ = algorithm.TOPPRA(
        asked, path, gridpoints=nodes, solver_wrapper="seidel"
    ).compute_parameterization(0.0, 0.0)
    if rates is None:
        raise RuntimeError("TOPP-RA finds no timing")
    lengths = np.diff(nodes)
    duration = float(np.sum(2.0 * lengths / (rates[1:] + rates[:-1])))
    changes = np.diff(rates**2) / (2.0 * lengths)
    q, slope, bend = (np.array([path(s, order) for s in nodes]) for order in (0, 1, 2))
    torques = [
        torque(q[at], rates[at] * slope[at], changes[n] * slope[at] + rates[at] ** 2 * bend[at])
        for n in range(len(lengths))
        for at in (n, n + 1)
    ]
    return Straight(duration, float(np.max(np.abs(torques) / limits.effort)))


def _both(limit: Array) -> Array:
    return np.column_stack([-limit, limit])

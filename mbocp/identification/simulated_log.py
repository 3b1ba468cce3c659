"""Logs of robots whose parameters are known: to see what a log of some length and noise would tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue
from mbocp.identification.dynamics import InverseDynamics
from mbocp.identification.robot_log import Log
from mbocp.robot import Robot

HARMONICS = 5


def simulate_log(
    robot: Robot,
    *,
    amplitude: ArrayLike = 1.0,
    centre: Sequence[float] | None = None,
    period: float = 10.0,
    duration: float = 10.0,
    rate: float = 100.0,
    position_noise: float = 1e-4,
    torque_noise: float = 0.05,
    seed: int = 0,
) -> Log:
    """Simulate what is measured along a random sum of five harmonics (Swevers and others 1997).

    Parameters
    ----------
    robot : Robot
        With the true parameters, as `identify` takes robots. As many motors as independent coordinates.
    amplitude : float or sequence of float
        Largest deviation of each independent joint [rad, m].
    centre : sequence of float, optional
        From which it deviates; the initial pose by default [rad, m].
    period, duration : float
        Of the first harmonic, and of the log [s].
    rate : float
        Samples a second [1/s].
    position_noise, torque_noise : float
        Standard deviations of what is measured [rad, m; N m, N].
    seed : int
        Of the motion and of the noise.

    Raises
    ------
    InvalidValue
        If its loops do not close along the motion, or it has more or fewer motors.
    """
    dynamics = InverseDynamics(robot)
    if robot.nu != dynamics.n or not robot.actuation.selection[dynamics.independent].any(axis=0).all():
        raise InvalidValue(
            f"robot {robot.name!r}: motors", robot.nu, f"one in each of {', '.join(dynamics.names)}"
        )
    rng, t = np.random.default_rng(seed), np.arange(round(duration * rate)) / rate
    y, yd, ydd = _harmonics(rng, t, dynamics.n, period)
    size = np.asarray(amplitude, dtype=np.float64) / np.abs(y).max(axis=0)
    around = dynamics.coordinates(robot.q0) if centre is None else np.asarray(centre, dtype=np.float64)
    y, yd, ydd = around + size * y, size * yd, size * ydd
    motion = dynamics.motion(y, yd, ydd, dynamics.follow(y))
    still = np.zeros((len(t), robot.nu))
    torques = dynamics.regressor(motion) @ dynamics.values - dynamics.compute_applied_torques(motion, still)
    measured = y + position_noise * rng.standard_normal(y.shape)
    torques = torques + torque_noise * rng.standard_normal(y.shape)
    joints = {name: {"q": measured[:, k], "tau": torques[:, k]} for k, name in enumerate(dynamics.names)}
    return Log(t, joints, f"simulation of {robot.name}")


def _harmonics(rng: np.random.Generator, t: Array, n: int, period: float) -> tuple[Array, Array, Array]:
    """Values and derivatives of n sums of harmonics, each shape (K, n)."""
    a, b = rng.standard_normal((2, HARMONICS, n))
    w = 2.0 * np.pi / period * np.arange(1, HARMONICS + 1)
    sin, cos = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
    return sin @ a + cos @ b, (cos * w) @ a - (sin * w) @ b, -(sin * w**2) @ a - (cos * w**2) @ b

r"""Forces and torques at the wheels of the unicycle along a motion: eqs. (23) to (26) of [Manara2017]_.

The controls of the second paper are kinematic, so what the motors must supply comes afterwards, by inverse
dynamics. One term is misprinted: eq. (25) has :math:`\hat\omega + \hat\omega^2`, of which the first makes a
velocity of BG [m/s] and the second an acceleration [m/s^2]. The first is the angular acceleration:

.. math:: a_G = a_B + R_{sb} (\hat{\dot\omega} + \hat\omega^2)\, BG
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from mbocp._arrays import Array, frozen_array
from mbocp.exceptions import InvalidValue
from mbocp_papers.so3.data import UNICYCLE, Unicycle


@dataclass(frozen=True, eq=False)
class WheelEfforts:
    """What acts on the wheels at the beginning of each step.

    Attributes
    ----------
    force_right, force_left : ndarray, shape (N,)
        F_r, F_l: friction of the ground along the axle's x axis [N].
    torque_right, torque_left : ndarray, shape (N,)
        tau_r, tau_l: torques of the motors [N m].
    """

    force_right: Array
    force_left: Array
    torque_right: Array
    torque_left: Array

    def __post_init__(self) -> None:
        for name in ("force_right", "force_left", "torque_right", "torque_left"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), shape=(None,), name=name))


def wheel_efforts(
    yaws: ArrayLike,
    speeds: ArrayLike,
    rotations: ArrayLike,
    omegas: ArrayLike,
    controls: ArrayLike,
    dt: float,
    unicycle: Unicycle = UNICYCLE,
) -> WheelEfforts:
    """Forces and torques at the wheels, eqs. (23) to (26), at the nodes n = 0, ..., N - 1.

    Each node has the state there and the control of the step that begins there.

    Parameters
    ----------
    yaws : array_like, shape (N + 1,)
        theta at the nodes [rad].
    speeds : array_like, shape (N + 1,)
        Forward speed v [m/s].
    rotations : array_like, shape (N + 1, 3, 3)
        R_sb, from the pendulum's axes to the world's.
    omegas : array_like, shape (N + 1, 3)
        Angular velocity of the pendulum in its own axes [rad/s].
    controls : array_like, shape (N, 2)
        u_theta [rad/s], u_v [m/s^2], constant over each step.
    dt : float
        Length of a step [s].
    unicycle : Unicycle
        Masses and lengths; those of Table 1 by default.

    Raises
    ------
    DimensionMismatch
        If the shapes do not fit one another.
    InvalidValue
        If dt is not positive.
    """
    if not (np.isfinite(dt) and dt > 0):
        raise InvalidValue("dt", dt, "a positive number [s]")
    us = frozen_array(controls, shape=(None, 2), name="controls")
    nodes = len(us) + 1
    theta = frozen_array(yaws, shape=(nodes,), name="yaws")[:-1]
    v = frozen_array(speeds, shape=(nodes,), name="speeds")[:-1]
    R = frozen_array(rotations, shape=(nodes, 3, 3), name="rotations")[:-1]
    omega = frozen_array(omegas, shape=(nodes, 3), name="omegas")[:-1]

    a_B = cart_acceleration(theta, v, us)
    a_G = centre_acceleration(R, omega, pendulum_acceleration(R, omega, a_B, unicycle), a_B, unicycle)
    along = a_G[:, 0] * np.cos(theta) + a_G[:, 1] * np.sin(theta)
    theta_dd = yaw_accelerations(us[:, 0], dt)
    total = (unicycle.m_a + 2 * unicycle.m_w) * us[:, 1] + unicycle.m_p * along  # Eq. (23)
    difference = unicycle.J_yaw * theta_dd / unicycle.a  # Eq. (24)
    right, left = (total + difference) / 2, (total - difference) / 2
    # The wheels' angular accelerations, from eqs. (1) and (2).
    right_dd = (us[:, 1] + unicycle.a * theta_dd) / unicycle.r
    left_dd = (us[:, 1] - unicycle.a * theta_dd) / unicycle.r
    return WheelEfforts(
        right,
        left,
        unicycle.J_w * right_dd + right * unicycle.r,  # Eq. (26)
        unicycle.J_w * left_dd + left * unicycle.r,
    )


def wheel_efforts_of_joints(
    qs: ArrayLike, vs: ArrayLike, us: ArrayLike, dt: float, unicycle: Unicycle = UNICYCLE
) -> WheelEfforts:
    """Return `wheel_efforts` for the trajectories of the robot "unicycle_pendulum".

    Parameters
    ----------
    qs : array_like, shape (N + 1, 7)
        x_B, y_B [m], quaternion xyzw of the pendulum, theta [rad].
    vs : array_like, shape (N + 1, 6)
        Velocities of x_B, y_B [m/s], angular velocity of the pendulum [rad/s], yaw rate (unused: a control).
    us : array_like, shape (N, 2)
        u_theta [rad/s], u_v [m/s^2].
    dt : float
        Length of a step [s].
    unicycle : Unicycle
        Masses and lengths.
    """
    q = frozen_array(qs, shape=(None, 7), name="qs")
    v = frozen_array(vs, shape=(len(q), 6), name="vs")
    theta = q[:, 6]
    speeds = v[:, 0] * np.cos(theta) + v[:, 1] * np.sin(theta)
    rotations = Rotation.from_quat(q[:, 2:6]).as_matrix()
    return wheel_efforts(theta, speeds, rotations, v[:, 2:5], us, dt, unicycle)


def yaw_accelerations(yaw_rates: Array, dt: float) -> Array:
    """Yaw acceleration at the beginning of each step, shape (N,) [rad/s^2].

    The yaw rate is a control, constant over each step: its derivative is zero within and infinite between
    steps. Taken is the difference of the two steps that meet at a node, over the distance dt of their
    midpoints. The first node, where no step ends, has that of the next one.

    Parameters
    ----------
    yaw_rates : ndarray, shape (N,)
        u_theta of each step [rad/s].
    dt : float
        Length of a step [s].
    """
    if len(yaw_rates) < 2:
        return np.zeros(len(yaw_rates))
    inner: Array = np.diff(yaw_rates) / dt
    return np.concatenate([inner[:1], inner])


def cart_acceleration(theta: Array, v: Array, us: Array) -> Array:
    """Acceleration of B in world axes, eq. (3) in v and theta, shape (N, 3) [m/s^2].

    These are also the first two rows of eq. (27) as printed, where the state needs the velocities.

    Parameters
    ----------
    theta, v : ndarray, shape (N,)
        Yaw angle [rad], forward speed [m/s].
    us : ndarray, shape (N, 2)
        u_theta [rad/s], u_v [m/s^2].
    """
    cos, sin, across = np.cos(theta), np.sin(theta), v * us[:, 0]
    return np.stack(
        [us[:, 1] * cos - across * sin, us[:, 1] * sin + across * cos, np.zeros(len(theta))], axis=1
    )


def pendulum_acceleration(R: Array, omega: Array, a_B: Array, unicycle: Unicycle = UNICYCLE) -> Array:
    """Angular acceleration of the pendulum in its own axes, eqs. (4), (5), shape (N, 3) [rad/s^2].

    Parameters
    ----------
    R : ndarray, shape (N, 3, 3)
        R_sb.
    omega : ndarray, shape (N, 3)
        Angular velocity in the pendulum's axes [rad/s].
    a_B : ndarray, shape (N, 3)
        Acceleration of B in world axes [m/s^2].
    unicycle : Unicycle
        Masses and lengths.
    """
    J = np.array(unicycle.J_pB)
    F_B = -unicycle.m_p * np.einsum("nji,nj->ni", R, a_B + np.array([0.0, 0.0, unicycle.g]))  # Eq. (5)
    torque: Array = np.cross(_lever(unicycle), F_B) - np.cross(omega, J * omega)
    out: Array = torque / J
    return out


def centre_acceleration(
    R: Array, omega: Array, omega_dot: Array, a_B: Array, unicycle: Unicycle = UNICYCLE
) -> Array:
    """Acceleration of G in world axes, eq. (25) with the angular acceleration, shape (N, 3) [m/s^2].

    Parameters
    ----------
    R : ndarray, shape (N, 3, 3)
        R_sb.
    omega, omega_dot : ndarray, shape (N, 3)
        Angular velocity and acceleration in the pendulum's axes [rad/s, rad/s^2].
    a_B : ndarray, shape (N, 3)
        Acceleration of B in world axes [m/s^2].
    unicycle : Unicycle
        Masses and lengths.
    """
    lever = _lever(unicycle)
    local = np.cross(omega_dot, lever) + np.cross(omega, np.cross(omega, lever))
    out: Array = a_B + np.einsum("nij,nj->ni", R, local)
    return out


def _lever(unicycle: Unicycle) -> Array:
    return np.array([0.0, 0.0, unicycle.l])

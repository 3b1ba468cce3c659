"""Where the steps of a trajectory were evaluated, as numbers."""

from __future__ import annotations

from mbocp._arrays import Array
from mbocp.robot import Robot
from mbocp.robot.nodes import move


def evaluation_points(robot: Robot, tau: float, qs: Array, vs: Array, dts: Array) -> tuple[Array, Array]:
    """States (q_tau, v_tau) of all steps, see `mbocp.integrators.evaluation_point`.

    Parameters
    ----------
    robot : Robot
    tau : float
        Where in a step the scheme looks, between 0 and 1.
    qs : ndarray, shape (N + 1, nq)
        Configurations at the nodes [m, rad, quaternion xyzw].
    vs : ndarray, shape (N + 1, nv)
        Velocities at the nodes [m/s, rad/s].
    dts : ndarray, shape (N,)
        Step lengths [s].

    Returns
    -------
    q_taus : ndarray, shape (N, nq)
    v_taus : ndarray, shape (N, nv)
    """
    if tau in (0.0, 1.0):
        at = slice(1, None) if tau else slice(None, -1)
        return qs[at], vs[at]
    v_taus: Array = (1.0 - tau) * vs[:-1] + tau * vs[1:]
    steps = tau * dts[:, None] * v_taus
    return move(robot, qs[:-1], steps), v_taus

"""Rates of a motion: accelerations, jerks, rates of controls and powers of its steps, from its numbers."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import Robot


def rates_along(
    robot: Robot | None,
    qs: Array,
    vs: Array,
    us: Array,
    dts: Array,
    ends: Array | None = None,
    linear: Array | None = None,
    a_start: Array | None = None,
    u_start: Array | None = None,
) -> dict[str, Array]:
    """Rates in every step, by their keys in `[limits]`.

    Parameters
    ----------
    robot : Robot or None
        None leaves out the powers, which need one.
    qs : ndarray, shape (N + 1, nq)
        Configurations [m, rad, quaternion xyzw].
    vs : ndarray, shape (N + 1, nv)
        Velocities [m/s, rad/s].
    us : ndarray, shape (N, nu)
        Controls [N, N m, and the units of drives].
    dts : ndarray, shape (N,)
        Lengths of the steps [s].
    ends : ndarray, shape (N, nu), optional
        Controls at the ends of the steps; by default `us`.
    linear : ndarray, shape (N, 2, nu), optional
        Controls at both ends of the steps, where they are linear between: their rates are those in the steps.
    a_start : ndarray, shape (nv,), optional
        Acceleration at the start, zero by default [m/s^2, rad/s^2].
    u_start : ndarray, shape (nu,), optional
        Controls before the start; without them the first ones have no rate [N, N m, and the units of drives].

    Returns
    -------
    dict of str to ndarray
        ``acceleration`` (v_n - v_{n-1}) / dt and ``jerk`` (a_n - a_{n-1}) / dt with a_0 given, shape (N, nv);
        ``effort_rate`` (u_n - u_{n-1}) / dt with u_0 given, and ``power`` at the end of each step,
        shape (N, nu). Of jerks and rates of controls dt is `spacings`, in the first step half of it. Steps
        of no duration, impacts, repeat what the step before them has.
    """
    timed = dts > 0.0
    steps = np.flatnonzero(timed)
    places = np.maximum(np.searchsorted(steps, np.arange(len(dts)), side="right") - 1, 0)
    lengths, between = dts[timed][:, None], spacings(dts[timed])[:, None]
    accelerations, forces = (vs[1:] - vs[:-1])[timed] / lengths, us[timed]
    between[:1] /= 2.0  # from the start in half of the first step
    before = np.zeros((1, vs.shape[1])) if a_start is None else a_start[None]
    force_before = forces[:1] if u_start is None else u_start[None]
    rates = {
        "acceleration": accelerations,
        "jerk": np.diff(accelerations, axis=0, prepend=before) / between,
        "effort_rate": np.diff(forces, axis=0, prepend=force_before) / between,
    }
    rates = {key: values[places] for key, values in rates.items()}
    if linear is not None and linear.size:
        rates["effort_rate"] = (linear[:, 1] - linear[:, 0]) / dts[:, None]
    at_ends = us if ends is None else ends
    return rates if robot is None else {**rates, "power": powers(robot, qs[1:], vs[1:], at_ends)}


def spacings(dts: Array) -> Array:
    """Times [s] between the middles of neighbouring steps, shape (N,); of the first step its length."""
    return np.append(dts[:1], (dts[:-1] + dts[1:]) / 2.0)


def accelerations(robot: Robot, qs: Array, vs: Array, us: Array) -> Array:
    """Accelerations of a robot without constraints and drives under forces, shape (n, nv), row by row."""
    model, data, constant = robot.model, robot.model.createData(), robot.actuation.is_constant
    matrix, passive = robot.actuation_matrix(robot.q0), robot.force_elements_along(qs, vs)
    found = np.empty_like(vs)
    for n, (q, v, u) in enumerate(zip(qs, vs, us, strict=True)):
        force = (matrix if constant else robot.actuation_matrix(q)) @ u + passive[n]
        if len(model.mimicking_joints):  # Pinocchio's forward dynamics refuses them
            held = pin.rnea(model, data, q, v, np.zeros(robot.nv)).copy()
            found[n] = robot.velocity_from_momentum(q, force - held)
        else:
            found[n] = pin.aba(model, data, q, v, force)
    return found


def powers(robot: Robot, qs: Array, vs: Array, us: Array) -> Array:
    """u_i (B(q)' v)_i of each row, shape (n, nu) [W]; zero for controls that prescribe a motion."""
    if robot.actuation.is_constant:
        constant = robot.actuation_matrix(robot.q0)
        return us * (vs @ constant)
    along = np.array([robot.actuation_matrix(q).T @ v for q, v in zip(qs, vs, strict=True)])
    return np.asarray(us * along, dtype=np.float64)

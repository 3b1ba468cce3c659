"""The velocity with which the steps begin."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import InconsistentStart
from mbocp.integrators import VELOCITY_TAU
from mbocp.problem import Problem
from mbocp.robot import Robot

_ITERATIONS = 30  # Newton's method is quadratic: four are typical
_SMALL_STEP = 1e-12  # relative to the velocity: the next one would be round-off
_FAR = 10.0  # times the wanted velocity: no small correction of it any more


def consistent_velocity(problem: Problem) -> Array:
    r"""Velocity v_0 that fits the scheme, shape (nv,).

    It is the problem's, but for SE2 on a constrained system. There the first step moves to
    :math:`q_1 = q_0 \exp(\Delta t\,v_0)` before any force can act, and a tangential velocity leaves the
    constraint. So v_0 gets the smallest correction in the norm of the mass matrix,

    .. math:: v_0 \leftarrow v_0 - M^{-1} \Phi_q^T \nu \quad\text{with}\quad \Phi(q_1) = 0,

    which is of the order dt, normal to the constraint, and what every later step does with its own impulse.

    Raises
    ------
    InconsistentStart
        If no such velocity is near: the steps are too long for the start velocity. Or if start or length of
        the steps are free, so that there is none that fits before they are found.
    """
    robot, q, v = problem.robot, problem.q_start, problem.v_start
    if VELOCITY_TAU[problem.scheme] == 0.0 and robot.nc and problem.start_free is not None:
        raise InconsistentStart(
            f"start.free: scheme {problem.scheme} begins with a velocity that fits the constraints of robot "
            f"{robot.name!r} before it is found; take scheme se1 or midpoint, or give the start"
        )
    if VELOCITY_TAU[problem.scheme] == 0.0 and robot.nc and np.any(v):
        if problem.timeline.has_free_lengths:
            raise InconsistentStart(
                f"start.v: scheme {problem.scheme} begins with a velocity that fits the constraints of robot "
                f"{robot.name!r} and the length of a step, which horizon.duration or via.time leaves free; "
                "take scheme se1 or midpoint, or start at rest"
            )
        return _discrete_velocity(robot, q, v, float(problem.timeline.lengths()[0]))
    return v


def _discrete_velocity(robot: Robot, q: Array, wanted: Array, dt: float) -> Array:
    mass, push = robot.mass_matrix(q), robot.constraint_jacobian(q).T
    largest = _FAR * np.abs(wanted).max()
    v: Array = wanted
    nu = np.zeros(robot.nc)
    for _ in range(_ITERATIONS):
        q_next = robot.integrate(q, dt * v)
        residual = robot.constraint_residual(q_next)
        along = pin.dIntegrate(robot.model, q, dt * v, pin.ArgumentPosition.ARG1)
        dPhi_dv = robot.constraint_jacobian(q_next) @ along  # of Phi / dt, which is free of dt
        # One system for v and nu: the mass matrix may be singular where the constraints make up for it.
        matrix = np.block([[mass, push], [dPhi_dv, np.zeros((robot.nc, robot.nc))]])
        defect = np.concatenate([mass @ (wanted - v) - push @ nu, -residual / dt])
        step = np.linalg.lstsq(matrix, defect, rcond=None)[0]
        v, nu = v + step[: robot.nv], nu + step[robot.nv :]
        if np.abs(v).max() > largest:
            break
        if np.abs(step[: robot.nv]).max() <= _SMALL_STEP * largest:
            return v
    worst = robot.constraint_labels[int(np.argmax(np.abs(residual)))].name
    raise InconsistentStart(
        f"start.v: no velocity near it with which the first step of scheme se2, {dt:g} s, ends on the "
        f"constraint {worst!r} of robot {robot.name!r}; take more steps, or scheme se1 or midpoint"
    )

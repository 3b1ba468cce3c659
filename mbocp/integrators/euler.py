r"""Symplectic Euler schemes for the state-adjoint system.

SE1 (Box 1, eqs. (24), (25) of [Bijalwan2025]_): forces, constraints and cost are evaluated at the new state
and the control of the step, which makes the discrete optimality conditions symplectic and keeps the control
momentum.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from mbocp.mechanics import JointMechanics

__all__ = ["SCHEMES", "StepRows", "step_rows"]

SCHEMES = ("se1",)


class StepRows(NamedTuple):
    """Residual of one step, each a column.

    The rows are scaled such that the step's Jacobian stays well conditioned for any step length although the
    system has index 3: constraints by 1/dt, multipliers as impulses. In this scaling the block that has to be
    inverted tends to [[-1, dt, 0], [., -M, -Phi_q'], [Phi_q/dt, 0, 0]], whose Schur complement is free of dt.
    """

    kinematic: ca.SX  # (nv,) [m, rad]
    momentum: ca.SX  # (nv,) [N s, N m s]
    constraint: ca.SX  # (nc,) Phi / dt


def step_rows(
    mechanics: JointMechanics, q0: ca.SX, v0: ca.SX, q1: ca.SX, v1: ca.SX, impulse: ca.SX, u: ca.SX, dt: ca.SX
) -> StepRows:
    r"""SE1: :math:`q_n = q_{n-1}\exp(\Delta t\,v_n)`, momentum balance and constraints at :math:`q_n`.

    Parameters
    ----------
    mechanics : JointMechanics
        Equations of motion.
    q0, v0, q1, v1 : casadi.SX
        State before and after the step.
    impulse : casadi.SX
        Constraint impulse dt * lambda_n, shape (nc,).
    u : casadi.SX
        Control of the step, u_{n-1}.
    dt : casadi.SX
        Step length [s].

    Returns
    -------
    StepRows
        With the signs of eq. (24): dt f - (y_n - y_{n-1}).
    """
    kinematic = mechanics.difference(q1, mechanics.integrate(q0, dt * v1))  # Eq. (24), q
    acceleration = (v1 - v0) / dt
    momentum = dt * (
        mechanics.force(q1, v1, u) - mechanics.inverse_dynamics(q1, v1, acceleration)
    )  # Eq. (24), p
    if mechanics.nc:
        momentum -= mechanics.constraint_jacobian(q1).T @ impulse
    return StepRows(kinematic, momentum, mechanics.constraints(q1) / dt)  # Eq. (25)

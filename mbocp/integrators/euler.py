r"""One-step schemes of one inverse dynamics: SE1, SE2 and the midpoint rule, and semi-implicit Euler.

Forces and running cost are evaluated between the ends of the step (Appendices B and C of [Bijalwan2025]_),

.. math:: v_\tau = (1 - \tau)\,v_{n-1} + \tau\,v_n, \qquad q_\tau = q_{n-1} \exp(\tau\,\Delta t\,v_\tau),

with the control of the step. The discrete optimality conditions then evaluate the adjoint at 1 - tau
(eq. (C6)), and the map from one state and adjoint to the next is symplectic for every tau: in Appendix B the
terms that do not cancel have the factor :math:`1 - \tau_y - \tau_\mu`. So control momenta are kept to
round-off. SE1 (tau = 1, Box 1) and SE2 (tau = 0) are of first order, the midpoint rule of second.

The semi-implicit Euler method, which robot simulators take, has forces and cost at the start of the step
(tau = 0), and moves with the velocity at its end,

.. math:: v_n = v_{n-1} + \Delta t\,\mathrm{ABA}(q_{n-1}, v_{n-1}, u_{n-1}), \qquad
    q_n = q_{n-1} \exp(\Delta t\,v_n),

here as inverse dynamics. It is of first order, and for constant M and forces of positions alone its map of
the state is symplectic, too ([Hairer2006]_, theorem VI.3.3).

Constraints hold at the nodes, not at :math:`q_\tau` as in Appendix C:

- SE1, semi-implicit Euler and midpoint: :math:`\Phi(q_n) = 0` determines the multiplier. The midpoint rule
  pushes along the gradient at :math:`q_\tau`, which keeps it symmetric in time. Semi-implicit Euler pushes
  along that at :math:`q_{n-1}`: for constant M this is SHAKE ([Hairer2006]_, section VII.1.4).
  :math:`\Phi(q_\tau) = 0` would let the nodes leave the constraint, and the end q_N with them, by O(dt^2).
- SE2: :math:`q_n` is there before the step's forces act, so that its multiplier :math:`\lambda_n` can only
  answer for the position after, :math:`\Phi(q_n \exp(\Delta t\,v_n)) = \Phi(q_{n+1}) = 0`: the half-explicit
  Euler method for index 3. The start velocity has to agree with that, see `mbocp.formulation.end_rows`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import casadi as ca

from mbocp._arrays import Array
from mbocp.integrators.schemes import TAU, VELOCITY_TAU
from mbocp.mechanics import Mechanics
from mbocp.robot import Robot
from mbocp.robot.nodes import move

Difference = Callable[[ca.SX, ca.SX], ca.SX]


class State(NamedTuple):
    """Configuration and velocity."""

    q: ca.SX  # (nq,) [m, rad, quaternion xyzw]
    v: ca.SX  # (nv,) [m/s, rad/s]


class StepRows(NamedTuple):
    """Residual of one step, each a column.

    The rows are scaled such that the step's Jacobian stays well conditioned for any step length although the
    system has index 3: constraints by 1/dt, multipliers as impulses. In this scaling the block that has to be
    inverted, in the order (q_n, v_n, impulse), tends to

        [-1, tau dt, 0], [O(dt), -M, -Phi_q'], [Phi_q/dt, 0, 0]       for SE1, semi-implicit Euler, midpoint,
        [-1, 0, 0],      [0, -M, -Phi_q'],     [Phi_q/dt, Phi_q, 0]   for SE2.

    with tau of the velocity. Eliminating q_n leaves [-M, -Phi_q'], [theta Phi_q, 0], free of dt, with
    theta = tau, or 1 for SE2.
    """

    kinematic: ca.SX  # (nv,) [m, rad]; (nq,) where coordinates are compared
    momentum: ca.SX  # (nv,) [N s, N m s]
    constraint: ca.SX  # (nc,) Phi / dt


def evaluation_point(mechanics: Mechanics, scheme: str, before: State, after: State, dt: ca.SX) -> State:
    """State at which forces and running cost of the step are evaluated.

    It is an end of the step itself where tau is 0 or 1: the kinematic row makes both the same, and this is
    the simpler expression.
    """
    tau = TAU[scheme]
    if tau == 1.0:
        return after
    if tau == 0.0:
        return before
    v = kinematic_velocity(scheme, before, after)
    return State(mechanics.integrate(before.q, tau * dt * v), v)


def kinematic_velocity(scheme: str, before: State, after: State) -> ca.SX:
    """Velocity with which the configuration moves in a step, shape (nv,) [m/s, rad/s]."""
    tau = VELOCITY_TAU[scheme]
    if tau == 1.0:
        return after.v
    return before.v if tau == 0.0 else (1.0 - tau) * before.v + tau * after.v


def step_rows(
    mechanics: Mechanics,
    scheme: str,
    before: State,
    after: State,
    at: State,
    impulse: ca.SX,
    u: ca.SX,
    dt: ca.SX,
    *,
    difference: Difference | None = None,
) -> StepRows:
    r"""Kinematics :math:`q_n = q_{n-1}\exp(\Delta t\,v_\tau)`, momentum balance and constraints of one step.

    Parameters
    ----------
    mechanics : JointMechanics or NaturalMechanics
        Equations of motion.
    scheme : str
        One of `EULER_SCHEMES`.
    before, after : State
        State at both ends of the step.
    at : State
        Their `evaluation_point`.
    impulse : casadi.SX
        Constraint impulse dt * lambda_n, shape (nc,).
    u : casadi.SX
        Control of the step, u_{n-1}.
    dt : casadi.SX
        Step length [s].
    difference : callable, optional
        Compares two configurations in the kinematic rows; None: in the tangent space, as `mechanics` does.

    Returns
    -------
    StepRows
        With the signs of eq. (24): dt f - (y_n - y_{n-1}).
    """
    reached = mechanics.integrate(before.q, dt * kinematic_velocity(scheme, before, after))
    kinematic = (difference or mechanics.difference)(after.q, reached)  # Eq. (24), q
    acceleration = (after.v - before.v) / dt
    momentum = dt * (
        mechanics.force(at.q, at.v, u) - mechanics.inverse_dynamics(at.q, at.v, acceleration)
    )  # Eq. (24), p
    if mechanics.nc:
        momentum -= mechanics.constraint_jacobian(at.q).T @ impulse
    position = mechanics.integrate(after.q, dt * after.v) if VELOCITY_TAU[scheme] == 0.0 else after.q
    return StepRows(kinematic, momentum, mechanics.constraints(position) / dt)  # Eq. (25)


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

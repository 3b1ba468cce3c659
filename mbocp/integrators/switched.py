r"""Steps in which some constraints act and others do not, and impacts, steps of no duration.

One kind of step for all of them, so that nothing compiles anew for other spans and no solver has to know.
Each row that can be switched has a number e, 1 where it acts and 0 where it does not, and each step a number
k, 1 for an impact. With the impulses :math:`\Lambda` and :math:`\Delta t' = (1 - k)\,\Delta t`,

.. math::
    q_1 &= q_0 \exp(\Delta t'\,v_\tau), \\
    M\,(v_1 - v_0) &= \Delta t'\,(f - C v - g) - J^T \Lambda, \\
    0 &= e\,\bigl[(1 - k)\,\Phi(q_1; q_0) / \Delta t + k\,J v_1\bigr] + (1 - e)\,(\Lambda - w).

So an impact leaves the configuration, and :math:`M (v_1 - v_0) = -J^T \Lambda` with :math:`J v_1 = 0`: the
inelastic impact, in which the kinetic energy falls by :math:`(v_1 - v_0)^T M (v_1 - v_0) / 2`, and momenta
about what holds are kept. The robot's own loops take part. The duration of a step is never divided by: of an
impact :math:`\Delta t` is that of its neighbours, and scales alone.

The same step is a *parting* where it is the last of a hold: a step keeps places, :math:`\Phi(q_1; q_0) = 0`,
and with them means of velocities alone. By the midpoint rule :math:`J v_n` alternates about zero, within the
range of :math:`J M^{-1} J^T`; by SE1 it is that of the chord. Before anything is let go, a parting takes out
just that part, :math:`v_1 = v_0 - M^{-1} J^T \Lambda` with :math:`J v_1 = 0`, as RATTLE does in every step
([Hairer2006]_, VII.1): momenta are kept, and what flies off has the velocity that the hold allows. Its
impulse belongs to the last step, as both of RATTLE's multipliers do, and bounds on forces hold for their
sum. An equation :math:`J v_n = 0` in the place of this step would leave motions without controls no solution,
and ask of the others that their errors cancel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca

from mbocp.integrators.euler import Difference, State, StepRows, evaluation_point, kinematic_velocity
from mbocp.mechanics import Mechanics
from mbocp.mechanics.held_frames import HeldFrame, write_held_jacobian, write_held_rows


class ActiveForces(NamedTuple):
    """What acts in a step.

    Attributes
    ----------
    held : sequence of HeldFrame
        Further constraints, after those of the mechanics.
    active : casadi.SX, shape (rows,)
        e of every row: of the mechanics' constraints, then of the held frames.
    is_impact : casadi.SX
        k; a constant zero where there are no impacts.
    given : casadi.SX, shape (rows,)
        Impulses w of rows that do not act.
    """

    held: Sequence[HeldFrame]
    active: ca.SX
    is_impact: ca.SX
    given: ca.SX


def evaluate_switched_point(
    mechanics: Mechanics, scheme: str, before: State, after: State, dt: ca.SX, switched: ActiveForces
) -> State:
    """State at which forces and running cost are evaluated."""
    return evaluation_point(mechanics, scheme, before, after, (1 - switched.is_impact) * dt)


def write_switched_rows(
    mechanics: Mechanics,
    scheme: str,
    before: State,
    after: State,
    at: State,
    impulse: ca.SX,
    u: ca.SX,
    dt: ca.SX,
    switched: ActiveForces,
    *,
    difference: Difference | None = None,
) -> StepRows:
    """Rows of a step or an impact; see `mbocp.integrators.step_rows`, whose rows they are where all act.

    Parameters
    ----------
    impulse : casadi.SX
        Of the mechanics' constraints and of the held frames.
    """
    goes = 1 - switched.is_impact
    reached = mechanics.integrate(before.q, goes * dt * kinematic_velocity(scheme, before, after))
    kinematic = (difference or mechanics.difference)(after.q, reached)
    acceleration = (after.v - before.v) / dt
    inertial = mechanics.inverse_dynamics(at.q, goes * at.v, acceleration)
    if not switched.is_impact.is_zero():  # what gravity does in no time
        still = ca.SX.zeros(mechanics.nv)
        inertial -= switched.is_impact * mechanics.inverse_dynamics(at.q, still, still)
    jacobian = ca.vertcat(
        mechanics.constraint_jacobian(at.q), write_held_jacobian(switched.held, mechanics, at.q)
    )
    momentum = dt * (goes * mechanics.force(at.q, at.v, u) - inertial) - jacobian.T @ impulse
    places = ca.vertcat(
        mechanics.constraints(after.q), write_held_rows(switched.held, mechanics, after.q, before.q)
    )
    rows = goes * places / dt + switched.is_impact * (jacobian @ after.v)
    others = impulse - switched.given
    return StepRows(kinematic, momentum, switched.active * rows + (1 - switched.active) * others)

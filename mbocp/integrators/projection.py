r"""The midpoint rule with velocities that are projected onto the constraints at the end of each step.

The midpoint rule keeps positions, :math:`\Phi(q_n) = 0`, and with them means of velocities alone: across the
constraints :math:`v_n` is minus :math:`v_{n-1}`, nearly, and what a step begins with wrongly stays. Here a
step reaches a velocity :math:`\hat v_n` by that rule, and leaves it for the nearest one, in the kinetic
metric, that the constraints allow:

.. math::
    M(q_n)\,(\hat v_n - v_n) = J(q_n)^T \Gamma_n, \qquad J(q_n)\,v_n = 0.

The leap :math:`\delta_n = \hat v_n - v_n` is of the order of the error of a step, so that the rule keeps its
order two ([Hairer2006]_, section IV.4); momenta about what holds stay, since :math:`J^T \Gamma` is a force of
the constraints. In an impact :math:`\hat v_n` is there already, and leap and impulse are zero. Without
constraints there is nothing to project, and the steps are those of the midpoint rule.
"""

from __future__ import annotations

from typing import NamedTuple

import casadi as ca

from mbocp.integrators.euler import State
from mbocp.integrators.switched import ActiveForces
from mbocp.mechanics import JointMechanics
from mbocp.mechanics.held_frames import write_held_jacobian


class ProjectionRows(NamedTuple):
    """Residual of a projection, each a column."""

    balance: ca.SX  # (nv,) [N s, N m s]
    drift: ca.SX  # (rows,) J v [m/s, rad/s]


def write_projection_rows(
    mechanics: JointMechanics, after: State, leap: ca.SX, impulse: ca.SX, switched: ActiveForces | None
) -> ProjectionRows:
    """Rows that make the velocity after a step one that the constraints allow.

    Parameters
    ----------
    mechanics : JointMechanics
    after : State
        Where the step ends, with the velocity that is left.
    leap : casadi.SX, shape (nv,)
        What the velocity loses, symbols [m/s, rad/s].
    impulse : casadi.SX, shape (rows,)
        Gamma [N s, N m s].
    switched : ActiveForces or None
        What acts in the step, where constraints begin and end along the way; the others have no impulse.
    """
    jacobian = mechanics.constraint_jacobian(after.q)
    if switched is not None:
        jacobian = ca.vertcat(jacobian, write_held_jacobian(switched.held, mechanics, after.q))
    drift = jacobian @ after.v
    if switched is not None:
        drift = switched.active * drift + (1 - switched.active) * impulse
    lost = ca.gradient(mechanics.kinetic_energy(after.q, leap), leap)  # M leap, in a tenth of the operations
    return ProjectionRows(lost - jacobian.T @ impulse, drift)

r"""Adjoints in the two coordinates of a state: (q, v), in which steps are written, and (q, p) of the paper.

With :math:`p = M(q)\,v` a covector is :math:`c_q \cdot dq + c_v \cdot dv = \mu_q \cdot dq + \mu_p \cdot dp`:

.. math:: c_v = M\,\mu_p, \qquad c_q = \mu_q + \left(\frac{\partial (M v)}{\partial q}\right)^T \mu_p.

dq is a tangent vector at q throughout, and dp belongs to the body-fixed components of p.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.mechanics.joint_mechanics import JointMechanics
from mbocp.robot import Robot
from mbocp.robot.kinematics import any_singular, mass_matrices
from mbocp.robot.large import make_working_data


def momentum_derivative(robot: Robot, q: Array, v: Array) -> Array:
    """Derivative of M(q) v along the tangent space of q, shape (nv, nv) [N s/rad, N m s/rad, N s/m]."""
    if len(robot.model.mimicking_joints):  # Pinocchio's derivatives refuse them
        return _momentum_derivative(robot)(q, v).full()
    model, zero = robot.model, np.zeros(robot.nv)
    data = make_working_data(model)  # what Pinocchio returns points into it
    # M(q) v is what an acceleration v takes at rest, less gravity.
    derivative: Array = pin.computeRNEADerivatives(model, data, q, zero, np.asarray(v))[0].copy()
    derivative -= pin.computeGeneralizedGravityDerivatives(model, data, q)
    return derivative


def dual_of_momentum(robot: Robot, q: Array, v: Array, costate: Array) -> Array:
    """From the dual of (q, v) to mu = (mu_q, mu_p), shape (2 nv,)."""
    nv = robot.nv
    mu_p = robot.velocity_from_momentum(q, costate[nv:])
    return np.concatenate([costate[:nv] - momentum_derivative(robot, q, v).T @ mu_p, mu_p])


def duals_of_momenta(robot: Robot, qs: Array, vs: Array, costates: Array) -> Array:
    """The same at many nodes, shape (k, 2 nv)."""
    nv, masses = robot.nv, mass_matrices(robot.model, qs)
    if any_singular(masses):
        nodes = zip(qs, vs, costates, strict=True)
        return np.array([dual_of_momentum(robot, q, v, c) for q, v, c in nodes])
    mu_p = np.linalg.solve(masses, costates[:, nv:, None])[:, :, 0]
    pulled = [momentum_derivative(robot, q, v).T @ m for q, v, m in zip(qs, vs, mu_p, strict=True)]
    return np.hstack([costates[:, :nv] - np.array(pulled), mu_p])


def dual_of_velocity(robot: Robot, q: Array, v: Array, mu: Array) -> Array:
    """From mu = (mu_q, mu_p) to the dual of (q, v), shape (2 nv,)."""
    nv = robot.nv
    along_q = mu[:nv] + momentum_derivative(robot, q, v).T @ mu[nv:]
    return np.concatenate([along_q, robot.mass_matrix(q) @ mu[nv:]])


@lru_cache(maxsize=16)
def _momentum_derivative(robot: Robot) -> ca.Function:
    """Derivative of M(q) v along the tangent space of q, from the symbolic inverse dynamics."""
    mechanics, rest = JointMechanics(robot), ca.SX.zeros(robot.nv)
    q, v = ca.SX.sym("q", robot.nq), ca.SX.sym("v", robot.nv)
    momentum = mechanics.inverse_dynamics(q, rest, v) - mechanics.inverse_dynamics(q, rest, rest)
    derivative = ca.jacobian(momentum, q) @ mechanics.tangent_map(q)
    return ca.Function("momentum_derivative", [q, v], [ca.densify(derivative)])

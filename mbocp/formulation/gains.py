r"""Feedback gains of an optimum: what its controls answer to a deviation of the state.

The Riccati recursion of a Newton step at the optimum (see `mbocp.solvers.newton_method.newton`) eliminates
the controls of each step as :math:`\Delta u_n = K_n\, \Delta x_n + \dots`. :math:`K_n` is the feedback of the
quadratic problem about the optimum, in which the end condition is a stiff penalty: gains stay finite where
too few steps are left to meet it. Limits are springs of their multipliers by the distances from them, as in
the last step of the solver: stiff where they are active, soft where the tolerance does not tell.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.base import Formulation
from mbocp.formulation.layout import StateLayout
from mbocp.integrators import TABLEAUX
from mbocp.lie import ConfigurationSpace
from mbocp.programme import Iterate
from mbocp.solvers.newton_method.held_limits import GAIN_WEIGHT, active_limits, factorise_held
from mbocp.solvers.newton_method.limit_multipliers import at_solution

_ROBUST_WEIGHT = 1e5  # of the end condition by the weight of the controls that answer to what is uncertain
_SHIFTS = (0.0, 1e-6, 1e-4, 1e-2, 1.0, 1e2)  # of the Hessian in the states, the same


def feedback_gains(formulation: Formulation, iterate: Iterate) -> Array:
    """Gains K at an iterate, for deviations of (q, v).

    Parameters
    ----------
    formulation : Formulation
    iterate : Iterate
        An optimum, multipliers included.

    Returns
    -------
    gains : ndarray, shape (N, k nu, 2 nv)
        Of the robot's controls in every step, by moves of q along the tangent and by v at its begin; of
        controls with k values in a step all of them, one block after the other. Active limits stay active:
        the row of a control at its limit is zero. Linear controls have nu more columns, for what the control
        is away from its plan at the begin of the step, of which there is nothing in the first. Of robust
        problems they are those of the cost alone, without limits and the curvature of the mechanics. Shape
        (0, 0, 0) where states are not (q, v), as in natural coordinates, where steps leave the manifold of
        rotations, or where no weight gives the signs of a minimum.
    """
    problem, layout = formulation.problem, formulation.layout
    robot = problem.robot
    is_plain = layout.is_flat and robot.nq != robot.nv
    leaves_group = is_plain and problem.scheme in TABLEAUX and problem.lie != "munthe_kaas"
    if not has_joint_states(formulation) or leaves_group:
        return np.zeros((0, 0, 0))
    weight = GAIN_WEIGHT
    if problem.robust is not None:
        # With the curvature of the mechanics feedback may not stabilise, and there is none at limits.
        weight = _ROBUST_WEIGHT
        iterate = replace(iterate, ms=np.zeros_like(iterate.ms), eta=np.zeros_like(iterate.eta), bounds=None)
    programme = formulation.programme
    native, kind = at_solution(programme, iterate), programme.kind
    if not (native.evaluate().finite and factorise_held(native, programme, shifts=_SHIFTS, first=weight)):
        return np.zeros((0, 0, 0))
    is_continuous = formulation.pieces.signature.control_values.is_continuous
    of_step = partial(_answers, layout, robot.nu, is_continuous)
    blocks = native.gains().reshape(-1, kind.nu, kind.ndx)
    gains = np.array([of_step(block, n) for n, block in enumerate(blocks)])
    if is_plain:
        along = gains[:, :, : layout.nz] @ tangents(formulation, iterate.xs[:-1])
        gains = np.concatenate([along, gains[:, :, layout.nz :]], axis=2)
    _, held, _ = active_limits(programme, iterate)
    gains[held[:, kind.nx : kind.nx + layout.num_own]] = 0.0
    return gains


def has_joint_states(formulation: Formulation) -> bool:
    """Whether states are (q, v) of the joints."""
    is_of_joints = isinstance(formulation.space, ConfigurationSpace)
    return is_of_joints and formulation.layout.ns == formulation.problem.robot.nv


def tangents(formulation: Formulation, xs: Array) -> Array:
    """Derivatives of the configurations in states by moves of the robot along its tangent.

    Parameters
    ----------
    xs : ndarray, shape (n, nx)

    Returns
    -------
    ndarray, shape (n, nw, nv)
        Of natural coordinates, and of states that are taken by their tangent, the identity.
    """
    layout, space = formulation.layout, formulation.space
    if layout.is_flat and isinstance(space, ConfigurationSpace):
        return space.tangents(xs[:, layout.z])
    return np.broadcast_to(np.eye(layout.nw), (len(xs), layout.nw, layout.nw))


def _answers(layout: StateLayout, nu: int, is_continuous: bool, block: Array, step: int) -> Array:
    """Rows of the values of the controls, in the columns of (q, v), and of continuous controls."""
    rows = block[: layout.num_own]
    of_state = rows[:, : layout.nw + layout.ns]
    if not is_continuous:
        return of_state
    found = np.hstack([of_state, rows[:, layout.rows["control"]]])
    if step:  # the first value is the last of the step before
        found[:nu] = 0.0
        found[:nu, -nu:] = np.eye(nu)
    return found

r"""Conditions of the end that a solve chose where its motion ends: they go along with this end.

They are projections D(q_d), and a solve ends with :math:`q_d = q_N`. In a parameter p, along directions B
that the constraints allow, :math:`q_N' = \partial q_N / \partial p + \partial q_N / \partial q_d\, B a`,
which :math:`q_d' = \partial q_d / \partial p + B a` has to be: small systems, one for each parameter.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from mbocp._arrays import Array, null_space
from mbocp._tolerances import RANK_TOLERANCE
from mbocp.formulation import Formulation
from mbocp.formulation.features.changing_constraints import ties_at_end
from mbocp.formulation.layout import places
from mbocp.mechanisms.consistent_states import tangent_space
from mbocp.problem import Problem
from mbocp.sensitivity.change import Change, change_along
from mbocp.sensitivity.of_ends import put_goal


def take_end_along(
    formulation: Formulation, change: Change, slopes_of_end: Callable[[Change], Array]
) -> Change:
    """A change of the numbers, with that of the conditions which are those where the motion ends.

    Parameters
    ----------
    formulation : Formulation
    change : Change
        In k parameters.
    slopes_of_end : callable
        Derivatives of the last configuration along changes of the numbers, a row each: Change -> (k, nv).
    """
    problem = formulation.problem
    if not (problem.goal.q_is_reached and len(formulation.end_rows.D_rate)):
        return change
    basis = _free(problem)
    if not basis.size:
        return change
    own = change_along(formulation, *(partial(_with_end_at, problem, move) for move in basis.T))
    both = Change.join([change, own])
    slopes, k = slopes_of_end(both) @ basis, len(change.start)
    given = _of_goal(formulation, change) @ basis
    along = np.linalg.solve((np.eye(len(slopes) - k) - slopes[k:]).T, (slopes[:k] - given).T).T
    return both.along(np.hstack([np.eye(k), along]))


def _free(problem: Problem) -> Array:
    """Directions that constraints, and joints which the goal gives, leave to the end, shape (nv, any)."""
    goal, ties = problem.goal, ties_at_end(problem, problem.goal.q)
    basis = null_space(ties[0], RANK_TOLERANCE) if ties else tangent_space(problem.robot, goal.q)
    return basis @ null_space(basis[goal.q_active], RANK_TOLERANCE)


def _with_end_at(problem: Problem, move: Array, size: float) -> Problem:
    return put_goal(problem, problem.robot.integrate(problem.goal.q, size * move))


def _of_goal(formulation: Formulation, change: Change) -> Array:
    """How a change moves the configuration at which conditions are chosen, in the tangent, shape (k, nv)."""
    space = formulation.pieces.joints
    z = space.coordinates(np.asarray(formulation.problem.goal.q)[None])
    at = places(formulation.pieces.parameters.terminal)["q"]
    return change.rho_terminal[:, at] @ np.linalg.pinv(space.tangents(z)[0]).T

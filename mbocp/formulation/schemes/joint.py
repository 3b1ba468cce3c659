"""What implicit and explicit schemes in joint coordinates have in common when an iterate is read."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.features.switches import breaks_symmetries
from mbocp.formulation.layout import StateLayout
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics.diagnostics import control_momenta
from mbocp.problem import Problem
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.programme.kernel import kernel_programme
from mbocp.terms import TermNumbers, running_terms

__all__ = [
    "boundary_duals",
    "largest_defects",
    "momenta_of_symmetries",
    "stage_costs",
    "tangent_duals",
    "weighed_components",
]

_KEPT = 16  # functions of configuration spaces


def boundary_duals(programme: StagewiseProgramme, iterate: Iterate) -> Array:
    """Derivatives of the Lagrangian of what follows each node in its state, shape (N + 1, ndx)."""
    native = kernel_programme(programme)
    iterate.load_into(native)
    native.evaluate()
    costates: Array = native.costates.reshape(programme.num_steps + 1, -1)
    return costates


def stage_costs(programme: StagewiseProgramme, iterate: Iterate) -> Array:
    """Running cost of every step, from the stage functions, shape (N,); NaN where they fail."""
    N = programme.num_steps
    arguments = (iterate.xs[:-1], iterate.xs[1:], iterate.ys, iterate.us)
    theta, rho = np.tile(programme.theta[:, None], (1, N)), programme.rho.reshape(N, -1)
    values = programme.functions.function("values").map(N)
    try:
        costs: Array = np.asarray(values(*(a.T for a in arguments), theta, rho.T)[1]).ravel()
    except RuntimeError:  # what CasADi raises where a compiled function reports that it failed
        return np.full(N, np.nan)
    return costs


def tangent_duals(space: ConfigurationSpace, at: StateLayout, zs: Array, duals: Array) -> Array:
    """Duals of the coordinates as duals of tangent vectors; those of previous controls are left out."""
    along = duals[:, : at.nw]
    if at.is_flat and not space.is_vector:
        along = np.asarray(_pull_back(space).map(len(zs))(zs.T, along.T)).T
    return np.hstack([along, duals[:, at.ds]])


@lru_cache(maxsize=_KEPT)
def _pull_back(space: ConfigurationSpace) -> ca.Function:
    """From coordinates and their dual to the dual of the tangent vector."""
    z, c, v = ca.SX.sym("z", space.nz), ca.SX.sym("c", space.nz), ca.SX.sym("v", space.nv)
    return ca.Function("pulled", [z, c], [ca.gradient(ca.dot(c, space.rate(z, v)), v)])


def momenta_of_symmetries(
    problem: Problem, qs: Array, vs: Array, costates: Array
) -> tuple[Array, tuple[str, ...]]:
    """Control momenta; none where drives, path constraints or limits of rates are: not looked for there.

    Holds and impacts keep them: what is held where it is moves along with the robot. Linear controls are
    part of the state, and forces in axes of the world turn with it: their part is not looked for either.
    """
    has_more = problem.robot.drives or problem.inequalities or problem.controls == "linear"
    if has_more or breaks_symmetries(problem):
        return np.zeros((len(qs), 0)), ()
    tracked, weighs_changes = weighed_components(problem), weighs_control_changes(problem)
    return control_momenta(problem.robot, qs, vs, costates, tracked=tracked, weighs_changes=weighs_changes)


def weighs_control_changes(problem: Problem) -> bool:
    """Whether the running cost weighs how controls change from step to step."""
    return bool(np.any(problem.heaviest_cost.control_rate))


def weighed_components(problem: Problem) -> Array | None:
    """Components of (q, p) that the running cost looks at; one on velocities counts as one on momenta."""
    robot, nv = problem.robot, problem.robot.nv
    given = TermNumbers(
        problem.heaviest_cost, robot, ConfigurationSpace(robot.model), problem.num_steps, problem.terms
    )
    weights = np.zeros(2 * nv)
    for term in running_terms(given):
        weights += term.touches(given)
    limits = problem.widest_limits
    for side in (limits.v_lower, limits.v_upper):
        weights[nv:] += np.isfinite(side)
    bounded = np.isfinite(limits.q_lower) | np.isfinite(limits.q_upper)
    for joint in problem.robot.joint_names:
        if bounded[problem.robot.configuration_indices(joint)].any():
            weights[:nv][problem.robot.velocity_indices(joint)] += 1.0
    return weights if weights.any() else None


def largest_defects(space: ConfigurationSpace, zs: Array) -> Array:
    """Largest defect of coordinates (k, nz) as configurations, shape (k,)."""
    found = np.abs(np.asarray(_defects_of(space).map(len(zs))(zs.T)))
    largest: Array = found.max(axis=0, initial=0.0)
    return largest


@lru_cache(maxsize=_KEPT)
def _defects_of(space: ConfigurationSpace) -> ca.Function:
    """Coordinates -> what vanishes where they are a configuration."""
    z = ca.SX.sym("z", space.nz)
    return ca.Function("defects", [z], [ca.densify(space.defects(z))])

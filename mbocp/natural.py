"""Motions in natural coordinates: iterates from motions of the joints, and what iterates say of them."""

from __future__ import annotations

import casadi as ca
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from mbocp._arrays import Array
from mbocp.formulation import Formulation
from mbocp.integrators import TAU
from mbocp.mechanics import NaturalMechanics, NaturalSpace
from mbocp.mechanics.symmetries import find_symmetries
from mbocp.solution.diagnostics import ConstraintViolation, worst_violation
from mbocp.solvers import Iterate, zero_multipliers

__all__ = ["natural_hamiltonians", "natural_iterate", "natural_momenta", "natural_violation"]


def natural_iterate(
    formulation: Formulation, space: NaturalSpace, qs: Array, vs: Array, us: Array
) -> Iterate:
    """Iterate at a motion of the joints: all bodies where the joints put them, adjoints zero.

    Velocities are those of the scheme's kinematics: for SE1 chords, (q_n - q_{n-1})/dt, which the joints'
    velocities are not. The multipliers balance the momenta best, in the least-squares sense.

    Parameters
    ----------
    qs, vs : ndarray, shapes (N + 1, nq), (N + 1, nv)
        Of the joints.
    us : ndarray, shape (N, nu)
    """
    problem, programme = formulation.problem, formulation.programme
    at, N = formulation.layout, problem.num_steps
    xs = np.zeros((N + 1, at.nx))
    xs[:, at.z] = space.coordinates(qs)
    if TAU[problem.scheme] == 1.0:
        xs[1:, at.s] = np.diff(xs[:, at.z], axis=0) / problem.dt
    else:
        xs[:, at.s] = space.rates(qs, vs)
    if at.nr:
        xs[1:, at.r] = us
    xs[0] = programme.x_start
    return zero_multipliers(programme, xs, _impulses(formulation, xs, us), us)


def _impulses(formulation: Formulation, xs: Array, us: Array) -> Array:
    """Impulses y that leave the least of the momentum rows, by normal equations, shape (N, ny)."""
    programme = formulation.programme
    at, N, ny = formulation.layout, programme.num_steps, programme.kinds[0].ny
    theta, rho = np.tile(programme.theta[:, None], (1, N)), programme.rho.reshape(N, -1)
    step = programme.functions.function("jacobian").map(N)
    c, _, derivatives, _ = step(xs[:-1].T, xs[1:].T, np.zeros((ny, N)), us.T, theta, rho.T)
    rows = np.asarray(c)[at.ds].T
    side_by_side = derivatives.sparse().tocsc()
    width = side_by_side.shape[1] // N
    columns = (np.arange(N)[:, None] * width + at.ndx + np.arange(ny)).ravel()
    blocks = side_by_side[at.ds][:, columns].tocoo()
    places = (blocks.row + blocks.col // ny * rows.shape[1], blocks.col)  # one below the other
    push = sparse.csc_matrix((-blocks.data, places), shape=(rows.size, N * ny))  # G' of all steps
    found: Array = spsolve(push.T @ push, push.T @ rows.ravel(), permc_spec="MMD_AT_PLUS_A")
    return found.reshape(N, ny)


def natural_hamiltonians(
    formulation: Formulation, iterate: Iterate, duals: Array, stage_costs: Array
) -> Array:
    """H = L + mu . f + zeta . Phi of every step, eq. (11), shape (N,), where the mass matrix is constant.

    The kinematic row's dual is taken at tau, as in joint coordinates.
    """
    problem = formulation.problem
    at, dt, tau = formulation.layout, problem.dt, TAU[problem.scheme]
    vs, rows = iterate.xs[:, at.s], iterate.ms
    velocity = tau * vs[1:] + (1.0 - tau) * vs[:-1]
    along = tau * duals[:-1, : at.nw] + (1.0 - tau) * rows[:, : at.nw]
    mechanics = _mechanics(formulation)
    inertial = np.diff(vs, axis=0) / dt @ mechanics.mass_at(iterate.xs[0, at.z])
    values = stage_costs / dt + np.einsum("ni,ni->n", along, velocity)
    total: Array = values + np.einsum("ni,ni->n", rows[:, at.ds], inertial)
    return total


def natural_momenta(
    formulation: Formulation, iterate: Iterate, duals: Array, tracked: Array | None
) -> tuple[Array, tuple[str, ...]]:
    """Control momenta, eq. (15): sums of q x mu^q + p x mu^p over all points and directors.

    In the duals c of (z, w) it is c . (X z, X w) with the rotation X: exactly what a step keeps.

    Returns
    -------
    momenta : ndarray, shape (N + 1, k)
    names : tuple of str
    """
    problem = formulation.problem
    at, robot = formulation.layout, problem.robot
    nodes = len(iterate.xs)
    if problem.path or not isinstance(formulation.space, NaturalSpace):
        return np.zeros((nodes, 0)), ()
    mask = np.zeros(2 * robot.nv, dtype=bool) if tracked is None else np.asarray(tracked, dtype=bool)
    kept = [s for s in find_symmetries(robot) if not s.touches(mask)]
    zs, ws = iterate.xs[:, at.z], iterate.xs[:, at.s]
    columns = [np.einsum("ni,ni->n", duals, formulation.space.generator(s, zs, ws)) for s in kept]
    momenta: Array = np.array(columns).T if columns else np.zeros((nodes, 0))
    return momenta, tuple(s.name for s in kept)


def natural_violation(formulation: Formulation, zs: Array, ws: Array) -> ConstraintViolation:
    """Largest violation of any constraint along a motion, those of rigid bodies and joints included.

    Parameters
    ----------
    zs, ws : ndarray, shape (N + 1, n)
        Natural coordinates and their rates.
    """
    mechanics = _mechanics(formulation)
    z, w = ca.SX.sym("z", mechanics.nq), ca.SX.sym("w", mechanics.nq)
    rows = ca.densify(mechanics.constraints(z))
    both = ca.Function("Phi", [z, w], [rows, ca.densify(ca.jtimes(rows, z, w))]).map(len(zs))
    position, velocity = (np.asarray(values).T for values in both(zs.T, ws.T))
    return worst_violation(position, velocity, [label.name for label in mechanics.constraint_labels])


def _mechanics(formulation: Formulation) -> NaturalMechanics:
    if not isinstance(formulation.space, NaturalSpace):
        raise TypeError("not a programme in natural coordinates")
    return formulation.space.mechanics

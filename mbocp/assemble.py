"""From a solver's iterate to trajectories in the paper's scaling, and what they prove about themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp.integrators import TAU, evaluation_points
from mbocp.mechanics import dual_of_momentum
from mbocp.problem import Problem
from mbocp.robot import Robot
from mbocp.solution.diagnostics import constraint_violation, control_momenta
from mbocp.solvers import Iterate
from mbocp.solvers.native import kernel_programme
from mbocp.transcription import StagewiseProgramme

__all__ = ["Trajectory", "assemble", "boundary_duals"]


@dataclass(frozen=True)
class Trajectory:
    """Trajectories of a solution; see `mbocp.solution.Solution` for shapes and units."""

    t: Array
    qs: Array
    vs: Array
    ps: Array
    us: Array
    lams: Array
    mus: Array
    zetas: Array
    eta: Array
    control_hamiltonians: Array
    control_momenta: Array
    control_momentum_names: tuple[str, ...]
    constraint_violation: float

    def fields(self) -> dict[str, Any]:
        """Fields by name, not copied."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


def assemble(problem: Problem, programme: StagewiseProgramme, iterate: Iterate) -> Trajectory:
    """Trajectories, multipliers, control Hamiltonian and control momentum of an iterate."""
    robot, N, dt = problem.robot, problem.num_steps, problem.dt
    nq, nv = robot.nq, robot.nv
    qs, vs = iterate.xs[:, :nq], iterate.xs[:, nq:]
    lams, zetas = iterate.ys / dt, iterate.ms[:, 2 * nv :] / dt**2
    costates = boundary_duals(programme, iterate)
    momenta, names = control_momenta(robot, qs, vs, costates, tracked=_weighed(problem))
    return Trajectory(
        t=np.arange(N + 1, dtype=np.float64) * dt,
        qs=qs,
        vs=vs,
        ps=_momenta(robot, qs, vs),
        us=iterate.us,
        lams=lams,
        mus=_adjoints(problem, iterate, costates),
        zetas=zetas,
        eta=iterate.eta,
        control_hamiltonians=_control_hamiltonians(problem, iterate, costates, zetas),
        control_momenta=momenta,
        control_momentum_names=names,
        constraint_violation=constraint_violation(robot, qs, vs).position,
    )


def boundary_duals(programme: StagewiseProgramme, iterate: Iterate) -> Array:
    """Derivatives of the Lagrangian of what follows each node in (q_n, v_n), shape (N + 1, 2 nv)."""
    native = kernel_programme(programme)
    iterate.load_into(native)
    native.evaluate()
    costates: Array = native.costates.reshape(programme.num_steps + 1, -1)
    return costates


def _control_hamiltonians(problem: Problem, iterate: Iterate, costates: Array, zetas: Array) -> Array:
    """H = L + mu . f + zeta . Phi at (y_tau, mu_{1 - tau}, u) of every step, eq. (11) and Appendix B.

    In (q, v) and its duals mu . f is c_q . v + mu_p . M a; for constant M that is mu_q . v + mu_p . dp/dt.
    The momentum row's multiplier is mu_p at 1 - tau; c_q is the boundary dual before the step and the
    kinematic row's multiplier after it, before the constraint at the node acts on it.
    """
    robot, nq, nv, tau = problem.robot, problem.robot.nq, problem.robot.nv, TAU[problem.scheme]
    qs, vs = iterate.xs[:, :nq], iterate.xs[:, nq:]
    q_taus, v_taus = evaluation_points(robot, problem.scheme, qs, vs, problem.dt)
    duals = tau * costates[:-1, :nv] + (1.0 - tau) * iterate.ms[:, :nv]
    inertial = _momenta(robot, q_taus, np.diff(vs, axis=0) / problem.dt)
    hamiltonians: Array = (
        _running_cost(problem, q_taus, v_taus, iterate.us)
        + np.einsum("ni,ni->n", duals, v_taus)
        + np.einsum("ni,ni->n", iterate.ms[:, nv : 2 * nv], inertial)
    )
    if robot.nc:
        residuals = np.array([robot.constraint_residual(q) for q in qs[1:]])
        hamiltonians += np.einsum("ni,ni->n", zetas, residuals)
    return hamiltonians


def _weighed(problem: Problem) -> Array | None:
    """Components of (q, p) that the running cost looks at; one on velocities counts as one on momenta."""
    cost, nv = problem.cost, problem.robot.nv
    weights: Array = cost.tracking * np.asarray(cost.tracking_weights)
    weights = weights + np.concatenate([np.zeros(nv), cost.velocity])
    return weights if weights.any() else None


def _momenta(robot: Robot, qs: Array, vs: Array) -> Array:
    """M(q) v of each row, once a solve on Pinocchio's own algorithm."""
    return np.array([robot.mass_matrix(q) @ v for q, v in zip(qs, vs, strict=True)])


def _running_cost(problem: Problem, qs: Array, vs: Array, us: Array) -> Array:
    """Eq. (8) of every step, at the states at which it is evaluated."""
    cost, robot, N = problem.cost, problem.robot, problem.num_steps
    values: Array = 0.5 * np.einsum("ni,ni->n", cost.effort * us, us)
    values = values + 0.5 * np.einsum("ni,i,ni->n", vs, cost.velocity, vs)
    if cost.tracking:
        weights = cost.tracking * np.asarray(cost.tracking_weights)
        target_q = np.broadcast_to(cost.target_q, (N, robot.nq))
        target_p = np.broadcast_to(cost.target_p, (N, robot.nv))
        error_q = np.array([robot.difference(d, q) for d, q in zip(target_q, qs, strict=True)])
        errors = np.hstack([error_q, _momenta(robot, qs, vs) - target_p])
        values = values + 0.5 * np.einsum("ni,i,ni->n", errors, weights, errors)
    return values


def _adjoints(problem: Problem, iterate: Iterate, costates: Array) -> Array:
    """mu_0 ... mu_N: for SE1 the multipliers of the steps' rows (Box 1), else the boundary duals in (q, p).

    For a constant mass matrix both are the adjoint of Box 1 and of Appendix B.
    """
    robot, nq, nv = problem.robot, problem.robot.nq, problem.robot.nv
    if problem.scheme == "se1":
        end = dual_of_momentum(robot, iterate.xs[-1, :nq], iterate.xs[-1, nq:], costates[-1])
        return np.vstack([iterate.ms[:, : 2 * nv], end])
    rows = [dual_of_momentum(robot, x[:nq], x[nq:], c) for x, c in zip(iterate.xs, costates, strict=True)]
    return np.array(rows)

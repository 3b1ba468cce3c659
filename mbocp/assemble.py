"""From a solver's iterate to trajectories in the paper's scaling, and what they prove about themselves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.problem import Problem
from mbocp.solution.diagnostics import constraint_violation, control_momenta
from mbocp.solvers import Iterate
from mbocp.transcription import StagewiseProgramme
from mbocp.transcription.goal import end_condition_rows

__all__ = ["Trajectory", "assemble"]


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
    ps, inertial = _momenta(problem, qs, vs)
    lams, zetas = iterate.ys / dt, iterate.ms[:, 2 * nv :] / dt**2
    mus = np.vstack([iterate.ms[:, : 2 * nv], _final_adjoint(problem, qs[-1], vs[-1], ps[-1], iterate.eta)])
    momenta, names = control_momenta(robot, qs, vs, mus, tracked=_weighed(problem))
    # Eq. (11): H = L + mu . f + zeta . Phi, with f_p = M a, which is the rate of p for constant M.
    hamiltonians = (
        _running_cost(problem, qs, vs, ps, iterate.us)
        + np.einsum("ni,ni->n", mus[:-1, :nv], vs[1:])
        + np.einsum("ni,ni->n", mus[:-1, nv:], inertial)
    )
    if robot.nc:
        hamiltonians += np.einsum("ni,ni->n", zetas, np.array([robot.constraint_residual(q) for q in qs[1:]]))
    return Trajectory(
        t=np.arange(N + 1, dtype=np.float64) * dt,
        qs=qs,
        vs=vs,
        ps=ps,
        us=iterate.us,
        lams=lams,
        mus=mus,
        zetas=zetas,
        eta=iterate.eta,
        control_hamiltonians=hamiltonians,
        control_momenta=momenta,
        control_momentum_names=names,
        constraint_violation=constraint_violation(robot, qs, vs).position,
    )


def _weighed(problem: Problem) -> Array | None:
    """Components of (q, p) that the running cost looks at; one on velocities counts as one on momenta."""
    cost, nv = problem.cost, problem.robot.nv
    weights: Array = cost.tracking * np.asarray(cost.tracking_weights)
    weights = weights + np.concatenate([np.zeros(nv), cost.velocity])
    return weights if weights.any() else None


def _momenta(problem: Problem, qs: Array, vs: Array) -> tuple[Array, Array]:
    """p_n = M(q_n) v_n at all nodes, and M(q_n) (v_n - v_{n-1}) / dt of all steps."""
    model = problem.robot.model
    data = model.createData()
    ps, inertial = np.empty_like(vs), np.empty_like(vs[1:])
    for n, (q, v) in enumerate(zip(qs, vs, strict=True)):  # once a solve, on Pinocchio's own algorithm
        upper = np.triu(pin.crba(model, data, q))
        M = upper + np.triu(upper, 1).T
        ps[n] = M @ v
        if n:
            inertial[n - 1] = M @ (v - vs[n - 1]) / problem.dt
    return ps, inertial


def _running_cost(problem: Problem, qs: Array, vs: Array, ps: Array, us: Array) -> Array:
    """Eq. (8) at every step."""
    cost, robot, N = problem.cost, problem.robot, problem.num_steps
    values: Array = 0.5 * np.einsum("ni,ni->n", cost.effort * us, us)
    values = values + 0.5 * np.einsum("ni,i,ni->n", vs[1:], cost.velocity, vs[1:])
    if cost.tracking:
        weights = cost.tracking * np.asarray(cost.tracking_weights)
        target_q = np.broadcast_to(cost.target_q, (N, robot.nq))
        target_p = np.broadcast_to(cost.target_p, (N, robot.nv))
        error_q = np.array([robot.difference(d, q) for d, q in zip(target_q, qs[1:], strict=True)])
        errors = np.hstack([error_q, ps[1:] - target_p])
        values = values + 0.5 * np.einsum("ni,i,ni->n", errors, weights, errors)
    return values


def _final_adjoint(problem: Problem, q: Array, v: Array, p: Array, eta: Array) -> Array:
    """Transversality condition of Box 1: mu_N = grad psi + grad g_T' eta with respect to (q, p)."""
    robot, goal = problem.robot, problem.goal
    D_q, D_rate = end_condition_rows(robot, goal)
    dual_q, dual_rate = D_q.T @ eta[: D_q.shape[0]], D_rate.T @ eta[D_q.shape[0] :]
    if goal.is_penalised:
        rate = p if goal.rate == "p" else v
        weights = problem.cost.terminal * np.asarray(problem.cost.terminal_weights)
        dual_q = dual_q + weights[: robot.nv] * robot.difference(goal.q, q)
        dual_rate = dual_rate + weights[robot.nv :] * (rate - goal.value)
    along_q = pin.dDifference(robot.model, goal.q, q, pin.ArgumentPosition.ARG1).T @ dual_q
    if goal.rate == "v":
        dual_rate = np.linalg.solve(robot.mass_matrix(q), dual_rate)
    return np.concatenate([along_q, dual_rate])

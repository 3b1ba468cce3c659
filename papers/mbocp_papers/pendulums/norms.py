r"""Newton's history in the unknowns and the scaling of the paper's tables.

mbocp solves neither for :math:`\mu_N`, which follows from the end condition, nor for a control
:math:`u_N` after the last step, and measures the rows of eqs. (24) and (26) as they are printed. The
paper's unknowns hold both (its DOF column counts them), with :math:`\nabla_u \mathcal{H} = 0` at the end
for :math:`u_N`. With these two, and state and adjoint rows of :math:`r_w` divided by the step length, the
first iteration of Table 1 is met to all digits for both solvers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation import formulate
from mbocp.formulation.end_rows import end_condition_rows
from mbocp.guesses import guess_candidates, make_guess
from mbocp.problem import Problem
from mbocp.programme import StagewiseProgramme
from mbocp.solvers import Iterate, SolverSettings, Status, make_solver, run


@dataclass(frozen=True)
class Norms:
    """Euclidean norms after an iteration: of the change of w or omega, and of r_w or r_u."""

    iteration: int
    increment: float
    residual: float


@dataclass(frozen=True)
class History:
    """What became of a strategy.

    Attributes
    ----------
    status : Status
    iterations : tuple of int
        Of each phase.
    cost : float
    norms : tuple of Norms
        Of the Newton phase.
    """

    status: Status
    iterations: tuple[int, ...]
    cost: float
    norms: tuple[Norms, ...]


@dataclass(frozen=True)
class _Values:
    """An iterate in the paper's quantities, for robots that slide: q in a vector space, constant mass."""

    qs: Array
    ps: Array
    lams: Array
    mus: Array
    zetas: Array
    eta: Array
    us: Array

    @classmethod
    def of(cls, problem: Problem, programme: StagewiseProgramme, native: Any) -> _Values:
        robot, dt = problem.robot, programme.dt
        iterate = Iterate.read_from(native, programme)
        qs = iterate.xs[:, : robot.nq]
        ps = iterate.xs[:, robot.nq :] @ robot.mass_matrix(problem.q_start)
        last = _final_adjoint(problem, qs[-1], ps[-1], iterate.eta)
        return cls(
            qs=qs,
            ps=ps,
            lams=iterate.ys / dt,
            mus=np.vstack([iterate.ms[:, : 2 * robot.nv], last]),
            zetas=iterate.ms[:, 2 * robot.nv :] / dt**2,
            eta=iterate.eta,
            us=iterate.us,
        )


def newton_history(problem: Problem) -> History:
    """Solve with one of the paper's four strategies, and take the paper's norms after each Newton step.

    In the staggered solver with a penalised end u_N is left out. The norms of the monolithic solver are exact
    for robots whose mass matrix is the identity; otherwise the adjoint rows of the momentum are still
    multiplied by M, as mbocp has velocities for unknowns.
    """
    formulation = formulate(problem)
    programme = formulation.programme
    iterate, _ = make_guess(guess_candidates(problem)[0], formulation)
    *first, last = problem.solver.method.split("+")
    settings = SolverSettings.of(problem.solver, programme)
    counts = []
    for name in first:
        result = run(make_solver(name, settings, settings.switch), programme, iterate)
        iterate = result.iterate
        counts.append(result.history[-1].iteration)
    solver = make_solver(last, settings)
    history = _steps(problem, programme, solver, iterate, is_staggered=last == "fbsm_newton")
    return replace(history, iterations=(*counts, *history.iterations))


def _steps(
    problem: Problem, programme: StagewiseProgramme, solver: Any, iterate: Iterate, *, is_staggered: bool
) -> History:
    state = solver.init(programme, iterate)
    values = _Values.of(problem, programme, state.native)
    # Between sweeps a penalised end makes mu_N nonlinear in the controls: then u_N cannot be followed.
    is_followed = not (is_staggered and problem.goal.is_penalised)
    u_last, wanted = values.us[-1], _last_control(problem, values)
    before, norms = _unknowns(values, u_last if is_followed else None, is_staggered), []
    while (status := solver.terminate(state)) is None:
        state = solver.step(state)
        if state.failure is not None:
            continue  # `terminate` says so
        values = _Values.of(problem, programme, state.native)
        target = _last_control(problem, values)
        # The row of u_N is linear in u_N and mu_N: a share of the step leaves the rest of its residual.
        u_last = u_last + state.step_length * (wanted - u_last) + (target - wanted)
        after, wanted = _unknowns(values, u_last if is_followed else None, is_staggered), target
        residual = state.evaluation.residual
        if not is_staggered:
            residual = _paper_residual(problem, values, residual)
        norms.append(Norms(state.iteration, float(np.linalg.norm(after - before)), residual))
        before = after
    return History(status, (state.iteration,), state.evaluation.cost, tuple(norms))


def _final_adjoint(problem: Problem, q: Array, p: Array, eta: Array) -> Array:
    """mu_N of Box 1."""
    D, error = _end(problem, q, p)
    mu: Array = D.T @ eta
    if problem.goal.is_penalised:
        mu = mu + problem.cost.terminal * np.asarray(problem.cost.terminal_weights) * error
    return mu


def _end(problem: Problem, q: Array, p: Array) -> tuple[Array, Array]:
    """D of eq. (14), and y_N - y_d; the paper's goals are on momenta."""
    rows = end_condition_rows(problem.robot, problem.goal)
    D_q, D_p = rows.D_q, rows.D_rate
    D = np.zeros((len(D_q) + len(D_p), 2 * problem.robot.nv))
    D[: len(D_q), : problem.robot.nv], D[len(D_q) :, problem.robot.nv :] = D_q, D_p
    return D, np.concatenate([q - problem.goal.q, p - problem.goal.value])


def _last_control(problem: Problem, values: _Values) -> Array:
    """u_N that satisfies grad_u H = 0 with mu_N."""
    B = problem.robot.actuation_matrix(values.qs[-1])
    u: Array = -B.T @ values.mus[-1, problem.robot.nv :] / problem.cost.effort
    return u


def _unknowns(values: _Values, u_last: Array | None, is_staggered: bool) -> Array:
    """Stack omega = (eta, u), section 5.2, or w = (mu, zeta, y, lambda, eta, u), section 5.1."""
    parts = [values.eta, values.us]
    if u_last is not None:
        parts.append(u_last)
    if not is_staggered:
        parts += [values.mus, values.zetas, values.qs[1:], values.ps[1:], values.lams]
    return np.concatenate([part.ravel() for part in parts])


def _paper_residual(problem: Problem, values: _Values, residual: float) -> float:
    """Divide the part of the residual that stems from state and adjoint rows, eqs. (24), (26), by dt."""
    robot, inner = problem.robot, values.qs[1:]
    mu_p = values.mus[:-1, robot.nv :]
    rows = [problem.cost.effort * values.us + mu_p @ robot.actuation_matrix(inner[0])]  # eq. (28), constant B
    if robot.nc:
        rows.append(np.array([robot.constraint_residual(q) for q in inner]))  # eq. (25)
        rows += [robot.constraint_jacobian(q) @ m for q, m in zip(inner, mu_p, strict=True)]  # eq. (27)
    if problem.goal.is_exact:
        D, error = _end(problem, inner[-1], values.ps[-1])
        rows.append(D @ error)
    undivided = sum(float(np.sum(row**2)) for row in rows)
    divided = max(residual**2 - undivided, 0.0) / problem.dt**2
    return float(np.sqrt(undivided + divided))

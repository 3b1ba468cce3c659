r"""A rival of the same order: CasADi and IPOPT with collocation at Gauss's points, compiled.

Written from `mbocp.symbolic` by way of the mechanics, without mbocp's steps. Unknowns are the states of nodes
and stages, accelerations (and multipliers of loops) of the stages, and controls, one for a step or one for
each stage:

.. math::
    x_{ni} = x_n + h \sum_j a_{ij} \dot x_{nj}, \quad x_{n+1} = x_n + h \sum_j b_j \dot x_{nj}, \quad
    M \dot v + C v + g = B u - \Phi_q^T \lambda, \quad \ddot\Phi = 0.

Inverse dynamics at each stage: the form with the fewest operations. The functions of the nonlinear programme
and their exact derivatives are compiled by CasADi, as loops over the steps.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import null_space

import mbocp
from mbocp.formulation import Motion
from mbocp.integrators import PAIRS
from mbocp.mechanics import JointMechanics

__all__ = ["Collocation", "Found"]

_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-9, "max_iter": 300},
}
_PARTS = ("f", "g", "grad_f", "jac_g", "hess_l")  # of CasADi's statistics
_COMPILED: dict[str, Any] = {
    "jit": True,
    "compiler": "shell",
    "jit_options": {"flags": ["-O1"], "verbose": False},
}


@dataclass(frozen=True)
class Found:
    """What IPOPT came to; `functions`: what of the time was the functions' [s]."""

    seconds: float
    functions: float
    iterations: int
    cost: float
    qs: Any
    vs: Any
    converged: bool


class Collocation:
    """The nonlinear programme of a problem with effort and velocity costs, and exact ends.

    Parameters
    ----------
    problem : Problem
        Without limits and path constraints.
    num_stages : int
        Two or three: order four or six.
    at_stages : bool
        Whether each stage has controls of its own.
    is_compiled : bool
    limit : float
        After which IPOPT gives up [s].
    """

    def __init__(
        self,
        problem: mbocp.Problem,
        num_stages: int,
        *,
        at_stages: bool,
        is_compiled: bool = True,
        limit: float = 1e3,
    ) -> None:
        self._problem, self._s, self._at_stages = problem, num_stages, at_stages
        self._mechanics = JointMechanics(problem.robot)
        robot, N = problem.robot, problem.num_steps
        self._nx = robot.nq + robot.nv
        self._nk = self._nx + robot.nv + robot.nc + (robot.nu if at_stages else 0)
        self._nw = self._s * self._nk + (0 if at_stages else robot.nu)
        step = self._step()
        unknowns = ca.MX.sym("unknowns", N * (self._nw + self._nx))
        W, X = ca.vertsplit(ca.reshape(unknowns, -1, N), [0, self._nw, self._nw + self._nx])
        start = ca.DM(np.append(problem.q_start, problem.v_start))
        rows, cost = step.map(N)(ca.horzcat(start, X[:, :-1]), X, W)
        g = ca.vertcat(ca.vec(rows), self._end()(X[:, -1]))
        nlp = {"x": unknowns, "f": ca.sum2(cost), "g": g}
        how = {**_OPTIONS, "ipopt": {**_OPTIONS["ipopt"], "max_wall_time": limit}}
        self._solver = ca.nlpsol("collocation", "ipopt", nlp, how | (_COMPILED if is_compiled else {}))

    def solve(self, begin: Motion) -> Found:
        """Solve from a motion with as many steps.

        Parameters
        ----------
        begin : Motion
            Its states and controls are the guess.
        """
        robot, s = self._problem.robot, self._s
        states, none = np.hstack([begin.qs, begin.vs]), np.zeros(robot.nc)
        guess = []
        for n, (u, dt) in enumerate(zip(begin.us, begin.dts, strict=True)):
            own = [states[n], (begin.vs[n + 1] - begin.vs[n]) / dt, none]
            stages = np.concatenate([*own, *([u] if self._at_stages else [])] * s)
            guess += [stages, *([] if self._at_stages else [u]), states[n + 1]]
        clock = time.perf_counter()
        found = self._solver(x0=np.concatenate(guess), lbg=0.0, ubg=0.0)
        seconds = time.perf_counter() - clock
        stats = self._solver.stats()
        w = np.asarray(found["x"]).reshape(len(begin.us), -1)[:, self._nw :]
        xs = np.vstack([states[:1], w])
        return Found(
            seconds,
            sum(stats.get(f"t_wall_nlp_{name}", 0.0) for name in _PARTS),
            stats["iter_count"],
            float(found["f"]),
            xs[:, : robot.nq],
            xs[:, robot.nq :],
            bool(stats["success"]),
        )

    def _step(self) -> ca.Function:
        """(x0, x1, w) -> rows, cost."""
        problem, m, s = self._problem, self._mechanics, self._s
        robot, nq, nv = problem.robot, m.nq, m.nv
        pair, h = PAIRS[f"gauss{s}"], problem.duration / problem.num_steps
        x0, x1, w = ca.SX.sym("x0", self._nx), ca.SX.sym("x1", self._nx), ca.SX.sym("w", self._nw)
        parts = [w[i * self._nk : (i + 1) * self._nk] for i in range(s)]
        slopes, rows, cost = [], [], ca.SX(0)
        for part, b in zip(parts, pair.b, strict=True):
            q, v = part[:nq], part[nq : nq + nv]
            a, lam = part[self._nx : self._nx + nv], part[self._nx + nv : self._nx + nv + m.nc]
            u = part[self._nk - robot.nu :] if self._at_stages else w[self._nw - robot.nu :]
            balance = m.inverse_dynamics(q, v, a) - m.force(q, v, u)
            if m.nc:
                jacobian = m.constraint_jacobian(q)
                rate = jacobian @ v
                balance += jacobian.T @ lam
                rows.append(jacobian @ a + ca.jtimes(rate, q, m.space.rate(q, v)))
            rows.append(balance)
            slopes.append(ca.vertcat(m.space.rate(q, v), a))
            cost += h * b * self._running(v, u)
        for part, row in zip(parts, pair.a, strict=True):
            rows.append(x0 + h * sum(a * k for a, k in zip(row, slopes, strict=True)) - part[: self._nx])
        rows.append(x0 + h * sum(b * k for b, k in zip(pair.b, slopes, strict=True)) - x1)
        return ca.Function("step", [x0, x1, w], [ca.vertcat(*rows), cost])

    def _running(self, v: ca.SX, u: ca.SX) -> ca.SX:
        cost = self._problem.cost
        effort = np.broadcast_to(cost.effort, u.numel())
        velocity = np.broadcast_to(cost.velocity, v.numel())
        return (ca.dot(ca.DM(effort), u**2) + ca.dot(ca.DM(velocity), v**2)) / 2

    def _end(self) -> ca.Function:
        """What vanishes at the end: along the constraints where there are some."""
        problem, m = self._problem, self._mechanics
        x, goal = ca.SX.sym("x", self._nx), problem.goal
        basis = np.eye(m.nv)
        if m.nc:
            basis = null_space(problem.robot.constraint_jacobian(goal.q))
        turned = m.end_difference(ca.SX(ca.DM(goal.q)), x[: m.nq])
        speed = x[m.nq :] - ca.DM(np.asarray(goal.value))
        rows = [ca.DM(basis.T) @ turned, ca.DM(basis.T) @ speed]
        return ca.Function("end", [x], [ca.vertcat(*rows)])

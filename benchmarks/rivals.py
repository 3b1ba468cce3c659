"""The same programme through CasADi and IPOPT, in the same run: wall time to the solution, and the cost.

Scheme SE1 and the cost are written again, from `mbocp.symbolic` alone, so that equal costs also prove the
transcription. IPOPT gets exact derivatives, the same initial guess and a tolerance of the same size; its
functions run in CasADi's virtual machine, as they do for everybody who installs the casadi wheel.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from statistics import median
from typing import Any

import casadi as ca
import numpy as np

import mbocp
from benchmarks.newton import newton, warm_guess
from benchmarks.tables import Table
from mbocp.solvers import run
from mbocp.symbolic import model_functions

__all__ = ["Comparison", "compare", "reach", "rival_table"]

_OPTIONS = {
    "print_time": False,
    "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-9, "max_iter": 500},
}


@dataclass(frozen=True)
class Comparison:
    """Medians, in seconds; `functions` is IPOPT's time in CasADi's functions."""

    own: float
    own_iterations: int
    own_cost: float
    rival: float
    rival_iterations: int
    rival_cost: float
    functions: float

    @property
    def ratio(self) -> float:
        return self.rival / self.own

    @property
    def difference(self) -> float:
        return abs(self.own_cost - self.rival_cost) / abs(self.own_cost)


def reach(num_steps: int = 100) -> mbocp.Problem:
    """UR5 from one side to the other, rest to rest, with a weight on velocities."""
    return mbocp.Problem.create(
        "ur5",
        1.5,
        num_steps,
        start={"q": [-1.2, -2.2, 1.8, -1.2, -1.5, 0.3]},
        goal={"q": [1.4, -0.6, -1.2, 0.8, 1.3, -1.6], "v": [0.0] * 6, "enforce": "exact"},
        cost={"effort": 1.0, "velocity": 10.0},
        name="ur5",
        scheme="se1",
    )


def compare(problem: mbocp.Problem, repetitions: int) -> Comparison:
    """Solve with both, in turn."""
    programme, guess = warm_guess(problem)
    solver = newton(problem, programme)
    rival, arguments = _nonlinear_programme(problem, guess.xs, guess.us)
    own_times, rival_times, function_times = [], [], []
    for _ in range(repetitions):
        clock = time.perf_counter()
        own = run(solver, programme, guess)
        own_times.append(time.perf_counter() - clock)
        clock = time.perf_counter()
        found = rival(**arguments)
        rival_times.append(time.perf_counter() - clock)
        stats = rival.stats()
        function_times.append(sum(v for k, v in stats.items() if k.startswith("t_wall_nlp_")))
    if not (own.status == "converged" and stats["success"]):
        raise RuntimeError(f"not both converged: mbocp {own.status}, IPOPT {stats['return_status']}")
    return Comparison(
        own=median(own_times),
        own_iterations=own.history[-1].iteration,
        own_cost=own.history[-1].cost,
        rival=median(rival_times),
        rival_iterations=stats["iter_count"],
        rival_cost=float(found["f"]),
        functions=median(function_times),
    )


def _nonlinear_programme(problem: mbocp.Problem, xs: Any, us: Any) -> tuple[ca.Function, dict[str, Any]]:
    """Scheme SE1, all torques, rest to rest: for a fixed-base arm whose configuration is a plain vector."""
    robot, cost, N, dt = problem.robot, problem.cost, problem.num_steps, problem.dt
    nv = robot.nv
    rnea = model_functions(robot.model).rnea
    x0, x1, u = ca.SX.sym("x0", 2 * nv), ca.SX.sym("x1", 2 * nv), ca.SX.sym("u", nv)
    q1, v1 = x1[:nv], x1[nv:]
    torque = rnea(q1, v1, (v1 - x0[nv:]) / dt)
    rows = ca.vertcat(x0[:nv] + dt * v1 - q1, dt * (u - torque))
    running = (
        dt
        / 2
        * (ca.dot(ca.DM(np.asarray(cost.effort)) * u, u) + ca.dot(ca.DM(np.asarray(cost.velocity)) * v1, v1))
    )
    step = ca.Function("step", [x0, x1, u], [rows, running])

    # Stage after stage: node n, control of the step to it. One flat graph of scalars takes seconds to set up,
    # but its derivatives are four times faster than those of an MX graph with the step mapped over it.
    w = ca.SX.sym("w", 3 * nv * N)
    X, U = ca.vertsplit(ca.reshape(w, 3 * nv, N), [0, 2 * nv, 3 * nv])
    start = ca.DM(np.concatenate([problem.q_start, problem.v_start]))
    before = ca.horzcat(start, X[:, :-1])
    rows, running = step.map(N)(before, X, U)
    end = X[:, -1] - ca.DM(np.concatenate([problem.goal.q, problem.goal.value]))
    nlp = {"x": w, "f": ca.sum2(running), "g": ca.vertcat(ca.vec(rows), end)}
    guess = np.hstack([xs[1:], us]).ravel()
    return ca.nlpsol("rival", "ipopt", nlp, _OPTIONS), {"x0": guess, "lbg": 0.0, "ubg": 0.0}


def rival_table(repetitions: int = 7) -> Table:
    """Side by side."""
    problem = reach()
    c = compare(problem, repetitions)
    rows = [
        ("mbocp", f"{1e3 * c.own:.1f}", str(c.own_iterations), f"{c.own_cost:.9f}", "1"),
        (
            "CasADi + IPOPT (MUMPS), interpreted",
            f"{1e3 * c.rival:.1f}",
            str(c.rival_iterations),
            f"{c.rival_cost:.9f}",
            f"{c.ratio:.1f}",
        ),
    ]
    share = c.functions / c.rival
    note = (
        f"Costs differ by {c.difference:.1e} (relative). IPOPT spends {100 * share:.0f} % of its time in "
        "CasADi's functions, the rest in itself and MUMPS. Same guess, tolerance 1e-9 for both, setting up "
        "not counted."
    )
    columns = ("UR5, N = 100, cost.velocity = 10", "wall [ms]", "iterations", "cost", "ratio")
    return Table("A whole solve side by side", columns, rows, note)

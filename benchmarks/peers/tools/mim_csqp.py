"""mim_solvers: CSQP, sequential quadratic programs by ADMM, with hard end conditions and limits."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mim_solvers

from benchmarks.peers.task import Task
from benchmarks.peers.tools.runs import NotSolved, Run, timed
from benchmarks.peers.tools.shooting import check_dynamics, shooting_problem, start_of, trajectory

_MOST = 1000
_SECONDS = 20.0  # of a solve
_TOLERANCES = {"hard": (1e-6, 1e-8), "soft": (1e-4, 1e-6)}  # of KKT conditions and quadratic programs


def run(task: Task, method: str, repeats: int) -> Run:
    """`method`: "hard" for the end as a constraint, "soft" for a penalty, as Crocoddyl has it."""
    check_dynamics(task)
    is_hard = method == "hard"
    if task.is_limited and not is_hard:
        raise NotSolved("limits with a hard end alone")
    problem = shooting_problem(task, hard_end=is_hard)
    xs, us = start_of(task, problem)

    def solve() -> tuple[Any, bool]:
        solver = mim_solvers.SolverCSQP(problem)
        solver.termination_tolerance, solver.eps_abs = _TOLERANCES[method]
        solver.eps_rel = 0.0
        solver.max_qp_iters = 1000
        solver.max_solve_time = _SECONDS
        solver.use_filter_line_search = True
        return solver, solver.solve(xs, us, _MOST, False)

    (solver, is_done), seconds = timed(solve, repeats)
    found = trajectory(task, solver, seconds)
    return found if is_done else replace(found, remark="its own criterion is not met")

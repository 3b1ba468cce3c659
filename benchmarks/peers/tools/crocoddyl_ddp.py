"""Crocoddyl: FDDP, its box for limits of controls, and Intro with inverse dynamics."""

from __future__ import annotations

from typing import Any

import crocoddyl

from benchmarks.peers.task import Task
from benchmarks.peers.tools.runs import NotSolved, Run, timed
from benchmarks.peers.tools.shooting import check_dynamics, shooting_problem, start_of, trajectory

_MOST = 1000
_STOP = 1e-9


def run(task: Task, method: str, repeats: int) -> Run:
    """`method`: "fddp", "box" or "intro"."""
    check_dynamics(task)
    inverse = method == "intro"
    if task.is_limited != (method == "box"):
        raise NotSolved("takes no limits" if task.is_limited else "without limits FDDP")
    if inverse and not task.is_arm:
        raise NotSolved("needs a motor on every joint")
    problem = shooting_problem(task, inverse=inverse)
    xs, us = start_of(task, problem, inverse=inverse)
    kind = {"fddp": "SolverFDDP", "box": "SolverBoxFDDP", "intro": "SolverIntro"}[method]

    def solve() -> tuple[Any, bool]:
        solver = getattr(crocoddyl, kind)(problem)
        solver.th_stop = _STOP
        return solver, solver.solve(xs, us, _MOST, False)

    (solver, is_done), seconds = timed(solve, repeats)
    found = trajectory(task, solver, seconds, inverse=inverse)
    if not is_done and found.iterations >= _MOST - 1:
        raise NotSolved(f"no end in {_MOST} iterations, after {1e3 * min(seconds):.0f} ms")
    return found

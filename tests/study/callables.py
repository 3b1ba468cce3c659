"""Solvers that misbehave, for studies that must survive them; workers import them by name."""

from __future__ import annotations

import ctypes
import os
import signal
import time

import mbocp
from mbocp.problem import Problem
from mbocp.solution import Solution


def wanted(problem: Problem) -> int:
    """What the task asks for: tests write it into the number of iterations."""
    return problem.solver.max_iterations or 0


def sometimes_bad(problem: Problem) -> Solution:
    kind = wanted(problem)
    if kind == 101:
        raise RuntimeError("no luck today")
    if kind == 102:
        os.kill(os.getpid(), signal.SIGKILL)
    if kind == 103:
        ctypes.string_at(0)  # a segmentation fault
    if kind == 104:
        time.sleep(600.0)
    if kind == 105:
        os._exit(3)
    return mbocp.solve(problem)


def threads(problem: Problem) -> Solution:
    """Solve, if this process has one thread for numerics."""
    assert os.environ["OMP_NUM_THREADS"] == "1"
    assert os.environ["MBOCP_TEST_WORD"] == "hello"
    return mbocp.solve(problem)

"""Solvers that misbehave, for studies that must survive them; workers import them by name."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import time
from pathlib import Path

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


def short_of_memory(problem: Problem) -> Solution:
    """Solve tasks of many steps with 100 MB to spare, as in a batch queue; 106: nobody looks before."""
    if wanted(problem) not in (106, 107):
        return mbocp.solve(problem)
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (held + 10**8, before[1]))
    if wanted(problem) == 106:
        os.environ["MBOCP_MEMORY_LIMIT"] = "1e6"
    try:
        return mbocp.solve(problem.with_(num_steps=100_000))
    finally:
        os.environ.pop("MBOCP_MEMORY_LIMIT", None)
        resource.setrlimit(resource.RLIMIT_AS, before)

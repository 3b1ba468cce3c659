"""`python -m benchmarks.many`: many goals of one robot, by `solve_many` and by a loop, in one run."""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

import mbocp
from benchmarks.machine import header
from benchmarks.newton import EXAMPLES
from benchmarks.tables import Table, show
from mbocp._arrays import Array

__all__ = ["CASES", "Case", "table"]

_SPREAD = 0.4  # [rad] of goals about that of the example, either way
_ROUNDS = 3  # of which the least time counts


@dataclass(frozen=True)
class Case:
    """An example, and how many goals of it."""

    file: str
    count: int
    settings: tuple[str, ...] = ("horizon.steps=100",)


CASES = (
    Case("arms/ur5_reach.toml", 400),
    Case("arms/ur5_limits.toml", 200, ("horizon.steps=100", "horizon.duration=4")),
    Case("arms/panda_reach.toml", 200),
    Case("free_flyer/drone_flip.toml", 200),
)


def table(cases: Sequence[Case] = CASES) -> Table:
    """One row a case."""
    rows = [_row(case) for case in cases]
    columns = ("problem", "goals", "converged", "iterations", "loop [ms]")
    return Table(
        "Many goals",
        (*columns, "one core [ms]", "loop by that", "all cores [ms]", "loop by that", "costs differ by"),
        rows,
        f"Milliseconds a goal, the least of {_ROUNDS} rounds. Horizons of 100 steps, goals at random. The "
        "loop runs on one core, as the batch does in the first of its two columns.",
    )


def _row(case: Case) -> tuple[str, ...]:
    problem = mbocp.load_problem(EXAMPLES / case.file, case.settings)
    rng, robot = np.random.default_rng(0), problem.robot
    moves = rng.uniform(-_SPREAD, _SPREAD, (case.count, robot.nv))
    goals = np.array([robot.integrate(problem.goal.q, move) for move in moves])
    mbocp.solve_many(problem, goals=goals[:4])  # compiles
    all_cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(all_cores)})
    try:
        alone, costs = _loop(problem, goals)
        one, motions = _batch(problem, goals, 1)
    finally:
        os.sched_setaffinity(0, all_cores)
    several, _ = _batch(problem, goals, len(all_cores))
    solved = motions.converged
    off = float(np.max(np.abs(motions.costs - costs)[solved] / np.abs(costs[solved])))
    return (
        case.file.removesuffix(".toml"),
        str(case.count),
        str(int(solved.sum())),
        f"{motions.iterations.mean():.1f}",
        *(f"{1e3 * alone:.2f}", f"{1e3 * one:.2f}", f"{alone / one:.2f}"),
        *(f"{1e3 * several:.2f}", f"{alone / several:.2f}", f"{off:.0e}"),
    )


def _loop(problem: mbocp.Problem, goals: Array) -> tuple[float, Array]:
    """Time a goal of a loop of solves, and what the motions cost."""
    seconds, costs = [], np.zeros(len(goals))
    for _ in range(_ROUNDS):
        clock = time.perf_counter()
        for k, goal in enumerate(goals):
            costs[k] = mbocp.solve(problem.with_(goal={"q": goal})).cost
        seconds.append((time.perf_counter() - clock) / len(goals))
    return min(seconds), costs


def _batch(problem: mbocp.Problem, goals: Array, threads: int) -> tuple[float, mbocp.Motions]:
    """Time a goal of a batch, and the batch."""
    seconds = []
    for _ in range(_ROUNDS):
        clock = time.perf_counter()
        motions = mbocp.solve_many(problem, goals=goals, threads=threads)
        seconds.append((time.perf_counter() - clock) / len(goals))
    return min(seconds), motions


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.many", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    show(header(), markdown=options.markdown)
    show(table(), markdown=options.markdown)


if __name__ == "__main__":
    main()

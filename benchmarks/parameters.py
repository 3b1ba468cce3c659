"""Numbers of robots found with the motion: `python -m benchmarks.parameters`.

CPU time of an iteration with parameters and without, over the steps: both are linear in their number, and a
parameter is one more entry of states and controls. Then designs beside a search over plain solves.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.newton import exponent
from benchmarks.tables import Table, show
from tests.formulation.test_found_numbers import search

EXAMPLES = Path(__file__).parents[1] / "examples" / "design"
DESIGNS = {"counterweight": {}, "base_placement": {}, "gear_ratio": {"horizon.steps": 12}}

T = TypeVar("T")


def timed(work: Callable[[], T]) -> tuple[T, float]:
    """Return what some work gives, and its CPU time [s]."""
    begun = time.process_time()
    return work(), time.process_time() - begun


def seconds_an_iteration(problem: mbocp.Problem, repeats: int) -> float:
    """Return the least time of a solve, by its iterations [s]."""
    runs = [timed(partial(mbocp.solve, problem)) for _ in range(repeats)]
    return min(seconds / solution.iterations for solution, seconds in runs)


def growth(steps: list[int], repeats: int) -> Table:
    rows, times = [], np.zeros((len(steps), 2))
    for k, number in enumerate(steps):
        problem = mbocp.load_problem(EXAMPLES / "counterweight.toml", {"horizon.steps": number})
        times[k] = [seconds_an_iteration(p, repeats) for p in (problem, problem.with_(parameter=[]))]
        rows.append((f"{number}", *(f"{1e3 * seconds:.1f}" for seconds in times[k])))
    last = [f"N^{exponent(steps[-3:], column[-3:].tolist()):.2f}" for column in times.T]
    title = f"Counterweight, an iteration [ms]; of the last three {last[0]}, {last[1]}"
    return Table(title, ("steps", "with two parameters", "without"), rows)


def designs() -> Table:
    rows = []
    for name, changes in DESIGNS.items():
        problem = mbocp.load_problem(EXAMPLES / f"{name}.toml", changes)
        solution, seconds = timed(partial(mbocp.solve, problem))
        (least, where), of_search = timed(partial(search, problem))
        off = np.abs(np.array(list(solution.parameters.values())) - where).max()
        cost = f"{(solution.cost - least) / least:.1e}"
        rows.append(
            (name, f"{solution.iterations}", f"{seconds:.2f}", f"{of_search:.1f}", cost, f"{off:.1e}")
        )
    columns = (
        "design",
        "iterations",
        "solve [s]",
        "search [s]",
        "cost less that of the search",
        "parameters",
    )
    return Table(
        "Designs beside a search; costs by themselves, parameters by their largest difference", columns, rows
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, nargs="+", default=[50, 100, 200, 400, 800, 1600])
    parser.add_argument("--repeats", type=int, default=3)
    asked = parser.parse_args()
    one_core()
    show(header())
    show(growth(asked.steps, asked.repeats))
    show(designs())

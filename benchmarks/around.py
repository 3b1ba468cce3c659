"""Time in the solver and around it: python -m benchmarks.around.

A solve of a shape that this process has solved before: what the solver takes, and what programme, look-up of
compiled functions, guess and reading add. Then many tasks of one shape, one after the other in one process,
with what it keeps of them. Times are of the processor, so that others who use the machine count for less.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any
from unittest.mock import patch

import numpy as np

import mbocp
from benchmarks.machine import memory, one_core
from benchmarks.tables import Table, show
from mbocp.guesses import eased, in_turn, screening, several
from mbocp.solution.later import complete

__all__ = ["around_table", "tasks_table"]

_EXAMPLES = Path(__file__).parents[1] / "examples"
_CASES = (
    "arms/ur5_reach",
    "arms/ur5_limits",
    "arms/panda_reach",
    "arms/minimum_time",
    "arms/slalom",
    "free_flyer/drone_flip",
    "loops/four_bar",
)
_MODULES = (eased, in_turn, screening, several)  # which run solvers
_TASKS = "arms/ur5_reach"
_BEGIN = 10  # share of the tasks after which memory is looked at first: one in so many
_SPREAD = 0.3  # [rad] of goals


@dataclass
class _Times:
    """Processor times [s] of one solve."""

    solver: float = 0.0
    whole: float = 0.0
    asked: float = 0.0  # of diagnostics, where somebody asks for them
    changed: float = 0.0  # of the problem with another goal
    iterations: int = 0

    @property
    def around(self) -> float:
        return self.whole - self.solver


@contextmanager
def _watched(times: _Times) -> Iterator[None]:
    """Add what solvers take."""

    def watch(run: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any) -> Any:
            begun = time.process_time()
            try:
                return run(*arguments)
            finally:
                times.solver += time.process_time() - begun

        return timed

    with ExitStack() as stack:
        for module in _MODULES:
            stack.enter_context(patch.object(module, "run_strategy", watch(module.run_strategy)))
        yield


def _measured(problem: mbocp.Problem, goal: dict[str, Any] | None = None) -> _Times:
    times, begun = _Times(), time.process_time()
    if goal is not None:
        problem = problem.with_(goal=goal)
        times.changed = time.process_time() - begun
    begun = time.process_time()
    with _watched(times):
        solution = mbocp.solve(problem)
    times.whole = time.process_time() - begun
    times.iterations = solution.iterations
    begun = time.process_time()
    complete(solution)
    times.asked = time.process_time() - begun
    return times


def _row(times: Sequence[_Times]) -> tuple[str, ...]:
    names = ("solver", "around", "asked", "changed")
    medians = [median(getattr(t, name) for t in times) for name in names]
    share = medians[1] / medians[0]
    iterations = median(t.iterations for t in times)
    return (f"{iterations:g}", *(f"{1e3 * m:.2f}" for m in medians), f"{share:.2f}")


_COLUMNS = (
    "iterations",
    "solver [ms]",
    "around [ms]",
    "diagnostics, when asked [ms]",
    "next task [ms]",
    "around / solver",
)


def around_table(cases: Sequence[str] = _CASES, repetitions: int = 30) -> Table:
    """A row a case."""
    rows = []
    for case in cases:
        problem = mbocp.load_problem(_EXAMPLES / f"{case}.toml")
        goal = {"q": np.asarray(problem.goal.q)} if problem.goal.q_active.all() else {}
        for _ in range(2):
            _measured(problem, goal)
        rows.append((case, *_row([_measured(problem, goal) for _ in range(repetitions)])))
    return Table(
        "In the solver and around it",
        ("problem", *_COLUMNS),
        rows,
        f"Medians of {repetitions} solves after a warm one. Around: programme, look-up of functions, guess, "
        "reading. Next task: `problem.with_(goal=...)`.",
    )


def tasks_table(tasks: int = 1000, seed: int = 0) -> Table:
    """Tasks of one shape with random goals, in one process."""
    problem = mbocp.load_problem(_EXAMPLES / f"{_TASKS}.toml")
    rng, q_goal = np.random.default_rng(seed), np.asarray(problem.goal.q)
    _measured(problem)
    times, resident = list[_Times](), list[float]()
    for _ in range(tasks):
        goal = {"q": q_goal + _SPREAD * rng.uniform(-1.0, 1.0, q_goal.size)}
        times.append(_measured(problem, goal))
        resident.append(1e-6 * memory("VmRSS"))
    begin = resident[tasks // _BEGIN]
    return Table(
        f"{tasks} tasks of one shape",
        ("problem", *_COLUMNS, f"memory after {tasks // _BEGIN + 1} tasks [MB]", f"after {tasks} [MB]"),
        [(_TASKS, *_row(times), f"{begin:.1f}", f"{resident[-1]:.1f}")],
        f"Goals within {_SPREAD:g} rad of the example's. Memory: resident.",
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.around", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--repetitions", type=int, default=30)
    parser.add_argument("--tasks", type=int, default=1000)
    options = parser.parse_args(arguments)
    one_core()
    show(around_table(repetitions=options.repetitions), markdown=options.markdown)
    show(tasks_table(options.tasks), markdown=options.markdown)


if __name__ == "__main__":
    main()

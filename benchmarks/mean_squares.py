"""Random tasks with a limit of the root mean square of an effort: `python -m benchmarks.mean_squares`.

Of each task the effort with the largest root mean square is limited to a share of that. Tasks that do not
converge are solved with `cost.velocity = "auto"`, too, since efforts alone leave light joints free to spin;
and what is the least root mean square of that effort, as far as a local minimum says, is looked for.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence

import numpy as np

import mbocp
from benchmarks.machine import one_core
from benchmarks.random_tasks import random_problems
from benchmarks.tables import Table, show
from mbocp.solution import loads_of

__all__ = ["mean_square_table", "outcome"]

CLASSES = ("ur5", "panda", "kinova", "double pendulum")
_ELSEWHERE = 1e-2  # of the weight of the limited effort, that of others where the least is looked for


def outcome(problem: mbocp.Problem, share: float) -> str:
    """What becomes of a task whose largest root mean square is limited to a share of itself."""
    free = mbocp.solve(problem)
    if not free.converged:
        return "no motion without the limit"
    values = np.array([load.rms for load in loads_of(free, problem.robot)])
    k = int(values.argmax())
    limits = {"effort_rms": {problem.robot.u_labels[k].name: float(share * values[k])}}
    limited = problem.with_(limits=limits)
    if mbocp.solve(limited).converged:
        return "converged"
    if mbocp.solve(limited.with_(cost={"effort": 1.0, "velocity": "auto"})).converged:
        return "with cost.velocity"
    weights = np.where(np.arange(problem.robot.nu) == k, 1.0, _ELSEWHERE)
    least = mbocp.solve(problem.with_(cost={"effort": weights.tolist()}), warm_start=free)
    is_too_low = least.converged and loads_of(least, problem.robot)[k].rms > share * values[k]
    return "below the least found" if is_too_low else "none of these"


def mean_square_table(number: int, shares: Sequence[float], classes: Sequence[str] = CLASSES) -> Table:
    """Outcomes of `number` tasks of each class, by share."""
    words = ("converged", "with cost.velocity", "below the least found", "none of these")
    rows = []
    for share in shares:
        for name in classes:
            found = Counter(outcome(problem, share) for problem in random_problems(name, number, 7))
            tasks = number - found["no motion without the limit"]
            rows.append((f"{share:g}", name, str(tasks), *(str(found[word]) for word in words)))
    return Table("Limits of root mean squares", ("share", "tasks of", "number", *words), tuple(rows))


def main(arguments: Sequence[str] | None = None) -> None:
    """Solve and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mean_squares", description=__doc__)
    parser.add_argument("--number", type=int, default=12, help="tasks of each class")
    parser.add_argument("--shares", type=float, nargs="+", default=[0.9, 0.7])
    asked = parser.parse_args(arguments)
    one_core()
    show(mean_square_table(asked.number, asked.shares))


if __name__ == "__main__":
    main()

"""How good the minima are that one guess, or several, lead to: `python -m benchmarks.quality`.

Each task is solved by mbocp, by mbocp from several starts, and by IPOPT and fatrop from the same guess. The
best cost that any of them finds with steps that resolve the motion is the measure.
"""

from __future__ import annotations

import argparse
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import median

import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.random_tasks import CLASSES, random_problems
from benchmarks.tables import Table, show
from mbocp.formulation import formulate
from mbocp.solvers import Status

__all__ = ["COSTS", "SETS", "WAYS", "Found", "measure", "quality_table", "tasks"]

SETS = ("ur5", "panda", "kinova", "acrobot", "drone")
COSTS: Mapping[str, Mapping[str, object]] = {"effort": {"velocity": 0.0}, "auto": {"velocity": "auto"}}
WAYS: Mapping[str, Mapping[str, object]] = {
    "auto": {"method": "auto"},
    "auto, 4 starts": {"method": "auto", "starts": 4},
    "ipopt": {"method": "ipopt"},
    "fatrop": {"method": "fatrop"},
}
_NEAR = 0.01  # relative distance from the best cost that counts as the same


@dataclass(frozen=True)
class Found:
    """What one way of solving came to.

    Attributes
    ----------
    cost : float
        Infinite where it has not converged to a motion that the steps resolve.
    iterations : int
    is_unresolved : bool
        Whether it has converged, and the steps do not resolve the motion.
    """

    cost: float
    iterations: int
    is_unresolved: bool


def tasks(name: str, cost: str, number: int, seed: int) -> Iterator[mbocp.Problem]:
    """Random tasks of a set without limits; the i-th does not depend on the number."""
    for problem in random_problems(name, number, seed):
        free = mbocp.problem.Bounds()
        yield problem.with_(cost=COSTS[cost], limits=free, guess={"kind": "line"})


def measure(problem: mbocp.Problem, time_limit: float) -> dict[str, Found]:
    """What each way comes to."""
    found = {}
    for way, options in WAYS.items():
        solver = replace(problem.solver, time_limit=time_limit, **options)
        chosen = problem.with_(solver=solver)
        formulate(chosen)  # compiling is not within the limit
        solution = mbocp.solve(chosen)
        iterations = sum(start.iterations for start in solution.starts) or solution.iterations
        cost = solution.cost if solution.converged else math.inf
        found[way] = Found(cost, iterations, solution.status is Status.UNDER_RESOLVED)
    return found


def quality_table(
    sets: Sequence[str] = SETS,
    costs: Sequence[str] = tuple(COSTS),
    number: int = 20,
    seed: int = 0,
    time_limit: float = 60.0,
) -> Table:
    """Share of the tasks in which each way comes within a hundredth of the best cost."""
    rows = []
    for name in sets:
        for cost in costs:
            results = [measure(problem, time_limit) for problem in tasks(name, cost, number, seed)]
            for way in WAYS:
                rows.append((f"{name}, {cost}", way, *_cells(results, way)))
    columns = ("tasks", "way", "solved", "one guess", "all", "worst", "under-resolved", "iterations")
    note = (
        f"{number} tasks of each set, seed {seed}. solved: by any way, with a motion that the steps resolve; "
        "one guess: within 1 % of the lowest cost that a single guess leads to; all: of the lowest cost of "
        "all; worst: cost over the lowest of all, of those that converged; iterations: median, of all starts."
    )
    return Table("Quality of minima", columns, rows, note)


def _cells(results: Sequence[Mapping[str, Found]], way: str) -> tuple[str, ...]:
    solved = [found for found in results if math.isfinite(_best(found))]
    alone = [found for found in results if math.isfinite(_best(found, alone=True))]
    ratios = np.array([_ratio(found[way].cost, _best(found)) for found in solved])
    finite = ratios[np.isfinite(ratios)]
    return (
        str(len(solved)),
        _share([_ratio(found[way].cost, _best(found, alone=True)) for found in alone]),
        _share(list(ratios)),
        f"{finite.max():.3g}" if finite.size else "-",
        str(sum(found[way].is_unresolved for found in results)),
        f"{median(found[way].iterations for found in results):g}",
    )


def _share(ratios: Sequence[float]) -> str:
    if not len(ratios):
        return "-"
    return f"{100.0 * sum(ratio <= 1.0 + _NEAR for ratio in ratios) / len(ratios):.1f} %"


def _best(found: Mapping[str, Found], *, alone: bool = False) -> float:
    """Lowest cost of all ways, or of those with a single guess."""
    return min(entry.cost for way, entry in found.items() if not (alone and "starts" in WAYS[way]))


def _ratio(cost: float, best: float) -> float:
    return cost / best if best > 0.0 else 1.0 + abs(cost - best)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.quality", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--sets", nargs="*", default=SETS, choices=sorted(CLASSES), help="classes of tasks")
    parser.add_argument("--costs", nargs="*", default=tuple(COSTS), choices=tuple(COSTS))
    parser.add_argument("--number", type=int, default=20, help="tasks of each set")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--time-limit", type=float, default=60.0, help="[s] of each solve")
    options = parser.parse_args(arguments)
    one_core()
    show(header(), markdown=options.markdown)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # goals beyond the limits of a joint: no matter here
        table = quality_table(options.sets, options.costs, options.number, options.seed, options.time_limit)
    show(table, markdown=options.markdown)


if __name__ == "__main__":
    main()

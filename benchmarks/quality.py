"""How good the minima are that one guess, or several, lead to: `python -m benchmarks.quality`.

Each task is solved by mbocp, by mbocp from several starts, and by IPOPT and fatrop from the same guess. The
best cost that any of them finds with steps that resolve the motion is the measure: a motion that turns a
joint by more than a radian in a step satisfies the discrete equations and is none of the robot. How near each
comes to the lowest cost of all that satisfies these equations is counted, too.

`--refine` solves each result once more with twice the steps, from where it is: what its cost then changes by
says how much of it the steps resolve.

`--records` keeps every result in a file, and solves nothing twice: a long measurement can be broken off, and
run in parts, each with a file of its own, which are read together in the end.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.random_tasks import CLASSES, random_problems
from benchmarks.records import Found, Key, Records
from benchmarks.tables import Table, show
from mbocp.formulation import formulate
from mbocp.mechanics.diagnostics import largest_turn
from mbocp.solvers import Status

__all__ = [
    "COSTS",
    "SETS",
    "WAYS",
    "measure",
    "quality_table",
    "record",
    "refined",
    "refinement_table",
    "tasks",
]

SETS = ("ur5", "panda", "kinova", "acrobot", "drone")
COSTS: Mapping[str, Mapping[str, object]] = {"effort": {"velocity": 0.0}, "auto": {"velocity": "auto"}}
WAYS: Mapping[str, Mapping[str, object]] = {
    "auto": {"method": "auto"},
    "auto, 4 starts": {"method": "auto", "starts": 4},
    "ipopt": {"method": "ipopt"},
    "fatrop": {"method": "fatrop"},
}
_STATIONARY = (Status.CONVERGED, Status.UNDER_RESOLVED)
_NEAR = 0.01  # relative distance from the best cost that counts as the same


_TURNS = (0.0, 0.25, 0.5, 0.75, 1.0, 2.0, math.inf)  # [rad] in one step: bounds of the refinement's rows
_HOLDS = 0.1  # relative change of the cost with twice the steps
_DEVIATION = 1.96  # standard deviations on either side that hold 95 %


def tasks(name: str, cost: str, number: int, seed: int) -> Iterator[mbocp.Problem]:
    """Random tasks of a set without limits; the i-th does not depend on the number."""
    for problem in random_problems(name, number, seed):
        free = mbocp.problem.Bounds()
        yield problem.with_(cost=COSTS[cost], limits=free, guess={"kind": "line"})


def measure(problem: mbocp.Problem, way: str, time_limit: float) -> Found:
    """What one way comes to."""
    chosen = problem.with_(solver=replace(problem.solver, time_limit=time_limit, **WAYS[way]))
    formulate(chosen)  # compiling is not within the limit
    begun = time.process_time()
    solution = mbocp.solve(chosen)
    seconds = time.process_time() - begun
    iterations = sum(start.iterations for start in solution.starts) or solution.iterations
    cost = solution.cost if solution.status in _STATIONARY else math.inf
    return Found(cost, iterations, seconds, solution.converged)


def record(
    records: Records,
    sets: Sequence[str],
    costs: Sequence[str],
    ways: Sequence[str],
    numbers: range,
    seed: int,
    time_limit: float,
) -> None:
    """Solve what is not among the records yet: these tasks of each set, with each cost, each way."""
    for name in sets:
        for cost in costs:
            for task, problem in enumerate(tasks(name, cost, numbers.stop, seed)):
                for way in ways if task in numbers else ():
                    key = Key(name, cost, seed, task, way)
                    if key not in records.found:
                        records.add(key, measure(problem, way, time_limit))


def quality_table(records: Records, sets: Sequence[str] = SETS, costs: Sequence[str] = tuple(COSTS)) -> Table:
    """Share of the recorded tasks in which each way comes within a hundredth of the best cost."""
    rows = []
    for name in sets:
        for cost in costs:
            results = list(records.of(name, cost, tuple(WAYS)))
            if results:
                rows += [(f"{name}, {cost}", way, *_cells(results, way)) for way in WAYS]
    columns = (
        "tasks",
        "way",
        "resolved",
        "unresolved",
        "one guess",
        "all",
        "any",
        "worst",
        "iterations",
        "time [ms]",
    )
    seeds = ", ".join(str(seed) for seed in sorted({key.seed for key in records.found}))
    note = (
        f"Seeds: {seeds}. resolved, unresolved: results with and without steps that "
        "resolve the motion; one guess: within 1 % of the lowest cost of a resolved motion that a single "
        "guess leads to, of the tasks with one; all: of the lowest such cost of all ways; any: the same with "
        "unresolved results, which only the discrete equations allow; in brackets intervals of 95 % "
        "(Wilson); worst: cost over the lowest of all, of resolved motions; iterations: median, of all "
        "starts; time: median, of the processor."
    )
    return Table("Quality of minima", columns, rows, note)


def refined(problem: mbocp.Problem, time_limit: float) -> list[tuple[float, float]]:
    """Largest turn in a step [rad], and what twice the steps change the cost by, of each way."""
    found = []
    for options in (options for options in WAYS.values() if "starts" not in options):
        solver = replace(problem.solver, time_limit=time_limit, **options)
        solution = mbocp.solve(problem.with_(solver=solver))
        if solution.status not in _STATIONARY:
            continue
        newton = replace(problem.solver, time_limit=time_limit, method="monolithic")
        finer = problem.with_(num_steps=2 * problem.num_steps, solver=newton)
        again = mbocp.solve(finer, warm_start=solution)
        if again.status in _STATIONARY:
            turn = largest_turn(problem.robot, solution.qs, solution.vs, problem.dt, problem.substeps)[1]
            found.append((turn, again.cost / solution.cost - 1.0))
    return found


def refinement_table(
    sets: Sequence[str], costs: Sequence[str], number: int, seed: int, time_limit: float
) -> Table:
    """How far costs change with twice the steps, by the largest turn of a joint in one of the single ones."""
    rows = []
    for name in sets:
        for cost in costs:
            found = [
                pair for problem in tasks(name, cost, number, seed) for pair in refined(problem, time_limit)
            ]
            for low, high in pairwise(_TURNS):
                changes = np.array([change for turn, change in found if low <= turn < high])
                if changes.size:
                    holding = int((np.abs(changes) <= _HOLDS).sum())
                    middle = f"{100.0 * np.median(np.abs(changes)):.1f} %"
                    rows.append(
                        (f"{name}, {cost}", f"{low:g} to {high:g}", str(changes.size), middle, str(holding))
                    )
    columns = ("tasks", "turn in a step [rad]", "results", "median change", "within 10 %")
    note = (
        f"{number} tasks of each set, seed {seed}; results of auto, IPOPT and fatrop, each solved again with "
        "twice the steps by Newton's method from where it is; without those for which that fails."
    )
    return Table("Costs with twice the steps", columns, rows, note)


def _cells(results: Sequence[Mapping[str, Found]], way: str) -> tuple[str, ...]:
    singles = [other for other in WAYS if "starts" not in WAYS[other]]
    ratios = _ratios(results, way, list(WAYS))
    finite = [ratio for ratio in ratios if math.isfinite(ratio)]
    return (
        str(sum(found[way].is_resolved for found in results)),
        str(sum(math.isfinite(found[way].cost) and not found[way].is_resolved for found in results)),
        _share(_ratios(results, way, list({*singles, way}))),
        _share(ratios),
        _share([_ratio(f[way].cost, min(f[w].cost for w in WAYS)) for f in results]),
        f"{max(finite):.3g}" if finite else "-",
        f"{median(found[way].iterations for found in results):g}",
        f"{1e3 * median(found[way].seconds for found in results):.0f}",
    )


def _ratios(results: Sequence[Mapping[str, Found]], way: str, ways: Sequence[str]) -> list[float]:
    """Cost over the lowest of these ways, of resolved motions, for each task of which there is one."""
    best = [min(found[other].resolved_cost for other in ways) for found in results]
    return [
        _ratio(found[way].resolved_cost, least)
        for found, least in zip(results, best, strict=True)
        if math.isfinite(least)
    ]


def _share(ratios: Sequence[float]) -> str:
    """Share of those near one, its interval of 95 %, and of how many."""
    n = len(ratios)
    if not n:
        return "-"
    good, z = sum(ratio <= 1.0 + _NEAR for ratio in ratios), _DEVIATION
    middle = (good + z**2 / 2.0) / (n + z**2)
    half = z / (n + z**2) * math.sqrt(good * (n - good) / n + z**2 / 4.0)
    low, high = max(0.0, middle - half), min(1.0, middle + half)
    return f"{100.0 * good / n:.0f} % of {n} ({100.0 * low:.0f} to {100.0 * high:.0f})"


def _ratio(cost: float, best: float) -> float:
    if not math.isfinite(cost):
        return math.inf
    return cost / best if best > 0.0 else 1.0 + abs(cost - best)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.quality", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--sets", nargs="*", default=SETS, choices=sorted(CLASSES), help="classes of tasks")
    parser.add_argument("--costs", nargs="*", default=tuple(COSTS), choices=tuple(COSTS))
    parser.add_argument("--ways", nargs="*", default=tuple(WAYS), choices=tuple(WAYS), help="all by default")
    parser.add_argument("--first", type=int, default=0, help="number of the first task")
    parser.add_argument("--number", type=int, default=20, help="tasks of each set")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--time-limit", type=float, default=60.0, help="[s] of each solve")
    parser.add_argument(
        "--records",
        type=Path,
        nargs="*",
        default=(),
        help="files of results: new ones go to the first, the table is of all; --number 0 solves nothing",
    )
    parser.add_argument("--refine", action="store_true", help="what costs come to with twice the steps")
    options = parser.parse_args(arguments)
    one_core()
    show(header(), markdown=options.markdown)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # goals beyond the limits of a joint: no matter here
        if options.refine:
            table = refinement_table(
                options.sets, options.costs, options.number, options.seed, options.time_limit
            )
        else:
            records = Records.read(*options.records)
            numbers = range(options.first, options.first + options.number)
            given = options.sets, options.costs, options.ways, numbers
            record(records, *given, options.seed, options.time_limit)
            table = quality_table(records, options.sets, options.costs)
    show(table, markdown=options.markdown)


if __name__ == "__main__":
    main()

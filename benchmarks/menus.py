"""Menus beside one start, four, and many: `python -m benchmarks.menus --tasks 50 --starts 200`.

How often each comes within 1 % of the best motion that any of them finds, how many minima a menu has of those
that many starts find, and what that takes. Minima are told apart by their costs. Tasks without a motion that
the steps resolve do not count. `--records` keeps results in a file, and solves nothing twice.
"""

from __future__ import annotations

import argparse
import json
import math
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from statistics import median

import mbocp
from benchmarks import quality
from benchmarks.machine import header, one_core
from benchmarks.poses import pose_tasks
from benchmarks.scenes import scene
from benchmarks.tables import Table, show
from mbocp.exceptions import MbocpError
from mbocp.formulation import formulate
from mbocp.problem import Problem
from mbocp.solvers import Status

__all__ = ["SETS", "Result", "measure", "menus_table"]

_NEAR, _SAME = 0.01, 1e-3  # relative: as good as the best; the same minimum
Found = tuple[list[float], float]  # costs, lowest first, and time of the processor [s]
_WAYS = ("one", "four", "menu", "many")


def _poses(name: str, number: int, seed: int) -> Iterator[Problem]:
    return (make() for make in pose_tasks(name, number, seed))


def _scenes(name: str, number: int, seed: int) -> Iterator[Problem]:
    return (scene(name, i, seed) for i in range(number))


SETS: Mapping[str, Callable[[int, int], Iterator[Problem]]] = {
    "ur5, effort": lambda number, seed: quality.tasks("ur5", "effort", number, seed),
    "acrobot, effort": lambda number, seed: quality.tasks("acrobot", "effort", number, seed),
    "panda, effort": lambda number, seed: quality.tasks("panda", "effort", number, seed),
    "kinova, effort": lambda number, seed: quality.tasks("kinova", "effort", number, seed),
    "panda, auto": lambda number, seed: quality.tasks("panda", "auto", number, seed),
    "kinova, auto": lambda number, seed: quality.tasks("kinova", "auto", number, seed),
    "acrobot, auto": lambda number, seed: quality.tasks("acrobot", "auto", number, seed),
    "ur5, poses": partial(_poses, "ur5"),
    "panda, poses": partial(_poses, "panda"),
    "ur5, obstacles": partial(_scenes, "ur5"),
}


@dataclass(frozen=True)
class Result:
    """Costs of the minima that each way finds in one task, lowest first, and its time [s]."""

    costs: Mapping[str, Sequence[float]]
    seconds: Mapping[str, float]

    @property
    def best(self) -> float:
        """The lowest cost of all; infinite where there is no motion."""
        return min((found[0] for found in self.costs.values() if found), default=math.inf)

    def is_near(self, way: str) -> bool:
        """Whether a way comes near it."""
        found = self.costs[way]
        return bool(found) and found[0] <= (1.0 + _NEAR) * self.best

    def shared(self, way: str, other: str) -> int:
        """Number of minima of one way that another one finds, too."""
        return sum(any(_is_same(cost, known) for known in self.costs[other]) for cost in self.costs[way])


def measure(problem: Problem, way: str, starts: int) -> Found:
    """Costs of the minima that one way finds in one task, and the time of the processor [s]."""
    solves = {"one": partial(_starts, problem, 1), "four": partial(_starts, problem, 4)}
    solves |= {"menu": partial(_menu, problem), "many": partial(_starts, problem, starts)}
    formulate(problem)  # compiles
    begun = time.process_time()
    costs = _distinct(solves[way]())
    return costs, time.process_time() - begun


def menus_table(results: Mapping[str, Sequence[Result]], starts: int) -> Table:
    """One row for each set and way."""
    names = dict(zip(_WAYS, ("one start", "four starts", "menu", f"{starts} starts"), strict=True))
    rows = []
    for name, all_of in results.items():
        mine = [result for result in all_of if math.isfinite(result.best)]
        for way in _WAYS if mine else ():
            near = sum(result.is_near(way) for result in mine)
            minima = sum(len(result.costs[way]) for result in mine) / len(mine)
            shared = sum(result.shared("many", way) for result in mine)
            total = sum(len(result.costs["many"]) for result in mine)
            worst = max((r.costs[way][0] / r.best for r in mine if r.costs[way]), default=math.nan)
            rows.append(
                (
                    name,
                    names[way],
                    f"{near} of {len(mine)}",
                    f"{worst:.3g}",
                    f"{minima:.1f}",
                    f"{shared} of {total}",
                    f"{median(result.seconds[way] for result in mine):.2f}",
                )
            )
    columns = ("tasks", "way", "near the best", "worst", "minima", "of all that many starts find", "time [s]")
    note = (
        "Motions that the steps resolve. near the best: within 1 % of the lowest cost of all ways; worst: "
        "cost over that; minima: a task, told apart by costs that differ by 0.1 %; time: median, of the "
        "processor."
    )
    return Table("Menus", columns, rows, note)


def _starts(problem: Problem, starts: int) -> list[float]:
    solution = mbocp.solve(problem.with_(solver={"starts": starts}))
    if starts == 1:
        return [solution.cost] if solution.converged else []
    return [start.cost for start in solution.starts if start.status is Status.CONVERGED]


def _menu(problem: Problem) -> list[float]:
    return [solution.cost for solution in mbocp.menu(problem, threads=1) if solution.converged]


def _distinct(costs: Sequence[float]) -> list[float]:
    found = list[float]()
    for cost in sorted(costs):
        if not found or not _is_same(cost, found[-1]):
            found.append(cost)
    return found


def _is_same(one: float, other: float) -> bool:
    return abs(one - other) <= _SAME * abs(other)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.menus", description=__doc__)
    parser.add_argument("--tasks", type=int, default=50, help="of each set")
    parser.add_argument("--starts", type=int, default=200, help="how many many are")
    parser.add_argument("--seed", type=int, default=31)
    parser.add_argument("--sets", nargs="+", default=list(SETS), choices=list(SETS))
    parser.add_argument("--records", type=Path, help="file of results that are there, and that are added")
    options = parser.parse_args(arguments)
    one_core()
    known = _read(options.records)
    results = dict[str, list[Result]]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in options.sets:
            tasks = SETS[name](options.tasks, options.seed)
            for number, problem in enumerate(islice(tasks, options.tasks)):
                key = f"{name} {options.seed} {number}"
                try:
                    found = {way: _known(options, known, key, way, problem) for way in _WAYS}
                except MbocpError as error:
                    print(f"{key}: {error}")
                    continue
                costs, seconds = ({way: pair[k] for way, pair in found.items()} for k in (0, 1))
                results.setdefault(name, []).append(Result(costs, seconds))
    show(header())
    show(menus_table(results, options.starts))


def _known(
    options: argparse.Namespace, known: dict[str, Found], task: str, way: str, problem: Problem
) -> Found:
    """What is among the records already, or is measured and added to them."""
    key = f"{task} {way}" + (f" {options.starts}" if way == "many" else "")
    if key not in known:
        known[key] = measure(problem, way, options.starts)
        if options.records is not None:
            with options.records.open("a", encoding="utf-8") as file:
                file.write(json.dumps([key, *known[key]]) + "\n")
    return known[key]


def _read(path: Path | None) -> dict[str, Found]:
    lines = path.read_text(encoding="utf-8").splitlines() if path is not None and path.exists() else []
    return {key: (costs, seconds) for key, costs, seconds in map(json.loads, lines)}


if __name__ == "__main__":
    main()

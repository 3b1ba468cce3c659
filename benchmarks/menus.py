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
from dataclasses import asdict, dataclass
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
from mbocp.problem import Problem
from mbocp.solvers import Status

__all__ = ["SETS", "Result", "measure", "menus_table"]

_NEAR, _SAME = 0.01, 1e-3  # relative: as good as the best; the same minimum
_WAYS = ("one", "four", "menu", "many")


def _poses(name: str, number: int, seed: int) -> Iterator[Problem]:
    return (make() for make in pose_tasks(name, number, seed))


def _scenes(name: str, number: int, seed: int) -> Iterator[Problem]:
    return (scene(name, i, seed) for i in range(number))


SETS: Mapping[str, Callable[[int, int], Iterator[Problem]]] = {
    "ur5, effort": lambda number, seed: quality.tasks("ur5", "effort", number, seed),
    "acrobot, effort": lambda number, seed: quality.tasks("acrobot", "effort", number, seed),
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


def measure(problem: Problem, starts: int) -> Result:
    """Solve one task in each way."""
    solved = {"one": partial(_starts, problem, 1), "four": partial(_starts, problem, 4)}
    solved |= {"menu": partial(_menu, problem), "many": partial(_starts, problem, starts)}
    mbocp.solve(problem)  # compiles
    costs, seconds = {}, {}
    for way, solve in solved.items():
        begun = time.process_time()
        costs[way] = _distinct(solve())
        seconds[way] = time.process_time() - begun
    return Result(costs, seconds)


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
                key = f"{name} {options.seed} {number} {options.starts}"
                if key not in known:
                    try:
                        known[key] = measure(problem, options.starts)
                    except MbocpError as error:
                        print(f"{key}: {error}")
                        continue
                    _write(options.records, key, known[key])
                results.setdefault(name, []).append(known[key])
    show(header())
    show(menus_table(results, options.starts))


def _read(path: Path | None) -> dict[str, Result]:
    lines = path.read_text(encoding="utf-8").splitlines() if path is not None and path.exists() else []
    entries = [json.loads(line) for line in lines]
    return {entry["key"]: Result(entry["costs"], entry["seconds"]) for entry in entries}


def _write(path: Path | None, key: str, result: Result) -> None:
    if path is not None:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"key": key, **asdict(result)}) + "\n")


if __name__ == "__main__":
    main()

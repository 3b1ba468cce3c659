"""How often random problems of each class are solved: `python -m benchmarks.reliability`."""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.random_tasks import CLASSES, random_problems
from benchmarks.tables import Table, show
from mbocp.formulation import transcribe
from mbocp.study.run_task import solver_seconds

__all__ = ["outcomes", "reliability_table"]


_SOLVED = ("converged", "under_resolved")


def outcomes(name: str, number: int, seed: int, time_limit: float) -> list[dict[str, Any]]:
    """What each task of a class came to."""
    found = []
    for problem in random_problems(name, number, seed):
        transcribe(problem)  # compiles, which a time limit counts
        solver = replace(problem.solver, time_limit=time_limit)
        solution = mbocp.solve(problem.with_(solver=solver))
        found.append(
            {
                "class": name,
                "status": str(solution.status),
                "iterations": solution.iterations,
                "seconds": solver_seconds(solution),
                "cost": solution.cost,
                "residual": solution.residual,
                "solver": solution.solver,
                "advice": solution.advice,
            }
        )
    return found


def reliability_table(found: Sequence[dict[str, Any]]) -> Table:
    """Successes by class, and what they took."""
    rows = []
    for name in dict.fromkeys(row["class"] for row in found):
        of_class = [row for row in found if row["class"] == name]
        good = [row for row in of_class if row["status"] in _SOLVED]
        others: dict[str, int] = {}
        for row in of_class:
            if row["status"] not in _SOLVED:
                others[row["status"]] = others.get(row["status"], 0) + 1
        taken = [row["iterations"] for row in good] or [0]
        times = [1e3 * row["seconds"] for row in good] or [0.0]
        rows.append(
            (
                name,
                f"{len(good)} / {len(of_class)}",
                f"{np.median(taken):.0f} / {np.percentile(taken, 90):.0f} / {max(taken)}",
                f"{np.median(times):.0f} / {np.percentile(times, 90):.0f} / {max(times):.0f}",
                f"{1e3 * max(row['seconds'] for row in of_class):.0f}",
                ", ".join(f"{count} {status}" for status, count in others.items()),
            )
        )
    columns = ("class", "solved", "iterations", "time [ms]", "longest [ms]", "not solved")
    note = (
        "Solved: the optimality conditions hold, whether the steps resolve the motion or not. Iterations and "
        "times of these: median / 90th percentile / most. Solver alone."
    )
    return Table("Random problems", columns, rows, note)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table; the outcomes into a file on request."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.reliability", description=__doc__)
    parser.add_argument("--number", type=int, default=25, help="tasks of each class")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--time-limit", type=float, default=20.0, help="of a task [s]")
    parser.add_argument("--classes", nargs="*", default=list(CLASSES), choices=list(CLASSES), metavar="CLASS")
    parser.add_argument("--json", type=Path, help="write the outcomes of all tasks to this file")
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    options = parser.parse_args(arguments)
    one_core()
    show(header(), markdown=options.markdown)
    found: list[dict[str, Any]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name in options.classes:
            clock = time.perf_counter()
            found += outcomes(name, options.number, options.seed, options.time_limit)
            if options.json:
                options.json.write_text(json.dumps(found, indent=1), encoding="utf-8")
                print(f"{name}: {time.perf_counter() - clock:.1f} s", flush=True)
    show(reliability_table(found), markdown=options.markdown)


if __name__ == "__main__":
    main()

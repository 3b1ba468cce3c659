"""Time of a Newton iteration, Table 4 of [Manara2017]_."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import fmean, median
from typing import Any

from mbocp.solution import Solution
from mbocp.solving import solve
from mbocp.study.run_task import solver_seconds
from mbocp_papers.layout import Column, PaperTable, Section
from mbocp_papers.so3.data import FORMULATIONS, Formulation, Task, lattice
from mbocp_papers.so3.experiment import SOLVERS, task_problem
from mbocp_papers.so3.request import Request, Say

TITLE = "time of a Newton iteration, N = 100"

_LIMITS = {"solver.max_iterations": 300, "solver.time_limit": 20.0}
_TITLES = {"ipopt": "IPOPT", "fatrop": "fatrop", "monolithic": "mbocp"}
_COLUMNS = (
    Column("formulation", "", "label"),
    Column("paper [ms]", "", "paper"),
    *(
        column
        for solver in SOLVERS
        for column in (
            Column(f"{_TITLES[solver]} [ms]", "this task"),
            Column(f"{_TITLES[solver]} [ms]", "mean"),
            Column(_TITLES[solver], "paper/this", "ratio"),
            Column(_TITLES[solver], "iterations", "label"),
        )
    ),
)


@dataclass(frozen=True)
class IterationTime:
    """Time of an iteration of one formulation by one solver.

    Attributes
    ----------
    milliseconds : float
        Of the task x = y = 0.5 m, theta = pi; NaN if it took no iteration.
    mean : float
        Over tasks of the lattice [ms].
    iterations : int
        Of the task.
    status : str
        Of the task.
    """

    milliseconds: float
    mean: float
    iterations: int
    status: str

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for JSON."""
        return {
            "milliseconds": None if math.isnan(self.milliseconds) else self.milliseconds,
            "mean": None if math.isnan(self.mean) else self.mean,
            "iterations": self.iterations,
            "status": self.status,
        }


def iteration_time(
    formulation: Formulation, solver: str, tasks: Sequence[Task], repetitions: int
) -> IterationTime:
    """Measure the wall time of the solver's phase over its iterations.

    The first solve of all is a rehearsal: it compiles functions and makes the solver.

    Parameters
    ----------
    formulation : Formulation
    solver : {"ipopt", "fatrop", "monolithic"}
    tasks : sequence of Task
        For the mean.
    repetitions : int
        Runs of the paper's task, of which the median is taken.
    """
    settings = {"solver.method": solver, **_LIMITS}
    problem = task_problem(formulation, settings=settings)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solution = solve(problem)
        times = [_milliseconds(solve(problem)) for _ in range(repetitions)]
        others = [_milliseconds(solve(task_problem(formulation, task, settings))) for task in tasks]
    shown = [time for time in others if not math.isnan(time)]
    return IterationTime(
        milliseconds=median(times),
        mean=fmean(shown) if shown else math.nan,
        iterations=solution.iterations,
        status=str(solution.status),
    )


def timing_table(request: Request, say: Say = str) -> PaperTable:
    """Table 4, on one core."""
    tasks, repetitions = (lattice(2, 1), 1) if request.quick else (lattice(3, 2), 5)
    found: dict[tuple[str, str], IterationTime] = {}
    with one_core():
        for one in FORMULATIONS:
            for solver in SOLVERS:
                say(f"Table 4: {one.label}, {_TITLES[solver]}")
                found[one.label, solver] = iteration_time(one, solver, tasks, repetitions)
    rows = tuple((_row(one, [found[one.label, solver] for solver in SOLVERS]),) for one in FORMULATIONS)
    return PaperTable(
        number=4,
        title=TITLE,
        columns=_COLUMNS,
        sections=(Section("", rows),),
        notes=(
            "Wall time of the solver over its iterations: this task is x = y = 0.5 m, theta = pi; "
            f"mean: over {len(tasks)} tasks of the lattice. One core; nothing is compiled in that time.",
            "The paper's are IPOPT's of 2017, on a Core i7-3930K at 3.2 GHz.",
        ),
        data={
            one.label: {
                "paper": one.milliseconds,
                **{solver: found[one.label, solver].to_dict() for solver in SOLVERS},
            }
            for one in FORMULATIONS
        },
    )


@contextmanager
def one_core() -> Iterator[None]:
    """Keep this process on one core meanwhile, where the system allows it."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(before)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


def _milliseconds(solution: Solution) -> float:
    return 1e3 * solver_seconds(solution) / solution.iterations if solution.iterations else math.nan


def _row(one: Formulation, times: Sequence[IterationTime]) -> tuple[str, ...]:
    cells: list[str] = [one.label, f"{one.milliseconds:g}"]
    for time in times:
        iterations = (
            str(time.iterations) if time.status == "converged" else f"{time.iterations} ({time.status})"
        )
        cells += [
            _number(time.milliseconds),
            _number(time.mean),
            _ratio(one.milliseconds / time.milliseconds),
            iterations,
        ]
    return tuple(cells)


def _number(milliseconds: float) -> str:
    return "-" if math.isnan(milliseconds) else f"{milliseconds:.2f}"


def _ratio(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.1f}" if value < 100 else f"{value:.0f}"

"""Stage functions as machine code and as tapes, side by side."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median

import mbocp
from benchmarks.newton import CASES, Case, load, newton, warm_guess
from benchmarks.tables import Table
from mbocp.formulation import transcribe

__all__ = ["StageTime", "stage_table", "time_stages"]


@dataclass(frozen=True)
class StageTime:
    """Seconds for one stage's functions with all first and second derivatives, in the kernel."""

    compiled: float
    interpreted: float

    @property
    def ratio(self) -> float:
        return self.interpreted / self.compiled


def time_stages(problem: mbocp.Problem, repetitions: int) -> StageTime:
    """Evaluate the same iterate with both, in turn."""
    programme, guess = warm_guess(problem)
    with _tapes():
        interpreted = transcribe(problem)
    natives = []
    for variant in (programme, interpreted):
        natives.append(newton(problem, variant).init(variant, guess).native)
    seconds: tuple[list[float], list[float]] = ([], [])
    for _ in range(repetitions):
        for native, times in zip(natives, seconds, strict=True):
            clock = time.perf_counter()
            native.evaluate()
            times.append(time.perf_counter() - clock)
    return StageTime(*(median(times) / problem.num_steps for times in seconds))


@contextmanager
def _tapes() -> Iterator[None]:
    """What functions are that no compiler is asked for."""
    kept = os.environ.get("MBOCP_FUNCTIONS")
    os.environ["MBOCP_FUNCTIONS"] = "tapes"
    try:
        yield
    finally:
        if kept is None:
            del os.environ["MBOCP_FUNCTIONS"]
        else:
            os.environ["MBOCP_FUNCTIONS"] = kept


def stage_table(cases: Sequence[Case] = CASES, repetitions: int = 30) -> Table:
    """One row a case."""
    rows = []
    for case in cases:
        t = time_stages(load(case), repetitions)
        rows.append((case.label, f"{1e6 * t.compiled:.2f}", f"{1e6 * t.interpreted:.1f}", f"{t.ratio:.1f}"))
    columns = ("problem", "compiled C [us]", "tape [us]", "ratio")
    note = "Constraints, cost, Jacobian, gradient and Hessian of a stage, scattered into the kernel's blocks."
    return Table("Stage functions, one stage", columns, rows, note)

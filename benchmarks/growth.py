"""Time and memory over the number of steps, by one thread and by several: python -m benchmarks.growth.

Every row is a process of its own, so that its memory is that of one horizon. Wall times: they mean something
on a machine on which nothing else runs.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import mbocp
from benchmarks.lanes import KernelIterate
from benchmarks.machine import header
from benchmarks.newton import SE1, Case, exponent, load
from benchmarks.tables import Table, show
from mbocp.formulation import formulate
from mbocp.programme.processor import number_of_lanes

__all__ = ["CASES", "Growth", "growth_rows", "measured", "table_of"]

CASES = {
    "ur5_reach": Case("ur5_reach", "arms/ur5_reach.toml", SE1),
    "ur5_limits": Case("ur5_limits", "arms/ur5_limits.toml", SE1),
    "elastic_pendulum": Case("elastic_pendulum", "paper/elastic_pendulum.toml"),
}
_STEPS = (100, 1000, 10_000, 30_000, 100_000)
_BUDGET = 30_000  # stages that are gone through for a time
_LEAST = 4  # iterations


@dataclass(frozen=True)
class Growth:
    """What one horizon takes.

    Attributes
    ----------
    num_steps, threads : int
    iteration : float
        Least wall time of an iteration, without what Python adds [s].
    iterations : int
        Of the whole solve.
    converged : bool
        Whether that converged.
    solve : float
        Wall time of `mbocp.solve` [s].
    stages : int
        Memory of the kernel's stages [bytes].
    peak : int
        Largest resident memory of a process that solves the problem once [bytes].
    """

    num_steps: int
    threads: int
    iteration: float
    iterations: int
    converged: bool
    solve: float
    stages: int
    peak: int


def measured(case: str, num_steps: int, threads: int) -> Growth:
    """In this process: one solve with functions that are there, and then iterations."""
    problem = load(CASES[case], f"horizon.steps={num_steps}", f"solver.threads={threads}")
    formulate(problem)
    begun = time.perf_counter()
    solution = mbocp.solve(problem)
    took = time.perf_counter() - begun
    peak = _peak()
    iterate = KernelIterate(problem, number_of_lanes(), threads)
    times = iterate.measure(max(_LEAST, min(200, _BUDGET // num_steps)), time.perf_counter_ns)
    return Growth(
        num_steps,
        threads,
        times.iteration,
        solution.iterations,
        solution.converged,
        took,
        iterate.native.num_bytes,
        peak,
    )


def _peak() -> int:
    """Largest resident memory of this process [bytes]; `getrusage` would count that of its parent, too."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))


def growth_rows(case: str, steps: Sequence[int], threads: Sequence[int]) -> Iterator[Growth]:
    """Each in a process of its own, the first of which compiles."""
    for number in steps:
        for crew in threads:
            words = ["--one", case, "--steps", str(number), "--threads", str(crew)]
            done = subprocess.run(
                [sys.executable, "-m", "benchmarks.growth", *words],
                capture_output=True,
                text=True,
                check=True,
            )
            yield Growth(**json.loads(done.stdout.splitlines()[-1]))


def table_of(case: str, found: Sequence[Growth]) -> Table:
    """Rows of a case; memory a stage is what the next longer horizon takes more, by its more stages."""
    rows = []
    for threads in dict.fromkeys(g.threads for g in found):
        several = [g for g in found if g.threads == threads]
        more = ["", *(f"{_kilobytes_more(a, b):.2f}" for a, b in pairwise(several))]
        for g, kilobytes in zip(several, more, strict=True):
            rows.append(
                (
                    f"{g.num_steps}",
                    f"{g.threads}",
                    f"{1e3 * g.iteration:.3g}",
                    f"{1e6 * g.iteration / g.num_steps:.2f}",
                    f"{g.iterations}" + ("" if g.converged else " (not converged)"),
                    f"{g.solve:.3g}",
                    f"{1e-3 * g.stages / g.num_steps:.2f}",
                    kilobytes,
                )
            )
    columns = ("N", "threads", "iteration [ms]", "per step [us]", "iterations", "solve [s]")
    fits = ", ".join(
        f"N^{exponent([g.num_steps for g in several], [g.iteration for g in several]):.3f} by {threads}"
        for threads in dict.fromkeys(g.threads for g in found)
        if len(several := [g for g in found if g.threads == threads]) > 1
    )
    return Table(
        f"Growth: {case}",
        (*columns, "stages [kB a stage]", "whole process [kB a stage]"),
        rows,
        f"Time of an iteration, threads: {fits or 'one horizon only'}. Memory of the whole process: what the "
        "largest resident memory of a solve grows by from one horizon to the next, by its further stages.",
    )


def _kilobytes_more(a: Growth, b: Growth) -> float:
    return 1e-3 * (b.peak - a.peak) / (b.num_steps - a.num_steps)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table a case."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.growth", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--case", choices=list(CASES), action="append", help="default: all; repeatable")
    parser.add_argument("--steps", type=int, nargs="+", default=list(_STEPS), metavar="N")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], metavar="K")
    parser.add_argument("--one", choices=list(CASES), help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.one:
        print(json.dumps(asdict(measured(options.one, options.steps[0], options.threads[0]))))
        return
    crews = [k for k in options.threads if k <= (os.cpu_count() or 1)]
    show(header(), markdown=options.markdown)
    for case in options.case or CASES:
        found = list(growth_rows(case, options.steps, crews))
        show(table_of(case, found), markdown=options.markdown)


if __name__ == "__main__":
    main()

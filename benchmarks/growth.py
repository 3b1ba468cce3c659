"""Time and memory over the number of steps, by one thread and by several: python -m benchmarks.growth.

Every row is a process of its own, so that its memory is that of one horizon. A few iterations are measured
again and again at the same iterate; the first row of each number of steps is of a process that has solved the
whole problem before. Then a thousand tasks of one shape in one process. Wall times: they mean something on a
machine on which nothing else runs.
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

import mbocp
from benchmarks.around import tasks_table
from benchmarks.lanes import KernelIterate
from benchmarks.machine import header, memory
from benchmarks.newton import SE1, Case, exponent, load
from benchmarks.tables import Table, show
from mbocp.formulation import formulate
from mbocp.programme.native_modules import number_of_lanes

__all__ = ["CASES", "Growth", "Whole", "growth_rows", "measured", "table_of"]

CASES = {
    "ur5_reach": Case("ur5_reach", "arms/ur5_reach.toml", SE1),
    "ur5_limits": Case("ur5_limits", "arms/ur5_limits.toml", SE1),
    "elastic_pendulum": Case("elastic_pendulum", "paper/elastic_pendulum.toml"),
}
_STEPS = (100, 1000, 10_000, 100_000)
_TASKS = 1000
_BUDGET = 30_000  # stages that are gone through for a time
_LEAST = 4  # iterations


@dataclass(frozen=True)
class Growth:
    """What one horizon takes.

    Attributes
    ----------
    num_steps, threads : int
    evaluate, factorise, solve, iteration : float
        Least wall times of the parts of an iteration and of all of it, without what Python adds [s].
    stages : int
        Memory of the kernel's stages [bytes].
    whole : Whole or None
        What a whole solve takes, where there was one.
    """

    num_steps: int
    threads: int
    evaluate: float
    factorise: float
    solve: float
    iteration: float
    stages: int
    whole: Whole | None


@dataclass(frozen=True)
class Whole:
    """What a whole solve takes, with functions that are there.

    Attributes
    ----------
    iterations : int
    converged : bool
    seconds : float
        Wall time of `mbocp.solve` [s].
    peak : int
        Largest resident memory of the process after it [bytes].
    """

    iterations: int
    converged: bool
    seconds: float
    peak: int

    @classmethod
    def of(cls, problem: mbocp.Problem) -> Whole:
        """Solve a problem."""
        formulate(problem)
        begun = time.perf_counter()
        solution = mbocp.solve(problem)
        seconds = time.perf_counter() - begun
        return cls(solution.iterations, solution.converged, seconds, memory("VmHWM"))


def measured(case: str, num_steps: int, threads: int, is_whole: bool = True) -> Growth:
    """In this process: one solve where that is asked, and then iterations."""
    problem = load(CASES[case], f"horizon.steps={num_steps}", f"solver.threads={threads}")
    whole = Whole.of(problem) if is_whole else None
    iterate = KernelIterate(problem, number_of_lanes(), threads)
    t = iterate.measure(max(_LEAST, min(200, _BUDGET // num_steps)), time.perf_counter_ns)
    parts = (t.evaluate, t.factorise, t.solve, t.iteration)
    return Growth(num_steps, threads, *parts, iterate.native.num_bytes, whole)


def growth_rows(case: str, steps: Sequence[int], threads: Sequence[int]) -> Iterator[Growth]:
    """Each in a process of its own, the first of which compiles; whole solves by the first crew."""
    for number in steps:
        for crew in threads:
            words = ["--one", case, "--steps", str(number), "--threads", str(crew)]
            if crew == threads[0]:
                words.append("--whole")
            done = subprocess.run(
                [sys.executable, "-m", "benchmarks.growth", *words],
                capture_output=True,
                text=True,
                check=True,
            )
            found = json.loads(done.stdout.splitlines()[-1])
            whole = Whole(**found.pop("whole")) if crew == threads[0] else None
            yield Growth(**{**found, "whole": whole})


def table_of(case: str, found: Sequence[Growth]) -> Table:
    """Rows of a case; memory a stage is what the next longer horizon takes more, by its more stages."""
    rows = []
    for threads in dict.fromkeys(g.threads for g in found):
        several = [g for g in found if g.threads == threads]
        more = ["", *(_kilobytes_more(a, b) for a, b in pairwise(several))]
        for g, kilobytes in zip(several, more, strict=True):
            parts = (f"{1e6 * t / g.num_steps:.2f}" for t in (g.evaluate, g.factorise, g.solve, g.iteration))
            stages = f"{1e-3 * g.stages / g.num_steps:.2f}"
            rows.append((f"{g.num_steps}", f"{threads}", *parts, *_of_whole(g.whole), stages, kilobytes))
    parts_of_step = ("evaluate", "factorise", "solve", "iteration")
    fits = ", ".join(
        f"N^{exponent([g.num_steps for g in several], [g.iteration for g in several]):.3f} by {threads}"
        for threads in dict.fromkeys(g.threads for g in found)
        if len(several := [g for g in found if g.threads == threads]) > 1
    )
    return Table(
        f"Growth: {case}",
        (
            *("N", "threads", *(f"{part} [us]" for part in parts_of_step)),
            *("iterations", "whole solve [s]", "stages [kB a stage]", "whole process [kB a stage]"),
        ),
        rows,
        "Times of a stage, in microseconds. Time of an iteration of all stages, threads: "
        f"{fits or 'one horizon only'}. Memory of the whole process: what the largest resident memory of a "
        "solve grows by from one horizon to the next, by its further stages.",
    )


def _of_whole(whole: Whole | None) -> tuple[str, str]:
    if whole is None:
        return "", ""
    return f"{whole.iterations}" + ("" if whole.converged else " (not converged)"), f"{whole.seconds:.3g}"


def _kilobytes_more(a: Growth, b: Growth) -> str:
    if a.whole is None or b.whole is None:
        return ""
    return f"{1e-3 * (b.whole.peak - a.whole.peak) / (b.num_steps - a.num_steps):.2f}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a table a case, and one of the tasks."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.growth", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--case", choices=list(CASES), action="append", help="default: all; repeatable")
    parser.add_argument("--steps", type=int, nargs="+", default=list(_STEPS), metavar="N")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], metavar="K")
    parser.add_argument("--tasks", type=int, default=_TASKS, help="of one shape in one process; 0: none")
    parser.add_argument("--one", choices=list(CASES), help=argparse.SUPPRESS)
    parser.add_argument("--whole", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.one:
        found = measured(options.one, options.steps[0], options.threads[0], options.whole)
        print(json.dumps(asdict(found)))
        return
    crews = [k for k in options.threads if k <= (os.cpu_count() or 1)]
    show(header(), markdown=options.markdown)
    for case in options.case or CASES:
        rows = list(growth_rows(case, options.steps, crews))
        show(table_of(case, rows), markdown=options.markdown)
    if options.tasks:
        show(tasks_table(options.tasks), markdown=options.markdown)


if __name__ == "__main__":
    main()

"""Stages several at a time against one at a time, or shared by threads: python -m benchmarks.lanes.

The same iterations with the same kernel, in turn in one process, as processor time: the least of many, since
others use the machine, too. With `--threads 2` wall times, by one thread and by two.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass, replace
from functools import reduce
from itertools import pairwise

import mbocp
from benchmarks.machine import one_core
from benchmarks.newton import SE1, Case, load, newton, warm_guess
from benchmarks.tables import Table, show
from mbocp.programme.native_modules import number_of_lanes

__all__ = ["KernelIterate", "LanesTime", "lanes_table", "threads_table"]

_CASES = (
    Case("UR5", "arms/ur5_reach.toml", SE1),
    Case("UR5, limits", "arms/ur5_limits.toml", SE1),
    Case("Panda", "arms/panda_reach.toml", SE1),
    Case("unicycle", "so3/unicycle_pendulum.toml"),
    Case("drone", "free_flyer/drone_flip.toml", SE1),
    Case("drone, limits", "free_flyer/drone_flip.toml", (*SE1, "limits.effort=8")),
    Case("rigid pendulum", "paper/rigid_pendulum.toml"),
)
_SHARED_CASES = (
    *_CASES[:3],
    Case("UR5, 1000 steps", "arms/ur5_reach.toml", ("integrator.scheme=se1", "horizon.steps=1000")),
    Case("UR5, obstacles", "arms/slalom.toml"),
    Case("UR5, gauss2", "arms/ur5_reach.toml"),
)
_STEPS = 4  # of the solver before the iterate that is measured
_ROUNDS = 3
_NOTE = "an iteration is the four parts, for all stages, without what Python adds."


@dataclass(frozen=True)
class LanesTime:
    """Least times of the kernel's parts of an iteration, in seconds."""

    evaluate: float
    factorise: float
    solve: float
    trial: float
    iteration: float  # all of them

    def least(self, other: LanesTime) -> LanesTime:
        """Part by part."""
        return LanesTime(*map(min, astuple(self), astuple(other)))


class KernelIterate:
    """An iterate some steps after the first guess, and the same direction from it again and again."""

    def __init__(self, problem: mbocp.Problem, lanes: int, threads: int = 1) -> None:
        with _lanes(lanes):
            programme, guess = warm_guess(problem)
        solver = replace(newton(problem, programme), threads=threads)
        state = solver.init(programme, guess)
        for _ in range(_STEPS):
            state = solver.step(state)
        self.native, self.augmentation, self.shift = state.native, state.augmentation, state.regularisation

    def measure(self, repetitions: int, clock: Callable[[], int] = time.process_time_ns) -> LanesTime:
        native, times = self.native, []
        for _ in range(repetitions):
            marks = [clock()]
            native.evaluate()
            marks.append(clock())
            native.factorise(self.shift, self.augmentation)
            marks.append(clock())
            native.solve()
            marks.append(clock())
            native.trial(1e-3)
            marks.append(clock())
            times.append(
                LanesTime(*(1e-9 * (b - a) for a, b in pairwise(marks)), 1e-9 * (marks[-1] - marks[0]))
            )
        return reduce(LanesTime.least, times)


@contextmanager
def _lanes(number: int) -> Iterator[None]:
    kept = os.environ.get("MBOCP_LANES")
    os.environ["MBOCP_LANES"] = str(number)
    try:
        yield
    finally:
        os.environ.pop("MBOCP_LANES")
        if kept is not None:
            os.environ["MBOCP_LANES"] = kept


def lanes_table(cases: Sequence[Case] = _CASES, repetitions: int = 200) -> Table:
    """Two rows a case: one stage at a time, and as many as the processor has lanes."""
    widths = (1, number_of_lanes())
    rows = []
    for case in cases:
        problem = load(case)
        iterates = [KernelIterate(problem, lanes) for lanes in widths]
        rounds = [[i.measure(repetitions // _ROUNDS) for i in iterates] for _ in range(_ROUNDS)]
        rows += _rows(case.label, problem.num_steps, widths, rounds)
    return Table(
        "Stages in lanes, times of a stage",
        _columns("lanes"),
        rows,
        f"Least processor times of {repetitions // _ROUNDS * _ROUNDS}; {_NOTE}",
    )


def threads_table(cases: Sequence[Case] = _SHARED_CASES, threads: int = 2, repetitions: int = 600) -> Table:
    """Two rows a case: by one thread, and by so many."""
    numbers = (1, threads)
    rows = []
    for case in cases:
        problem = load(case)
        iterates = [KernelIterate(problem, number_of_lanes(), number) for number in numbers]
        each, clock = repetitions // _ROUNDS, time.perf_counter_ns
        rounds = [[i.measure(each, clock) for i in iterates] for _ in range(_ROUNDS)]
        rows += _rows(case.label, problem.num_steps, numbers, rounds)
    return Table(
        "Stages shared by threads, times of a stage",
        _columns("threads"),
        rows,
        f"Least wall times of {repetitions // _ROUNDS * _ROUNDS}; {_NOTE}",
    )


def _columns(what: str) -> tuple[str, ...]:
    parts = ("evaluate [us]", "trial [us]", "factorise [us]", "solve [us]")
    return ("problem", what, *parts, "iteration [ms]", "times as fast")


def _rows(
    label: str, num_steps: int, numbers: Sequence[int], rounds: Sequence[Sequence[LanesTime]]
) -> Iterator[tuple[str, ...]]:
    best = [reduce(LanesTime.least, times) for times in zip(*rounds, strict=True)]
    for number, t in zip(numbers, best, strict=True):
        parts = (f"{1e6 * s / num_steps:.2f}" for s in (t.evaluate, t.trial, t.factorise, t.solve))
        ratio = f"{best[0].iteration / t.iteration:.2f}"
        yield (label, str(number), *parts, f"{1e3 * t.iteration:.3f}", ratio)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lanes", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--threads", type=int, default=1, help="that share stages, on as many processors")
    options = parser.parse_args(arguments)
    if options.threads > 1:
        show(threads_table(threads=options.threads), markdown=options.markdown)
        return
    one_core()
    show(lanes_table(), markdown=options.markdown)


if __name__ == "__main__":
    main()

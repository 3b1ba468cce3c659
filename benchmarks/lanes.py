"""Stages several at a time against one at a time: python -m benchmarks.lanes.

The same iterations with the same kernel, in turn in one process, as processor time: the least of many, since
others use the machine, too.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass
from functools import reduce
from itertools import pairwise

import mbocp
from benchmarks.machine import one_core
from benchmarks.newton import SE1, Case, load, newton, warm_guess
from benchmarks.tables import Table, show
from mbocp.programme.processor import number_of_lanes

__all__ = ["LanesTime", "lanes_table"]

_CASES = (
    Case("UR5", "arms/ur5_reach.toml", SE1),
    Case("UR5, limits", "arms/ur5_limits.toml", SE1),
    Case("Panda", "arms/panda_reach.toml", SE1),
    Case("unicycle", "so3/unicycle_pendulum.toml"),
    Case("drone", "free_flyer/drone_flip.toml", SE1),
    Case("drone, limits", "free_flyer/drone_flip.toml", (*SE1, "limits.effort=8")),
    Case("rigid pendulum", "paper/rigid_pendulum.toml"),
)
_STEPS = 4  # of the solver before the iterate that is measured
_ROUNDS = 3


@dataclass(frozen=True)
class LanesTime:
    """Least processor times of the kernel's parts of an iteration, in seconds."""

    evaluate: float
    factorise: float
    solve: float
    trial: float
    iteration: float  # all of them

    def least(self, other: LanesTime) -> LanesTime:
        """Part by part."""
        return LanesTime(*map(min, astuple(self), astuple(other)))


class _Iterate:
    """An iterate some steps after the first guess, and the same direction from it again and again."""

    def __init__(self, problem: mbocp.Problem, lanes: int) -> None:
        with _lanes(lanes):
            programme, guess = warm_guess(problem)
        solver = newton(problem, programme)
        state = solver.init(programme, guess)
        for _ in range(_STEPS):
            state = solver.step(state)
        self.native, self.augmentation, self.shift = state.native, state.augmentation, state.regularisation

    def measure(self, repetitions: int) -> LanesTime:
        native, times = self.native, []
        for _ in range(repetitions):
            marks = [time.process_time_ns()]
            native.evaluate()
            marks.append(time.process_time_ns())
            native.factorise(self.shift, self.augmentation)
            marks.append(time.process_time_ns())
            native.solve()
            marks.append(time.process_time_ns())
            native.trial(1e-3)
            marks.append(time.process_time_ns())
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
        iterates = [_Iterate(problem, lanes) for lanes in widths]
        rounds = [[i.measure(repetitions // _ROUNDS) for i in iterates] for _ in range(_ROUNDS)]
        best = [reduce(LanesTime.least, times) for times in zip(*rounds, strict=True)]
        for lanes, t in zip(widths, best, strict=True):
            parts = (
                f"{1e6 * s / problem.num_steps:.2f}" for s in (t.evaluate, t.trial, t.factorise, t.solve)
            )
            ratio = f"{best[0].iteration / t.iteration:.2f}"
            rows.append((case.label, str(lanes), *parts, f"{1e3 * t.iteration:.3f}", ratio))
    columns = ("problem", "lanes", "evaluate [us]", "trial [us]", "factorise [us]", "solve [us]")
    return Table(
        "Stages in lanes, times of a stage",
        (*columns, "iteration [ms]", "times as fast"),
        rows,
        f"Least processor times of {repetitions // _ROUNDS * _ROUNDS}; an iteration is the four parts, for "
        "all stages, without what Python adds.",
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lanes", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    options = parser.parse_args(arguments)
    one_core()
    show(lanes_table(), markdown=options.markdown)


if __name__ == "__main__":
    main()

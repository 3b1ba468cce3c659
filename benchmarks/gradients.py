"""What a gradient of an optimum takes, by iterations of its solve: `python -m benchmarks.gradients`.

Solves and gradients, `sensitivities` and `gradient(us=solution.us)`, take turns in one process. Times are
those of the processor; an iteration is a solve's by their number, with all that a solve does beside them.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.tables import Table, show

EXAMPLES = Path(__file__).parents[1] / "examples"
_ENDS = ("start.q", "goal.q")


class Case(NamedTuple):
    """A gradient: in what, of the optimum of which problem in how many steps."""

    label: str
    file: str
    steps: int
    wrt: tuple[str, ...]


CASES = (
    Case("start and goal, UR5", "arms/ur5_reach.toml", 50, _ENDS),
    Case("the same", "arms/ur5_reach.toml", 200, _ENDS),
    Case("start and goal, Panda", "arms/panda_reach.toml", 80, _ENDS),
    Case("the duration, UR5", "arms/ur5_reach.toml", 50, ("horizon.duration",)),
    Case("a payload's mass", "arms/payload.toml", 50, ("robot.payload.crate.mass",)),
    Case("start and goal within limits", "arms/ur5_limits.toml", 50, _ENDS),
    Case("start and limits of speeds", "arms/ur5_limits.toml", 50, ("start.q", "limits.velocity.upper")),
    Case("start of a four-bar", "loops/four_bar.toml", 100, ("start.q",)),
    Case("goal of a four-bar", "loops/four_bar.toml", 100, ("goal.q",)),
)


def row_of(case: Case, pairs: int) -> tuple[str, ...]:
    """Times of an iteration and of a gradient [ms], and the median of their quotients."""
    problem = mbocp.load_problem(EXAMPLES / case.file).with_(steps=case.steps)

    def gradient(solution: mbocp.Solution) -> Any:
        return mbocp.sensitivities(solution, case.wrt).gradient(us=solution.us)

    gradient(mbocp.solve(problem, check=True))
    iterations, gradients = np.empty(pairs), np.empty(pairs)
    for k in range(pairs):
        spent, solution = _timed(lambda: mbocp.solve(problem, check=True))
        iterations[k] = spent / solution.iterations
        gradients[k], _ = _timed(lambda solved=solution: gradient(solved))
    numbers = (1e3 * np.median(iterations), 1e3 * np.median(gradients), np.median(gradients / iterations))
    return case.label, str(case.steps), *(f"{number:.2f}" for number in numbers)


def _timed(work: Callable[[], Any]) -> tuple[float, Any]:
    begin = time.process_time()
    found = work()
    return time.process_time() - begin, found


def main() -> None:
    """Print a row for each case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pairs", type=int, default=25)
    pairs = parser.parse_args().pairs
    one_core()
    show(header())
    columns = ("in", "steps", "an iteration [ms]", "a gradient [ms]", "iterations a gradient")
    show(Table("Gradients", columns, [row_of(case, pairs) for case in CASES]))


if __name__ == "__main__":
    main()

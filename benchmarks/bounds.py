"""How near lower bounds are to what is found: `python -m benchmarks.bounds --count 200`."""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.minimum_time import Limits, pairs, problem_of
from benchmarks.tables import Table, present
from mbocp.problem import Problem
from mbocp.robot import Robot

_DOCS = Path(__file__).parent / "measured" / "bounds.md"
_BEGIN = "<!-- tables: python -m benchmarks.bounds --docs -->"
_STEPS = 60
Draw = Callable[[int, int], Iterator[Problem]]  # so many tasks, of a seed
_ROBOTS = Path(__file__).parent.parent / "examples" / "optima" / "robots"


def minimum_times(limits: Limits) -> Draw:
    """UR5 from rest to rest between random configurations."""

    def draw(count: int, seed: int) -> Iterator[Problem]:
        for pair in pairs("ur5", count, seed):
            yield problem_of("ur5", pair, limits, _STEPS)

    return draw


def efforts(name: str, duration: float, way: float, **limits: Any) -> Draw:
    """From rest to rest, from random configurations by random ways, for the least squared efforts."""

    def draw(count: int, seed: int) -> Iterator[Problem]:
        rng, robot = np.random.default_rng(seed), load(name)
        for _ in range(count):
            q0 = rng.uniform(-1.5, 1.5, robot.nq)
            q1 = q0 + way * rng.uniform(-1.0, 1.0, robot.nq)
            yield Problem.create(
                robot,
                duration,
                _STEPS,
                start={"q": q0},
                goal={"q": q1, "v": 0},
                cost={"effort": 1.0},
                limits=limits,
                scheme="midpoint",
            )

    return draw


def load(name: str) -> Robot:
    path = _ROBOTS / f"{name}.urdf"
    return mbocp.load_robot(path if path.exists() else name, damping=False)


TASKS: Mapping[str, Draw] = {
    "least time: UR5 within accelerations, speeds, torques": minimum_times(Limits(acceleration=True)),
    "least time: UR5 within speeds, torques": minimum_times(Limits()),
    "efforts: two carts, 1 s": efforts("two_carts", 1.0, 1.0),
    "efforts: double pendulum, 0.2 s": efforts("double_pendulum_simple", 0.2, 0.2, velocity=3.0),
    "efforts: double pendulum, 1 s": efforts("double_pendulum_simple", 1.0, 0.5, velocity=3.0),
    "efforts: UR5, 1 s, 0.1 rad/s": efforts("ur5", 1.0, 0.05, velocity=0.1),
    "efforts: UR5, 1 s, 1 rad/s": efforts("ur5", 1.0, 0.5, velocity=1.0),
}


def measure(problems: Iterator[Problem], starts: int) -> tuple[str, ...]:
    """Gaps and times of some tasks; a bound above what was found by more than the steps' error is counted.

    What was found is the best of several starts.
    """
    gaps, seconds, failed, above = [], [], 0, 0
    for problem in problems:
        solution = mbocp.solve(problem.with_(solver={"starts": starts}))
        if not solution.is_stationary:
            failed += 1
            continue
        begun = time.process_time()
        found = mbocp.bound(solution)
        seconds.append(time.process_time() - begun)
        is_time = problem.duration_range is not None
        gaps.append(1.0 - found.duration / solution.duration if is_time else found.gap)
        above += gaps[-1] < (-1e-7 if "discretised" in found.of else -1e-3)
    shown = 100.0 * np.percentile(gaps, [0, 10, 50, 90, 100])
    return (
        str(len(gaps)),
        str(failed),
        " / ".join(f"{value:.3g}" for value in shown),
        str(above),
        f"{np.median(seconds):.2g}",
    )


def table(kind: str, count: int, starts: int, seed: int) -> Table:
    lines = []
    for name in (name for name in TASKS if name.startswith(kind)):
        lines.append((name, *measure(TASKS[name](count, seed), starts)))
        print(*lines[-1], sep=" | ", flush=True)
    columns = ("tasks", "solved", "not", "gap [%]: least / 10 % / median / 90 % / most", "above", "bound [s]")
    note = (
        f"{count} random tasks each, seed {seed}, {_STEPS} steps, the best of {starts} starts; seconds of "
        "the processor. Above: by more than the error of the steps."
    )
    return Table("Lower bounds", columns, lines, note)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bounds", description=__doc__)
    parser.add_argument("--docs", action="store_true", help=f"rewrite the tables of {_DOCS.name}")
    parser.add_argument("--count", type=int, default=200, help="tasks of each kind")
    parser.add_argument("--kind", default="", choices=("", "least time", "efforts"), help="all by default")
    parser.add_argument("--starts", type=int, default=1, help="of each solve")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    one_core()
    tables = [header()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tables.append(table(options.kind, options.count, options.starts, options.seed))
    present(tables, _DOCS, _BEGIN, into_page=options.docs)


if __name__ == "__main__":
    main()

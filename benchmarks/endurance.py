"""Memory over a long run of one process: `python -m benchmarks.endurance`.

Many shapes are compiled and solved, again and again; then one shape is solved thousands of times. What the
process holds is read after each lap.
"""

from __future__ import annotations

import argparse
import gc
import itertools
import os
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.tables import Table, show

__all__ = ["shapes", "shapes_table", "solves_table"]

_LAPS = 10
_PAGE = os.sysconf("SC_PAGE_SIZE")
_SCHEMES = ("se1", "se2", "midpoint", "heun", "rk4")
_ENDS = ((0,), (1,), (0, 1))
_COSTS = tuple(itertools.product((0.0, 1.0), repeat=4))


def _resident() -> float:
    """Memory that the process holds [MB], after Python has thrown away what it can."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE / 1e6


def _handles() -> int:
    return sum(1 for _ in Path("/proc/self/fd").iterdir()) + threading.active_count()


def shapes(number: int) -> Iterator[mbocp.Problem]:
    """Problems of the double pendulum, no two of which share their functions."""
    robot = mbocp.load_robot("double_pendulum")
    names = [label.name for label in robot.v_labels]
    every = itertools.product(_SCHEMES, _COSTS, _ENDS)
    for scheme, (velocity, potential, tracking, rate), ends in itertools.islice(every, number):
        yield mbocp.Problem.create(
            robot,
            0.5,
            10,
            start={"q": [0.3, -0.2]},
            goal={"q": {names[i]: 0.1 for i in ends}, "v": [0.0, 0.0]},
            cost={
                "velocity": velocity,
                "potential": potential,
                "tracking": tracking,
                "control_rate": rate,
                "target": {"q": [0.1, 0.1]},
            },
            integrator={"scheme": scheme},
        )


def shapes_table(number: int) -> Table:
    """Memory while `number` shapes are compiled and solved, and over further laps through all of them."""
    problems = list(shapes(number))
    rows, begin = [], _resident()
    for lap in range(4):
        clock, converged = time.perf_counter(), 0
        for problem in problems:
            converged += mbocp.solve(problem).converged
        now = _resident()
        rows.append(
            (
                "compiled" if lap == 0 else f"again, lap {lap}",
                f"{converged} / {len(problems)}",
                f"{now:.1f}",
                f"{1e3 * (now - begin) / len(problems):.0f}",
                f"{_handles()}",
                f"{time.perf_counter() - clock:.0f}",
            )
        )
        begin = now
    head = ("lap", "converged", "memory [MB]", "growth [kB a shape]", "files and threads", "time [s]")
    return Table(f"{number} shapes in one process", head, rows, "Resident memory after each lap.")


def solves_table(number: int) -> Table:
    """Memory over `number` solves of a UR5 within its limits, from random starts to random goals."""
    robot, rng = mbocp.load_robot("ur5"), np.random.default_rng(0)
    mbocp.solve(_reach(robot, rng), solver="ipopt")  # a solve that needs IPOPT loads its libraries, once
    rows, first = [], 0.0
    for lap in range(_LAPS):
        clock, converged, size = time.perf_counter(), 0, number // _LAPS
        for _ in range(size):
            converged += mbocp.solve(_reach(robot, rng)).converged
        now = _resident()
        first = first or now
        change = f"{100.0 * (now / first - 1.0):+.2f}"
        seconds = f"{time.perf_counter() - clock:.0f}"
        rows.append(
            (f"{(lap + 1) * size}", f"{converged} / {size}", f"{now:.1f}", change, f"{_handles()}", seconds)
        )
    head = ("solves", "converged", "memory [MB]", "change [%]", "files and threads", "time [s]")
    return Table(f"{number} solves in one process", head, rows, "UR5 within its limits, 15 to 24 steps.")


def _reach(robot: mbocp.Robot, rng: np.random.Generator) -> mbocp.Problem:
    q0, q1 = rng.uniform(-1.0, 1.0, (2, 6))
    return mbocp.Problem.create(
        robot,
        2.0,
        int(rng.integers(15, 25)),
        start={"q": q0},
        goal={"q": q1, "v": np.zeros(6)},
        cost={"velocity": 10.0},
        limits={"effort": True, "velocity": True},
        scheme="se1",
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.endurance", description=__doc__)
    parser.add_argument("--markdown", action="store_true", help="for the documentation")
    parser.add_argument("--solves", type=int, default=10_000)
    parser.add_argument("--shapes", type=int, default=200, help=f"at most {15 * len(_COSTS)}")
    options = parser.parse_args(arguments)
    one_core()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        show(header(), markdown=options.markdown)
        show(shapes_table(options.shapes), markdown=options.markdown)
        show(solves_table(options.solves), markdown=options.markdown)


if __name__ == "__main__":
    main()

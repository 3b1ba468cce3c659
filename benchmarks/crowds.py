"""A UR5 among 10 to 5000 boxes: `python -m benchmarks.crowds`. Seconds of the processor, and the most memory.

A wall is in its way. Boxes stand anywhere in a room of 3 x 3 x 2 m, but farther than 6 cm from the arm on
its straight line.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.spatial  # noqa: F401  # its import takes a second, once

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.tables import Table, show
from mbocp._arrays import Array
from mbocp.guesses.around import near_the_way
from mbocp.problem import Problem
from mbocp.problem.obstacles.approach import nearest_approach
from mbocp.problem.obstacles.pair_clearances import WaySize
from mbocp.robot import Robot, load_robot

COUNTS = (10, 100, 1000, 5000)
_DURATION, _STEPS = 2.5, 40  # [s]
_START = np.array([-0.9, -0.9, 1.2, -1.8, -1.57, 0.0])
_GOAL = np.array([0.9, -0.9, 1.2, -1.8, -1.57, 0.0])
_LOW, _HIGH = np.array([-1.5, -1.5, -0.5]), np.array([1.5, 1.5, 1.5])  # [m]
_SIDES = (0.02, 0.06)  # [m]
_FREE = 0.06  # [m]
_RESERVE = 0.01  # [m]
_WALL = {"name": "wall", "shape": "box", "position": [0.6, 0.0, 0.1], "size": [0.5, 0.02, 0.3]}
_SIZE = WaySize(step=0.2, resolution=0.05, most=200, cuts=50)


def crowd(count: int, seed: int = 0) -> list[dict[str, Any]]:
    """That many boxes."""
    rng, robot = np.random.default_rng(seed), load_robot("ur5")
    balls = np.vstack([_balls(robot, _START + s * (_GOAL - _START)) for s in np.linspace(0.0, 1.0, 40)])
    found: list[dict[str, Any]] = [_WALL]
    while len(found) < count:
        at, size = rng.uniform(_LOW, _HIGH), rng.uniform(*_SIDES, 3)
        away = np.linalg.norm(np.maximum(np.abs(balls[:, :3] - at) - size / 2.0, 0.0), axis=1) - balls[:, 3]
        if away.min() > _FREE:
            place = {"position": at.tolist(), "size": size.tolist()}
            found.append({"name": f"box {len(found)}", "shape": "box", **place})
    return found


def _balls(robot: Robot, q: Array) -> Array:
    """Centres and radii of all spheres [m]."""
    return np.array(
        [
            [*robot.frame_placement(link.link, q).act(np.array(center)), radius]
            for link in robot.collision_spheres
            for center, radius in zip(link.centers, link.radii, strict=True)
        ]
    )


def problem_of(boxes: list[dict[str, Any]]) -> Problem:
    """From rest to rest among boxes."""
    return Problem.create(
        "ur5",
        _DURATION,
        _STEPS,
        start={"q": _START},
        goal={"q": _GOAL, "v": 0},
        cost={"effort": 1e-3, "velocity": 0.1},
        obstacle=boxes,
        scheme="se1",
    )


def crowd_table(counts: Sequence[int] = COUNTS) -> Table:
    """A row for each count."""
    rows, few = [], problem_of(crowd(1))
    ts, shares = np.linspace(0.0, _DURATION, _STEPS + 1), np.linspace(0.0, 1.0, _STEPS + 1)[:, None]
    ranges = np.stack([np.full(6, -np.pi), np.full(6, np.pi), np.full(6, 1.0)])
    for count in counts:
        boxes, clock = crowd(count), _Clock()
        made = few.with_(obstacle=boxes)
        times, clearance = [clock.lap()], made.clearance
        assert clearance is not None
        near_the_way(made)
        times.append(clock.lap())
        nearest_approach(clearance, ts, _START + shares * (_GOAL - _START))
        times.append(clock.lap())
        clearance.way(np.stack([_START, _GOAL]), ranges, _RESERVE, 0, _SIZE)
        times.append(clock.lap())
        solution = mbocp.solve(made)
        times.append(clock.lap())
        most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        told = [f"{time:.3g}" for time in times]
        rows.append((str(count), str(clearance.num_pairs), *told, str(solution.status), f"{most:.0f}"))
    names = (
        "boxes",
        "pairs",
        "problem [s]",
        "rows [s]",
        "check [s]",
        "way [s]",
        "solve [s]",
        "",
        "memory [MB]",
    )
    note = "problem: pairs that may meet; rows: which of them have some; check: of the line, between nodes"
    return Table("A UR5 among boxes", names, rows, note)


class _Clock:
    """Seconds of the processor from lap to lap."""

    def __init__(self) -> None:
        self.last = time.process_time()

    def lap(self) -> float:
        before, self.last = self.last, time.process_time()
        return self.last - before


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.crowds", description=__doc__)
    parser.add_argument("counts", type=int, nargs="*", default=list(COUNTS))
    options = parser.parse_args()
    one_core()
    show(header())
    show(crowd_table(options.counts))


if __name__ == "__main__":
    main()

"""Random poses of a tool as goals, within all limits of the URDF: `python -m benchmarks.poses`."""

from __future__ import annotations

import argparse
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from statistics import median, quantiles

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.tables import Table, present
from mbocp.exceptions import MbocpError
from mbocp.problem import Problem

__all__ = ["pose_tasks", "poses_table"]

_PAGE = Path(__file__).parent / "measured" / "poses.md"
_BEGIN = "<!-- tables: python -m benchmarks.poses --docs -->"
_STEPS = 60
_FINGERS = {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02}
_ARMS = {"ur5": ("tool0", {}), "panda": ("panda_hand_tcp", _FINGERS)}


def pose_tasks(name: str, number: int, seed: int = 0, starts: int = 1) -> Iterator[Callable[[], Problem]]:
    """What makes the problems: rest to rest from a random configuration to the pose of the tool at another.

    The duration is half a second more than 1.6 times what the slowest joint takes between the two at full
    speed, so that the goal is reachable and the motion is no idle one.
    """
    rng = np.random.default_rng(seed)
    frame, locked = _ARMS[name]
    robot = mbocp.load_robot(name, lock=locked, damping=False)
    limits = robot.limits
    lower, upper = np.maximum(limits.position_lower, -np.pi), np.minimum(limits.position_upper, np.pi)
    room = 0.05 * (upper - lower)
    for _ in range(number):
        q0, q1 = rng.uniform(lower + room, upper - room, (2, robot.nq))
        pose = robot.frame_placement(frame, q1)
        yield partial(
            Problem.create,
            robot,
            1.6 * float(np.max(np.abs(q1 - q0) / limits.velocity)) + 0.5,
            _STEPS,
            start={"q": q0},
            goal={"v": 0, "frame": {"name": frame, "position": pose.translation, "orientation": _xyzw(pose)}},
            cost={"effort": 1.0, "velocity": 100.0},
            limits={"effort": True, "velocity": True, "position": True},
            solver={"starts": starts},
        )


def _xyzw(pose: pin.SE3) -> np.ndarray:
    return np.asarray(pin.Quaternion(pose.rotation).coeffs())


def poses_table(number: int, starts: Sequence[int] = (1, 4), seed: int = 0) -> Table:
    """How many goals are reached, from cold, and in what time."""
    rows = []
    for name in _ARMS:
        for count in starts:
            seconds, iterations = [], []
            ends: Counter[str] = Counter()
            for make in pose_tasks(name, number, seed, count):
                begun = time.perf_counter()
                try:
                    solution = mbocp.solve(make())
                except MbocpError as error:
                    ends[type(error).__name__] += 1
                    continue
                seconds.append(time.perf_counter() - begun)
                iterations.append(solution.iterations)
                ends[solution.status] += 1
            good = ends.pop("converged", 0)
            rest = ", ".join(f"{key} {n}" for key, n in ends.most_common()) or "none"
            ms = [1e3 * s for s in seconds[1:]]
            rows.append(
                (
                    name,
                    str(count),
                    f"{good} of {number} ({100 * good / number:.1f} %)",
                    rest,
                    f"{median(iterations):.0f}",
                    f"{median(ms):.0f}",
                    f"{quantiles(ms, n=10)[-1]:.0f}",
                )
            )
            print(*rows[-1], sep=" | ", flush=True)
    columns = ("arm", "starts", "converged", "others", "iterations", "median [ms]", "90 % [ms]")
    note = (
        f"{_STEPS} steps; efforts, velocities and positions within the limits of the URDF. Wall time "
        "from the pose to the solution: `Problem.create` with its inverse kinematics, and `mbocp.solve` with "
        "guess and diagnostics. Robots were loaded and functions compiled before, one shape for each arm."
    )
    return Table("Random poses of the tool", columns, rows, note)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, or put it into the measured ones."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.poses", description=__doc__)
    parser.add_argument("--docs", action="store_true", help=f"rewrite the tables of measured/{_PAGE.name}")
    parser.add_argument("--number", type=int, default=1000, help="goals of each arm")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--starts", type=int, nargs="+", default=[1, 4])
    options = parser.parse_args(arguments)
    one_core()
    tables = [header()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tables.append(poses_table(options.number, options.starts, options.seed))
    present(tables, _PAGE, _BEGIN, into_page=options.docs)


if __name__ == "__main__":
    main()

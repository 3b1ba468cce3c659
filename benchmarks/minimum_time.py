"""Arms in minimum time, beside TOPP-RA on the straight line: `python -m benchmarks.minimum_time`."""

from __future__ import annotations

import argparse
import time
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.straight_path import fastest_on_line, has_toppra, slowest_joint_alone
from benchmarks.tables import Table, present
from mbocp._arrays import Array
from mbocp.problem import Problem
from mbocp.robot import Robot

__all__ = ["ARMS", "Limits", "Pair", "largest_torques", "minimum_time_table", "pairs", "problem_of"]

_DOCS = Path(__file__).parent / "measured" / "minimum_time.md"
_BEGIN = "<!-- tables: python -m benchmarks.minimum_time --docs -->"
_STEPS = 200
_TOLERANCE = 1e-7  # with so small a cost of effort round-off leaves no better one to some of them
_EFFORT = 1e-5  # 1/(N m)^2 s: what time leaves open takes little torque
_SAME = 1e-4  # relative: durations that the steps do not tell apart
_EXCESS = 5e-3  # of a torque at the nodes, beyond its limit
_ROUNDS = 5  # of solves with lower limits, until torques are within that


@dataclass(frozen=True, eq=False)
class Arm:
    """An arm and the limits that its URDF does not have.

    Attributes
    ----------
    locked : mapping of str to float
        Joints that are rigid [m].
    acceleration, jerk : tuple of float
        Limits by joint [rad/s^2, rad/s^3].
    """

    locked: Mapping[str, float]
    acceleration: tuple[float, ...]
    jerk: tuple[float, ...]


@dataclass(frozen=True)
class Limits:
    """Which limits hold beside those of the URDF: positions, velocities and torques."""

    acceleration: bool = False
    jerk: bool = False

    @property
    def words(self) -> str:
        """What they are called."""
        added = [name for name in ("acceleration", "jerk") if getattr(self, name)]
        return ", ".join(("torque, velocity", *added))


@dataclass(frozen=True, eq=False)
class Pair:
    """Where a motion begins and ends [rad]."""

    robot: Robot
    q0: Array
    q1: Array


# Panda: the maker's accelerations, and a tenth of its jerks. UR5: round numbers, the maker publishes none.
ARMS: Mapping[str, Arm] = {
    "ur5": Arm({}, (15.0,) * 6, (150.0,) * 6),
    "panda": Arm(
        {"panda_finger_joint1": 0.02, "panda_finger_joint2": 0.02},
        (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),
        (750.0, 375.0, 500.0, 625.0, 750.0, 1000.0, 1000.0),
    ),
}
_ALL_LIMITS = (Limits(), Limits(acceleration=True), Limits(acceleration=True, jerk=True))


@cache
def _robot(name: str) -> Robot:
    """Without viscous damping, which TOPP-RA does not know."""
    return mbocp.load_robot(name, lock=ARMS[name].locked, damping=False)


def pairs(name: str, number: int, seed: int = 0) -> Iterator[Pair]:
    """Random configurations within the position limits of the URDF and half a turn, 5 % off both."""
    rng, robot = np.random.default_rng(seed), _robot(name)
    lower = np.maximum(robot.limits.position_lower, -np.pi)
    upper = np.minimum(robot.limits.position_upper, np.pi)
    room = 0.05 * (upper - lower)
    for _ in range(number):
        q0, q1 = rng.uniform(lower + room, upper - room, (2, robot.nq))
        yield Pair(robot, q0, q1)


def bound_of(name: str, pair: Pair, limits: Limits) -> float:
    """Duration [s] of the slowest joint alone; jerks are left out."""
    acceleration = np.array(ARMS[name].acceleration) if limits.acceleration else None
    return slowest_joint_alone(pair.q1 - pair.q0, pair.robot.limits.velocity, acceleration)


def problem_of(
    name: str, pair: Pair, limits: Limits, steps: int = _STEPS, effort: Array | None = None
) -> Problem:
    """From rest to rest in minimum time, between half the bound and eight times it.

    Parameters
    ----------
    effort : ndarray, shape (n,), optional
        Limits of the torques [N m] in place of the robot's own.
    """
    bound, arm = bound_of(name, pair, limits), ARMS[name]
    torques = True if effort is None else list(effort)
    asked: dict[str, Any] = {"effort": torques, "velocity": True, "position": True}
    asked |= {key: list(getattr(arm, key)) for key in ("acceleration", "jerk") if getattr(limits, key)}
    return Problem.create(
        pair.robot,
        {"min": 0.5 * bound, "max": 8.0 * bound},
        steps,
        start={"q": pair.q0},
        goal={"q": pair.q1, "v": np.zeros(pair.robot.nv), "a": "free"},
        cost={"time": 1.0, "effort": _EFFORT},
        limits=asked,
        integrator={"scheme": "midpoint"},
        solver={"method": "monolithic", "tolerance": _TOLERANCE},
    )


def largest_torques(robot: Robot, solution: mbocp.Solution) -> Array:
    """Largest torques by their limits, at both ends of every step, by inverse dynamics; shape (n,).

    The scheme keeps the limits in the middle of the steps.
    """
    qs, vs = solution.qs, solution.vs
    accelerations = np.diff(vs, axis=0) / np.diff(solution.t)[:, None]
    data = robot.model.createData()
    found = [
        np.abs(pin.rnea(robot.model, data, qs[at], vs[at], acceleration))
        for n, acceleration in enumerate(accelerations)
        for at in (n, n + 1)
    ]
    return np.asarray(np.max(found, axis=0) / robot.limits.effort)


def within_torques(
    name: str, pair: Pair, limits: Limits, steps: int, solution: mbocp.Solution
) -> mbocp.Solution:
    """A solution whose torques hold at the nodes, too: solved again with lower limits where they do not."""
    lowered = np.array(pair.robot.limits.effort)
    for _ in range(_ROUNDS):
        excess = largest_torques(pair.robot, solution)
        if not solution.converged or excess.max() <= 1.0 + _EXCESS:
            break
        lowered = lowered / np.maximum(excess, 1.0)
        solution = mbocp.solve(problem_of(name, pair, limits, steps, lowered))
    return solution


@dataclass(frozen=True)
class Row:
    """What one motion came to: durations [s], torques by their limits, status, iterations, wall time [s]."""

    status: str
    duration: float
    straight: float
    bound: float
    torque: float
    torque_straight: float
    iterations: int
    seconds: float

    @property
    def gain(self) -> float:
        """By which part of the straight line's time it is shorter."""
        return 1.0 - self.duration / self.straight


def measure(name: str, pair: Pair, limits: Limits, steps: int) -> Row:
    """Solve one task, and time its straight line."""
    acceleration = np.array(ARMS[name].acceleration) if limits.acceleration else None
    straight = fastest_on_line(pair.robot, pair.q0, pair.q1, acceleration)
    begun = time.perf_counter()
    solution = mbocp.solve(problem_of(name, pair, limits, steps))
    seconds = time.perf_counter() - begun
    compared = within_torques(name, pair, limits, steps, solution)
    return Row(
        str(compared.status),
        compared.duration,
        straight.duration,
        bound_of(name, pair, limits),
        float(largest_torques(pair.robot, compared).max()),
        straight.torque,
        solution.iterations,
        seconds,
    )


def minimum_time_table(
    number: int, steps: int = _STEPS, seed: int = 0, names: Sequence[str] = tuple(ARMS)
) -> Table:
    """Converged, iterations and times, and durations beside those of the straight line."""
    lines = []
    for name in names:
        for limits in _ALL_LIMITS:
            rows = [measure(name, pair, limits, steps) for pair in pairs(name, number, seed)]
            lines.append((name, limits.words, *cells(rows)))
            print(*lines[-1], sep=" | ", flush=True)
    columns = ("arm", "limits", "converged", "iterations", "wall [ms]", "shorter by [%]")
    columns += ("never longer", "at the bound", "torque at nodes")
    note = (
        f"{number} random pairs of configurations each, {steps} steps, cold, tolerance {_TOLERANCE:g}. "
        "Iterations and wall time of `Problem.create` and `mbocp.solve`: median / 90 % / most. Shorter than "
        f"TOPP-RA {version('toppra')} on the straight line: median / mean / least / most; TOPP-RA knows no "
        f"jerk. Never longer: by no more than {100 * _SAME:g} %. At the bound: within {100 * _SAME:g} % of "
        "what the slowest joint takes alone, which no motion falls below. Torque at nodes: largest by its "
        "limit, mbocp / TOPP-RA."
    )
    return Table("Minimum time", columns, lines, note)


def cells(rows: Sequence[Row]) -> tuple[str, ...]:
    """What a line of the table says of its motions."""
    ends = Counter(row.status for row in rows)
    good = ends.pop("converged", 0)
    rest = "".join(f", {status} {count}" for status, count in ends.most_common())
    solved = [row for row in rows if row.status == "converged"]
    gains = 100.0 * np.array([row.gain for row in solved])
    shown = (np.median(gains), np.mean(gains), np.min(gains), np.max(gains))
    kept = sum(row.gain >= -_SAME for row in solved)
    bound = sum(row.duration <= (1.0 + _SAME) * row.bound for row in solved)
    torques = max(row.torque for row in solved), max(row.torque_straight for row in solved)
    return (
        f"{good} of {len(rows)}{rest}",
        _spread([row.iterations for row in rows]),
        _spread([1e3 * row.seconds for row in rows[1:] or rows]),  # the first compiles
        " / ".join(f"{value:.3f}" for value in shown),
        f"{kept} of {len(solved)}",
        f"{bound} of {len(solved)}",
        " / ".join(f"{value:.3f}" for value in torques),
    )


def _spread(values: Sequence[float]) -> str:
    shown = np.percentile(values, [50, 90, 100])
    return " / ".join(f"{value:.0f}" for value in shown)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table, or put it into the documentation."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.minimum_time", description=__doc__)
    parser.add_argument("--docs", action="store_true", help=f"rewrite the tables of {_DOCS.name}")
    parser.add_argument("--number", type=int, default=50, help="motions of each arm")
    parser.add_argument("--steps", type=int, default=_STEPS)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    if not has_toppra():
        raise SystemExit("this compares with TOPP-RA: pip install 'mbocp[bench]'")
    one_core()
    tables = [header()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tables.append(minimum_time_table(options.number, options.steps, options.seed))
    present(tables, _DOCS, _BEGIN, into_page=options.docs)


if __name__ == "__main__":
    main()

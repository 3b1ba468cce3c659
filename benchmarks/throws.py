"""A UR10 throws a ball into buckets four metres away: `python -m benchmarks.throws`.

A stick on the tool holds the ball at its end, and lets it go after a second; the ball flies for another
0.8 s. That is one problem of two phases, of which the first holds the ball. The flight is checked against the
parabola from where the ball is let go, with the velocity that the end of the stick has there.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from statistics import median

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header, one_core
from benchmarks.tables import Table, show
from mbocp import Problem, Solution
from mbocp._arrays import Array
from mbocp.robot import Robot, load_parts

__all__ = ["Flight", "buckets", "flight_of", "throw", "throws_table"]

GRAVITY = np.array([0.0, 0.0, -9.81])  # [m/s^2]
AWAY = 4.0  # [m] from the arm
LET_GO, FLIGHT = 25, 20  # steps
STEP = 0.04  # [s]
TOLERANCE = 0.08  # [m] of a bucket's opening, across
_STICK = 0.6  # [m]: the ball before the tool
_START = (0.0, -1.9, 1.6, -1.2, -1.57, 0.0)  # rad


@dataclass(frozen=True)
class Flight:
    """What a ball does that was let go.

    Attributes
    ----------
    off : float
        How far its place at the end is from that of the parabola of what the stick throws [m].
    beside : float
        How far it is from the middle of the bucket's opening, across [m].
    falls : float
        Its speed downwards there [m/s].
    slips : float
        What its velocity differs by from that of the end of the stick when it is let go [m/s].
    leaps : float
        What it changed by just before, in the step of no duration that ends the hold [m/s].
    """

    off: float
    beside: float
    falls: float
    slips: float
    leaps: float


@cache
def _cell() -> Robot:
    stick = {
        "name": "stick",
        "frame": "tool0",
        "mass": 0.25,
        "com": [0.0, 0.0, 0.28],
        "inertia": [0.0065, 0.0065, 1.5e-5, 0.0, 0.0, 0.0],
        "cylinder": [0.012, 0.56],
    }
    arm = {"name": "arm", "robot": "ur10", "position": [0.0, 0.0, 0.8], "payload": [stick]}
    return load_parts([arm, {"name": "ball", "mass": 0.2, "sphere": 0.04}])


def buckets(number: int, seed: int = 0) -> Iterator[Array]:
    """Middles of the openings of buckets, within a third of a turn and at various heights [m]."""
    rng = np.random.default_rng(seed)
    for _ in range(number):
        angle, height = rng.uniform(-1.0, 1.0), rng.uniform(0.2, 0.6)
        yield np.array([AWAY * np.cos(angle), AWAY * np.sin(angle), height])


def throw(bucket: Array, scheme: str = "midpoint", finer: int = 1) -> Problem:
    """The problem of one bucket, with `finer` times as many steps; the midpoint rule keeps the parabola."""
    cell = _cell()
    q = np.array(cell.q0)
    q[:6] = _START
    held = cell.frame_placement("arm/tool0", q).act(np.array([0.0, 0.0, _STICK]))
    ahead = [*(0.9 * bucket[:2] / AWAY).tolist(), 1.9]  # about where an arm lets go
    wide = {"position": ahead, "position_tolerance": 0.5}
    opening = [TOLERANCE, TOLERANCE, 0.005]
    lets_go = [{"name": "ball/body", **wide}, {"name": "arm/tool0", **wide}]
    grip = {"name": "grip", "frame": "ball/body", "to": "arm/tool0", "kind": "point"}
    return Problem.create(
        cell,
        phase=[
            {
                "name": "swing",
                "steps": LET_GO * finer,
                "duration": LET_GO * STEP,
                "hold": [grip],
                "via": [{"name": "let go", "frame": lets_go}],
            },
            {"name": "flight", "steps": FLIGHT * finer, "duration": FLIGHT * STEP},
        ],
        start={"q": {"arm": list(_START), "ball": [*held.tolist(), 0.0, 0.0, 0.0, 1.0]}},
        goal={
            "v": {"arm": [0.0] * 6},
            "frame": {"name": "ball/body", "position": bucket.tolist(), "position_tolerance": opening},
        },
        cost={"effort": 1e-4, "velocity": {"arm": [1e-2] * 6}},
        limits={"effort": True, "velocity": True},
        integrator={"scheme": scheme},
        solver="monolithic",
    )


def flight_of(problem: Problem, solution: Solution, bucket: Array) -> Flight:
    """Compare the flight with the parabola from the velocity of the stick, by Pinocchio and NumPy alone."""
    first = problem.holds[0].spans[0][1]
    at = solution.qs[:, 6:9]
    before, v = (_turned(solution.qs[n, 9:13]) @ solution.vs[n, 6:9] for n in (first - 1, first))
    thrown = _of_stick(problem.robot, solution.qs[first], solution.vs[first])
    T = solution.t[-1] - solution.t[first]
    parabola = at[first] + T * thrown + T**2 / 2.0 * GRAVITY
    return Flight(
        off=float(np.linalg.norm(at[-1] - parabola)),
        beside=float(np.abs(at[-1] - bucket)[:2].max()),
        falls=float(-(thrown + T * GRAVITY)[2]),
        slips=float(np.linalg.norm(v - thrown)),
        leaps=float(np.linalg.norm(v - before)),
    )


def _turned(quaternion: Array) -> Array:
    """Axes of the ball in the world, in which its velocity is."""
    x, y, z, w = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _of_stick(robot: Robot, q: Array, v: Array) -> Array:
    """Velocity of the point of the tool at which the ball is, in the world."""
    model, tool, held = robot.model, robot.frame_id("arm/tool0"), robot.frame_id("ball/body")
    data = model.createData()
    pin.forwardKinematics(model, data, q, v)
    pin.updateFramePlacements(model, data)
    twist = pin.getFrameVelocity(model, data, tool, pin.LOCAL_WORLD_ALIGNED)
    lever = data.oMf[held].translation - data.oMf[tool].translation
    velocity: Array = twist.linear + np.cross(twist.angular, lever)
    return velocity


def throws_table(number: int, seed: int = 0, scheme: str = "midpoint") -> Table:
    """How many throws land, how long each takes once the first has compiled, how exact the flight is."""
    seconds, flights, landed = [], [], 0
    for bucket in buckets(number, seed):
        problem = throw(bucket, scheme)
        clock = time.process_time()
        solution = mbocp.solve(problem)
        seconds.append(time.process_time() - clock)
        flights.append(flight_of(problem, solution, bucket))
        landed += solution.converged and flights[-1].beside <= TOLERANCE + 1e-9 and flights[-1].falls > 0.0
    row = (
        f"{landed} of {number}",
        f"{1e3 * median(seconds):.0f} ms",
        f"{1e3 * max(seconds[1:] or seconds):.0f} ms",
        f"{1e3 * max(flight.off for flight in flights):.2g} mm",
        f"{max(flight.slips for flight in flights):.2g} m/s",
        f"{max(flight.leaps for flight in flights):.2g} m/s",
    )
    titles = ("landed", "median", "slowest but the first", "off the parabola", "slips by", "leaps by")
    return Table("Throws", titles, [row])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.throws", description=__doc__)
    parser.add_argument("--buckets", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    one_core()
    show(header())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        show(throws_table(options.buckets, options.seed))


if __name__ == "__main__":
    main()

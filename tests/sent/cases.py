"""Random motions from rest to rest in the least time, within what makers publish, and what their files do."""

from __future__ import annotations

import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import ruckig

import mbocp
from mbocp.integrators.controls import ControlKind
from mbocp.problem import Problem
from mbocp.terms.over_speed import place_of
from tests.sent.reader import (
    ends_of_points,
    limits_of,
    violation_of_points,
    violation_of_samples,
)

PROFILES = Path(mbocp.__file__).parent / "profiles"
RATES = (125, 250, 500, 1000)  # samples a second
JERK = 150.0  # rad/s^3, of the UR5e, of which none is published
TOLERANCE = 2e-4  # of a limit, that differences of samples may leave it by
STEPS = 40
PANDA = {"name": "panda", "lock": {"panda_finger_joint1": 0, "panda_finger_joint2": 0}}
LEAST = {"time": 1.0, "effort": 1e-5}
# Of a UR5e no accelerations are published; inertias of both robots are those of the ones before them.
ROBOTS: dict[str, tuple[Any, dict[str, Any]]] = {
    "ur5e": ("ur5", {"profile": "ur5e", "acceleration": 15.0}),
    "fr3": (PANDA, {"profile": "fr3"}),
}


def problem_of(name: str, seed: int, *, with_torques: bool) -> Problem:
    """A random start and goal, at rest, well within the limits of positions."""
    robot, limits = ROBOTS[name]
    rng = np.random.default_rng([seed, sorted(ROBOTS).index(name)])
    if name == "ur5e":
        start = rng.uniform(-2.0, 2.0, 6)
        goal = np.clip(start + rng.uniform(-1.5, 1.5, 6), -3.0, 3.0)
    else:
        sides = limits_of(PROFILES / "fr3.toml")["position"]
        middle, half = sides.mean(axis=0), np.diff(sides, axis=0)[0] / 2.0
        start, goal = middle + rng.uniform(-0.7, 0.7, (2, 7)) * half
    if not with_torques:
        limits = {**limits, "effort": False, **({"effort_rate": False} if name == "fr3" else {})}
    return Problem.create(
        robot,
        {"min": 0.2, "max": 5.0},
        STEPS,
        start={"q": start},
        goal={"q": goal, "v": 0},
        limits=limits,
        cost=LEAST,
    )


def row_of(
    name: str, seed: int, *, controls: ControlKind = "constant", with_torques: bool = False
) -> dict[str, Any]:
    """Solve, write, read back."""
    problem = problem_of(name, seed, with_torques=with_torques).with_(controls=controls)
    begun = time.process_time()
    solution = mbocp.solve(problem)
    row = {
        "robot": name,
        "seed": seed,
        "status": str(solution.status),
        "iterations": solution.iterations,
        "seconds": time.process_time() - begun,
        "found": solution.duration,
        "least": least_time(problem),
        "excess": solution.limit_excess,
    }
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        row |= violations(solution, Path(folder), name)
    return row


def violations(solution: mbocp.Solution, folder: Path, name: str) -> dict[str, Any]:
    """What written files leave of the limits, by a reader of their own."""
    limits = limits_of(PROFILES / f"{name}.toml", **({"acceleration": 15.0} if name == "ur5e" else {}))
    worst: dict[str, float] = {}
    for rate in RATES:
        file = solution.export(folder / f"{rate}.csv", rate=float(rate), check=False)
        found = violation_of_samples(file, float(rate), limits)
        worst |= {f"{kind} {rate}": value for kind, value in found.items()}
    file = solution.export(folder / "points.yaml", check=False)
    worst |= {f"{kind} points": value for kind, value in violation_of_points(file, limits).items()}
    speed, acceleration = ends_of_points(file)
    sent = float((folder / "1000.csv").read_text().splitlines()[-1].split(",")[0])
    return {"violations": worst, "sent": sent, "end_speed": speed, "end_acceleration": acceleration}


def least_time(problem: Problem) -> float:
    """The exact optimum without torques: of the slowest joint, by Ruckig, or by `time_to_brake` [s]."""
    limits, count = problem.limits, problem.robot.nv
    planner, given, found = ruckig.Ruckig(count), ruckig.InputParameter(count), ruckig.Trajectory(count)
    given.current_position, given.target_position = problem.q_start.tolist(), problem.goal.q.tolist()
    given.max_velocity = limits.v_upper.tolist()
    given.max_acceleration = limits.a_upper.tolist()
    given.max_jerk = limits.j_upper.tolist()
    given.synchronization = ruckig.Synchronization.No
    result = planner.calculate(given, found)
    if result != ruckig.Result.Working:
        raise ValueError(f"Ruckig: {result}")
    times = [float(found.duration)]
    for path in (path for path in problem.frame_constraints if path.kind == "braking"):
        k = place_of(path.frame, problem.robot)
        ends, sides = (problem.q_start[k], problem.goal.q[k]), (max(path.lower), min(path.upper))
        braking = float(path.number("reserve")[0]), float(path.number("deceleration")[0])
        times.append(
            time_to_brake(ends, sides, braking, (limits.v_upper[k], limits.a_upper[k], limits.j_upper[k]))
        )
    return max(times)


def time_to_brake(
    ends: tuple[float, float],
    sides: tuple[float, float],
    braking: tuple[float, float],
    limits: tuple[float, float, float],
) -> float:
    """Least time of a joint from rest to rest whose speed falls towards the limits of its position [s].

    In the plane of position and speed: no faster than the limits, than it can have become, and than it can
    brake from. Ramps of the acceleration a take a / j in all; corners between them, where speeds are high,
    are left out: 1e-5 of the time, but more of ways that are hardly longer than these ramps.

    Parameters
    ----------
    ends, sides : tuple of float
        Of the motion, and limits of the position [rad].
    braking : tuple of float
        Reserve and deceleration [rad/s, rad/s^2].
    limits : tuple of float
        Of speed, acceleration and jerk [rad/s, rad/s^2, rad/s^3].
    """
    (reserve, slowing), (speed, acceleration, jerk) = braking, limits
    is_upwards = ends[1] > ends[0]
    room, way = sides[1] - ends[0] if is_upwards else ends[0] - sides[0], abs(ends[1] - ends[0])
    x = way * (1.0 - np.cos(np.linspace(0.0, np.pi, 20001))) / 2.0
    allowed = np.sqrt(2.0 * slowing * np.maximum(room - x, 0.0)) - reserve
    squares = np.clip(allowed, 0.0, speed) ** 2
    squares[[0, -1]] = 0.0
    gained = 2.0 * acceleration * x
    squares = gained + np.minimum.accumulate(squares - gained)
    squares = np.minimum.accumulate((squares + gained)[::-1])[::-1] - gained
    v = np.sqrt(np.maximum(squares, 0.0))
    return float((2.0 * np.diff(x) / (v[1:] + v[:-1])).sum() + acceleration / jerk)

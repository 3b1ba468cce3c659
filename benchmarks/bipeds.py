"""Steps and walks of bipeds on flat soles, from the default guess: `python -m benchmarks.bipeds`.

A step of one foot, by up to 0.3 m ahead or back and 0.1 m outwards, between two stands; a walk of four steps
with stands between, to up to 0.36 m ahead or back and half as far to the side, turned by up to 0.3 rad.
From rest to rest, within limits of positions, and of efforts where the robot's file has some. Arms and waist
of g1 are locked, and its knees bent at the start.
"""

from __future__ import annotations

import argparse
import time
import warnings
from typing import Any

import numpy as np
import pinocchio as pin

import mbocp
from benchmarks.machine import header
from benchmarks.tables import Table, show
from mbocp._arrays import Array
from mbocp.problem import Problem
from mbocp.robot import Robot, load_robot

__all__ = ["MOTIONS", "ROBOTS", "biped_table", "motion"]

MOTIONS = ("step", "walk")
ROBOTS = {  # soles, sides of these [m], base, weight of efforts
    "talos_legs": ("{}_sole_link", [0.2, 0.12], "base_link", 1e-3),
    "g1": ("{}_ankle_roll_link", [0.16, 0.05], "pelvis", 1e-2),
}
_SIDES = ("left", "right")
_FARTHEST, _TURN = 0.3, 0.3  # [m], [rad]
_LOCKED = ("waist", "shoulder", "elbow", "wrist")
_BENT = {"hip_pitch": -0.35, "knee": 0.7, "ankle_pitch": -0.35}  # [rad]


def motion(name: str, number: int, robot_name: str) -> Problem:
    """One motion; it depends on nothing but its name and number, and the robot."""
    rng = np.random.default_rng([number, MOTIONS.index(name)])
    length, heading, turn = rng.uniform([0.0, -np.pi, -_TURN], [_FARTHEST, np.pi, _TURN])
    robot, q = _standing(robot_name)
    sole, sides, _, weight = ROBOTS[robot_name]
    if name == "step":
        place = length * np.cos(heading), 0.1 * abs(np.sin(heading))
        told = _step(robot, q, _SIDES[number % 2], place, robot_name)
    else:
        goal = np.array(q)
        goal[:2] += 1.2 * length * np.array([np.cos(heading), 0.5 * np.sin(heading)])
        goal[3:7] = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, 0.0, turn)).coeffs()
        gait = {"swings": [["left"], ["right"]], "cycles": 2, "duration": 0.5, "steps": 12, "stance": 0.2}
        told = {"gait": gait, "goal": {"v": 0, "q": goal}}
    return Problem.create(
        robot,
        ground={"feet": {s: sole.format(s) for s in _SIDES}, "friction": 0.7, "sole": sides, "lift": 0.04},
        start={"q": q},
        cost={"effort": weight, "velocity": 1.0},
        limits={"position": True, **({"effort": True} if robot_name == "g1" else {})},
        scheme="se1",
        **told,
    )


def _standing(name: str) -> tuple[Robot, Array]:
    """A robot, and how it begins."""
    robot = load_robot(name)
    if name != "g1":
        return robot, np.array(robot.q0)
    lock = {joint: 0.0 for joint in robot.joint_names if any(word in joint for word in _LOCKED)}
    robot = load_robot(name, lock=lock)
    q = np.array(robot.q0)
    for side in _SIDES:
        for joint, angle in _BENT.items():
            q[robot.configuration_indices(f"{side}_{joint}_joint")] = angle
    return robot, q


def _step(robot: Robot, q: Array, side: str, way: tuple[float, float], name: str) -> dict[str, Any]:
    """Phases and goal of a step of one foot, ahead and outwards [m]."""
    sole, _, base, _ = ROBOTS[name]
    frame, out = sole.format(side), 1.0 if side == "left" else -1.0
    at = robot.frame_placement(frame, q).translation
    lands = {"name": frame, "x": float(at[0] + way[0]), "y": float(at[1] + out * way[1])}
    (other,) = set(_SIDES) - {side}
    phases = [
        {"name": "shift", "steps": 12, "duration": 0.5, "contacts": [*_SIDES]},
        {"name": "step", "steps": 16, "duration": 0.6, "contacts": [other], "via": [{"frame": lands}]},
        {"name": "stand", "steps": 12, "duration": 0.5, "contacts": [*_SIDES]},
    ]
    return {"phase": phases, "goal": {"v": 0, "frame": {"name": base, "x": float(q[0] + way[0] / 2)}}}


def biped_table(names: list[str], count: int) -> Table:
    """Success, iterations and time, a line for each robot and motion."""
    rows = []
    for robot_name in names:
        for name in MOTIONS:
            good, iterations, seconds = 0, [], []
            for number in range(count):
                begun = time.process_time()
                solution = mbocp.solve(motion(name, number, robot_name), time_limit=240.0)
                good += solution.converged
                iterations.append(solution.iterations)
                seconds.append(time.process_time() - begun)
            spread = [np.quantile(values, [0.5, 0.9, 1.0]) for values in (iterations, seconds)]
            told = (", ".join(f"{x:.0f}" for x in spread[0]), ", ".join(f"{x:.1f}" for x in spread[1]))
            rows.append((robot_name, name, str(count), str(good), *told))
    columns = ("", "", "motions", "converged", "iterations: median, 90 %, most", "s of a processor")
    return Table(
        "Bipeds", columns, rows, "Times with what it takes to load the robot, of the first with functions."
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.bipeds", description=__doc__)
    parser.add_argument("--count", type=int, default=15, help="of each motion")
    parser.add_argument("--markdown", action="store_true")
    parser.add_argument("--robots", nargs="+", choices=[*ROBOTS], default=[*ROBOTS])
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    for table in (header(), biped_table(options.robots, options.count)):
        show(table, markdown=options.markdown)


if __name__ == "__main__":
    main()

"""Bases on wheels with and without arms, written at 1 kHz and read back: `python -m tests.sent.bases`.

Slip across the heading, steps of the heading and places of tools are those of the files' positions.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import mbocp
from mbocp.problem import Problem
from mbocp.robot import Robot
from tests.sent.reader import samples_of

RATE = 1000.0  # samples a second
MOST_SLIP = 1.2e-3  # [m/s], of differences: exports leave 1 mm/s
UP = [0, -1.57, 1.57, -1.57, -1.57, 0]
POSE = {"name": "arm/tool0", "position": [0.6, 2, 0.8], "rpy": [3.14159265, 0, 0]}
TIME = {"time": 1, "effort": 1e-4}
CAR = """<link name="front_axle"><inertial><mass value="2"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="steering" type="revolute"><parent link="base_link"/><child link="front_axle"/>
<origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
<limit lower="-0.6" upper="0.6" effort="20" velocity="1"/></joint></robot>"""


def rolls(frame: str, **more: Any) -> dict[str, Any]:
    """No slip across the x axis of a frame."""
    return {"kind": "velocity", "frame": frame, "y": [0, 0], **more}


def wheels(prefix: str = "") -> list[dict[str, Any]]:
    """An axle with two wheels, whose rims have up to 0.8 m/s."""
    rims = [
        {"kind": "velocity", "frame": f"{prefix}{side}_wheel", "x": [-0.8, 0.8]} for side in ("left", "right")
    ]
    return [rolls(f"{prefix}base_link"), *rims]


def presses(frame: str) -> dict[str, Any]:
    """A bound of accelerations."""
    return {"kind": "frame_acceleration", "frame": frame, "x": [-1, 1], "y": [-1, 1]}


def carries(*arms: dict[str, Any]) -> dict[str, Any]:
    """A base with arms, without dynamics."""
    still = {"dynamics": False}
    base = {"name": "base", "robot": "planar_base", **still}
    return {"part": [base, *({"parent": "base/base_link", **still, **arm} for arm in arms)]}


def tasks(car: Path) -> dict[str, dict[str, Any]]:
    """Arguments of `Problem.create` by what they are."""
    base = {"name": "planar_base", "dynamics": False}
    steered = [rolls("base_link", x=[-1, 1]), rolls("front_axle"), presses("base_link")]
    steers = {
        "robot": {"name": str(car), "dynamics": False},
        "duration": {"min": 1, "max": 60, "guess": 8},
        "steps": 160,
        "cost": TIME,
        "limits": {
            "velocity": {"steering": 1},
            "position": {"steering": [-0.6, 0.6]},
            "acceleration": {"steering": 4},
        },
        "path": steered,
    }
    ur5 = {"name": "arm", "robot": "ur5", "position": [0.15, 0, 0.3]}
    pair = [
        {"name": n, "robot": "ur5", "position": [0.1, y, 0.3]} for n, y in (("left", 0.25), ("right", -0.25))
    ]
    hands = [{"name": f"{n}/tool0", "position": [2, y, 0.8]} for n, y in (("left", 0.3), ("right", -0.3))]
    plain = {"robot": base, "steps": 100, "cost": {"effort": 1}}
    reach = {
        "robot": carries(ur5),
        "steps": 80,
        "start": {"q": {"arm": UP}},
        "goal": {"v": 0, "frame": POSE},
    }
    arm_path = [*wheels("base/"), presses("base/base_link")]
    return {
        "two wheels, 1 m to the side": {**plain, "duration": 4, "goal": at(0, 1, 0), "path": wheels()},
        "two wheels, heading from 2.8 to 3.6": {
            **plain,
            "duration": 6,
            "start": {"q": [0, 0, 2.8]},
            "goal": at(2, 0.5, 3.6),
            "path": wheels(),
        },
        "two wheels, least time": {
            **plain,
            "duration": {"min": 1, "max": 60, "guess": 6},
            "steps": 200,
            "goal": at(3, -2, 1.5),
            "cost": TIME,
            "limits": {"acceleration": {"yaw": 3}},
            "path": [*wheels(), presses("base_link")],
        },
        "forwards alone, 0.5 m to the side": {
            **plain,
            "duration": 8,
            "goal": at(0.2, 0.5, 0),
            "path": [rolls("base_link", x=[0, 1])],
        },
        "through a via point": {
            **plain,
            "duration": 8,
            "goal": at(3, 0, 0),
            "via": [{"time": 4, "q": {"x": 1.5, "y": 1}}],
            "path": wheels(),
        },
        "a car parks, least time": {**steers, "goal": at(0, 1, 0, 0)},
        "UR5 on two wheels": {
            **reach,
            "duration": 3,
            "cost": {"effort": 1},
            "limits": {"velocity": {"arm/*": 2}},
            "path": arm_path,
        },
        "UR5 on two wheels, least time": {
            **reach,
            "duration": {"min": 1, "max": 60, "guess": 5},
            "cost": TIME,
            "path": arm_path,
            "limits": {"velocity": {"arm/*": 2}, "acceleration": {"arm/*": 8, "base/yaw": 4}},
        },
        "two UR5 on one base": {
            "robot": carries(*pair),
            "duration": 4,
            "steps": 60,
            "start": {"q": {"left": UP, "right": UP}},
            "goal": {"v": 0, "frame": hands},
            "cost": {"effort": 1},
            "path": wheels("base/"),
        },
        "Baxter on two wheels": {
            "robot": carries({"name": "arm", "robot": "baxter", "position": [0, 0, 0.9]}),
            "duration": 5,
            "steps": 50,
            "goal": {"v": 0, "frame": {"name": "arm/left_gripper", "position": [1.5, 0.8, 1.1]}},
            "cost": {"effort": 1},
            "path": wheels("base/"),
        },
    }


def at(*q: float) -> dict[str, Any]:
    """A goal at rest."""
    return {"q": list(q), "v": 0}


def slip_of(t: np.ndarray, q: np.ndarray) -> float:
    """Largest speed across the heading, of differences of x, y and yaw [m/s]."""
    (x, y, _), heading = np.diff(q[:-1, :3], axis=0).T / np.diff(t[:-1]), (q[1:-1, 2] + q[:-2, 2]) / 2.0
    return float(np.abs(y * np.cos(heading) - x * np.sin(heading)).max())


def off_goal(problem: Problem, end: np.ndarray) -> float:
    """How far tools are from where they are to be at the end of a file [m]."""
    robot: Robot = problem.robot
    q = np.concatenate([end[:2], [np.cos(end[2]), np.sin(end[2])], end[3:]])
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    asked = [(robot.model.getFrameId(f.target.name), f.target.position) for f in problem.goal.frames]
    return max(
        (float(np.abs(data.oMf[k].translation - p).max()) for k, p in asked if p is not None), default=0.0
    )


def main() -> int:
    """Print a row for each; 1 if one is not written, slips, or misses its goal."""
    argparse.ArgumentParser(prog="python -m tests.sent.bases", description=__doc__).parse_args()
    print("| task | status | iterations | processor seconds | T | slip | heading, step | tool |")
    is_good = True
    with tempfile.TemporaryDirectory() as folder:
        car = Path(folder) / "car.urdf"
        plain = (Path(__file__).parents[2] / "robots/planar_base/robot.urdf").read_text()
        car.write_text(plain.replace("</robot>", CAR))
        for name, given in tasks(car).items():
            before = resource.getrusage(resource.RUSAGE_SELF).ru_utime
            problem = Problem.create(**given)
            solution = mbocp.solve(problem, time_limit=120.0)
            seconds = resource.getrusage(resource.RUSAGE_SELF).ru_utime - before
            row = f"| {name} | {solution.status} | {solution.iterations} | {seconds:.2f} "
            row += f"| {solution.duration:.2f} s"
            try:
                t, q = samples_of(solution.export(Path(folder) / "sent.csv", rate=RATE))
            except mbocp.MbocpError as error:
                is_good = False
                print(f"{row} | {error} |", flush=True)
                continue
            slip, missed, turn = slip_of(t, q), off_goal(problem, q[-1]), np.abs(np.diff(q[:, 2])).max()
            is_good &= solution.converged and slip < MOST_SLIP and missed < 1e-6 and bool(turn < 0.01)
            print(f"{row} | {1e3 * slip:.2f} mm/s | {1e3 * turn:.2f} mrad | {missed:.0e} m |", flush=True)
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())

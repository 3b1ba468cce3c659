"""The smallest problem file for a robot, shown where a robot is given in place of a problem."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from mbocp.exceptions import MbocpError
from mbocp.robot import Robot, load_robot

_ROBOTS = (".urdf", ".xacro", ".mjcf", ".sdf", ".xml")
_MAX_JOINTS = 12  # that are written out; the others may end anywhere
_DISPLACEMENT = 0.5  # [rad, m]


def is_robot_file(path: Path) -> bool:
    """Whether a file is a robot, by its name."""
    return path.suffix.lower() in _ROBOTS


def smallest_problem(path: Path) -> str:
    """Lines of a problem file that moves the joints of the robot in `path`, from its initial pose to rest."""
    try:
        goal = _goal(load_robot(path))
    except MbocpError:  # faults of the robot are reported when the problem is loaded
        goal = "JOINT = 0.5"
    return "\n".join(
        (
            f"robot = {json.dumps(path.name)}",
            "[horizon]",
            "duration = 2.0  # s",
            "steps = 100",
            "[goal]",
            f"q = {{ {goal} }}  # rad or m",
            "v = 0  # at rest",
        )
    )


def _goal(robot: Robot) -> str:
    """Positions within the limits, of joints with one coordinate."""
    limits = robot.limits
    words: list[str] = []
    for name, joint in zip(robot.model.names[1:], robot.model.joints[1:], strict=True):
        if joint.nq == joint.nv == 1 and len(words) < _MAX_JOINTS:
            i = joint.idx_q
            value = np.clip(robot.q0[i] + _DISPLACEMENT, limits.position_lower[i], limits.position_upper[i])
            key = name if name.replace("_", "").replace("-", "").isalnum() else json.dumps(name)
            words.append(f"{key} = {float(value):.3g}")
    return ", ".join(words) or "JOINT = 0.5"

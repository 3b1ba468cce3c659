"""Motions made up for a robot, for pictures."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp.robot import Robot
from mbocp.solution import Labels, Solution
from tests.solution.fabricated import fabricate


def motion(robot: Robot, q_end: Any, **others: Any) -> Solution:
    labels = Labels.of_robot(robot)
    s = np.linspace(0.0, 1.0, 21)
    dq = pin.difference(robot.model, robot.q0, np.asarray(q_end, dtype=float))
    qs = np.array([pin.integrate(robot.model, robot.q0, x * x * (3 - 2 * x) * dq) for x in s])
    q, v, u = list(labels.q), list(labels.v), list(labels.u)
    made = fabricate(q, v, u, num_steps=20, num_constraints=robot.nc, qs=qs, labels=labels, problem_text="")
    return dataclasses.replace(made, **others)


def hanging(robot: Robot, *frames: str) -> Robot:
    return dataclasses.replace(robot, trace_frames=frames)

"""Robots: loading, and what the rest of mbocp sees of them.

`load_robot` makes a `Robot` from a name, a URDF or a robot.toml. Numeric Pinocchio only; the symbolic
functions of the same model come from `mbocp.symbolic`.
"""

from __future__ import annotations

from mbocp.robot.checks import SingularMassMatrix
from mbocp.robot.describe import describe
from mbocp.robot.load import load_robot, robot_from_spec
from mbocp.robot.notices import InitialPoseWarning, MissingMeshWarning, NormalisationWarning
from mbocp.robot.parts import (
    Actuation,
    Connector,
    Drive,
    FrameActuator,
    Label,
    Limits,
    QuarticSpring,
    Rod,
    SpringDamper,
)
from mbocp.robot.robot import Robot
from mbocp.robot.sources import RobotEntry, list_robots

__all__ = [
    "Actuation",
    "Connector",
    "Drive",
    "FrameActuator",
    "InitialPoseWarning",
    "Label",
    "Limits",
    "MissingMeshWarning",
    "NormalisationWarning",
    "QuarticSpring",
    "Robot",
    "RobotEntry",
    "Rod",
    "SingularMassMatrix",
    "SpringDamper",
    "describe",
    "list_robots",
    "load_robot",
    "robot_from_spec",
]

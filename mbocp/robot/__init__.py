"""Robots: loading, and the interface to the rest of mbocp.

`load_robot` makes a `Robot` from a name, a URDF or a robot.toml. Numeric Pinocchio, and the equations of the
holonomic constraints; the symbolic functions of the same model come from `mbocp.symbolic`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.robot.collision.source import CollisionSphere
    from mbocp.robot.collision.spheres import LinkSpheres
    from mbocp.robot.facts import describe
    from mbocp.robot.gathering import gather, load_stored
    from mbocp.robot.link_inertia import LinkInertia
    from mbocp.robot.loading.checks import SingularMassMatrix
    from mbocp.robot.loading.load import load_parts, load_robot, robot_from_spec
    from mbocp.robot.loading.sources import RobotEntry, list_robots
    from mbocp.robot.loops.kinds.base import Constraint, Kinematics
    from mbocp.robot.loops.kinds.coupling import Coupling
    from mbocp.robot.loops.kinds.hinge import Hinge
    from mbocp.robot.loops.kinds.line import PointOnLine
    from mbocp.robot.loops.kinds.plane import PointOnPlane
    from mbocp.robot.loops.kinds.point import Point
    from mbocp.robot.loops.kinds.rod import Rod
    from mbocp.robot.loops.kinds.screw import Screw
    from mbocp.robot.loops.kinds.weld import Weld
    from mbocp.robot.loops.redundancy import singular_closure
    from mbocp.robot.named_numbers import number_of, with_numbers
    from mbocp.robot.parts import (
        Actuation,
        Connector,
        Drive,
        FrameActuator,
        Label,
        Limits,
        QuarticSpring,
        SpringDamper,
    )
    from mbocp.robot.payload import Payload
    from mbocp.robot.placed import PlacedRobot
    from mbocp.robot.poses.inverse_kinematics import InverseKinematics
    from mbocp.robot.poses.target import FrameTarget
    from mbocp.robot.resistance import JointResistance
    from mbocp.robot.robot import Robot
    from mbocp.robot.stored import RobotFiles
    from mbocp.robot.warnings import (
        EstimatedInertiaWarning,
        HeldJointsWarning,
        IgnoredKeysWarning,
        ImpossibleInertiaWarning,
        InitialPoseWarning,
        MissingMeshWarning,
        NormalisationWarning,
        NotModelledWarning,
        RobotChangedWarning,
        RobotNotStoredWarning,
    )

__all__ = [
    "Actuation",
    "CollisionSphere",
    "Connector",
    "Constraint",
    "Coupling",
    "Drive",
    "EstimatedInertiaWarning",
    "FrameActuator",
    "FrameTarget",
    "HeldJointsWarning",
    "Hinge",
    "IgnoredKeysWarning",
    "ImpossibleInertiaWarning",
    "InitialPoseWarning",
    "InverseKinematics",
    "JointResistance",
    "Kinematics",
    "Label",
    "Limits",
    "LinkInertia",
    "LinkSpheres",
    "MissingMeshWarning",
    "NormalisationWarning",
    "NotModelledWarning",
    "Payload",
    "PlacedRobot",
    "Point",
    "PointOnLine",
    "PointOnPlane",
    "QuarticSpring",
    "Robot",
    "RobotChangedWarning",
    "RobotEntry",
    "RobotFiles",
    "RobotNotStoredWarning",
    "Rod",
    "Screw",
    "SingularMassMatrix",
    "SpringDamper",
    "Weld",
    "describe",
    "gather",
    "list_robots",
    "load_parts",
    "load_robot",
    "load_stored",
    "number_of",
    "robot_from_spec",
    "singular_closure",
    "with_numbers",
]

__getattr__ = names_of(__name__, __file__)

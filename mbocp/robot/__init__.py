"""Robots: loading, and the interface to the rest of mbocp.

`load_robot` makes a `Robot` from a name, a URDF or a robot.toml. Numeric Pinocchio, and the equations of the
holonomic constraints; the symbolic functions of the same model come from `mbocp.symbolic`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.robot.collision.geometry import CollisionSphere as CollisionSphere
    from mbocp.robot.collision.spheres import LinkSpheres as LinkSpheres
    from mbocp.robot.gathering import gather as gather
    from mbocp.robot.gathering import load_stored as load_stored
    from mbocp.robot.loading.loaders import load_parts as load_parts
    from mbocp.robot.loading.loaders import load_robot as load_robot
    from mbocp.robot.loading.loaders import robot_from_spec as robot_from_spec
    from mbocp.robot.loading.mechanics_checks import SingularMassMatrix as SingularMassMatrix
    from mbocp.robot.loading.robot_sources import RobotEntry as RobotEntry
    from mbocp.robot.loading.robot_sources import list_robots as list_robots
    from mbocp.robot.loops.kinds.constraint import Constraint as Constraint
    from mbocp.robot.loops.kinds.constraint import FrameKinematics as FrameKinematics
    from mbocp.robot.loops.kinds.coupling import Coupling as Coupling
    from mbocp.robot.loops.kinds.hinges import Hinge as Hinge
    from mbocp.robot.loops.kinds.hinges import Screw as Screw
    from mbocp.robot.loops.kinds.hinges import Weld as Weld
    from mbocp.robot.loops.kinds.kept_points import PointOnLine as PointOnLine
    from mbocp.robot.loops.kinds.kept_points import PointOnPlane as PointOnPlane
    from mbocp.robot.loops.kinds.kept_points import PointOnPoint as PointOnPoint
    from mbocp.robot.loops.kinds.rod import Rod as Rod
    from mbocp.robot.loops.redundancy import singular_closure as singular_closure
    from mbocp.robot.named_numbers import number_of as number_of
    from mbocp.robot.named_numbers import with_numbers as with_numbers
    from mbocp.robot.parts import Actuation as Actuation
    from mbocp.robot.parts import Connector as Connector
    from mbocp.robot.parts import Drive as Drive
    from mbocp.robot.parts import FrameActuator as FrameActuator
    from mbocp.robot.parts import Label as Label
    from mbocp.robot.parts import Limits as Limits
    from mbocp.robot.parts import QuarticSpring as QuarticSpring
    from mbocp.robot.parts import SpringDamper as SpringDamper
    from mbocp.robot.payload import LinkInertia as LinkInertia
    from mbocp.robot.payload import Payload as Payload
    from mbocp.robot.placed import PlacedRobot as PlacedRobot
    from mbocp.robot.poses.inverse_kinematics import InverseKinematics as InverseKinematics
    from mbocp.robot.poses.target import FrameTarget as FrameTarget
    from mbocp.robot.resistance import JointResistance as JointResistance
    from mbocp.robot.robot import Robot as Robot
    from mbocp.robot.robot_facts import describe as describe
    from mbocp.robot.robot_files import RobotFiles as RobotFiles
    from mbocp.robot.warnings import EstimatedInertiaWarning as EstimatedInertiaWarning
    from mbocp.robot.warnings import HeldJointsWarning as HeldJointsWarning
    from mbocp.robot.warnings import IgnoredKeysWarning as IgnoredKeysWarning
    from mbocp.robot.warnings import ImpossibleInertiaWarning as ImpossibleInertiaWarning
    from mbocp.robot.warnings import InitialPoseWarning as InitialPoseWarning
    from mbocp.robot.warnings import MissingMeshWarning as MissingMeshWarning
    from mbocp.robot.warnings import NormalisationWarning as NormalisationWarning
    from mbocp.robot.warnings import NotModelledWarning as NotModelledWarning
    from mbocp.robot.warnings import RobotChangedWarning as RobotChangedWarning
    from mbocp.robot.warnings import RobotNotStoredWarning as RobotNotStoredWarning


__getattr__ = names_of(__name__, __file__)

"""Warnings about a robot: something was corrected or left out."""

from __future__ import annotations


class MissingMeshWarning(UserWarning):
    """A mesh that the robot's file names does not exist; the robot is shown without it."""


class NormalisationWarning(UserWarning):
    """A configuration was not on its manifold (quaternion, cos/sin pair) and has been normalised."""


class InitialPoseWarning(UserWarning):
    """The initial pose that was written violates a holonomic constraint, and has been moved."""


class HeldJointsWarning(UserWarning):
    """Joints were locked, since no motor drives what they let move; `joints` has their names."""

    def __init__(self, message: str, joints: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.joints = joints


class IgnoredKeysWarning(UserWarning):
    """A robot.yaml has keys that mbocp does not know; they are left out."""


class ImpossibleInertiaWarning(UserWarning):
    """A link has a rotational inertia that no body can have; it is used as it stands."""


class EstimatedInertiaWarning(UserWarning):
    """Masses and inertias of links are estimates, from their shapes."""


class NotModelledWarning(UserWarning):
    """A robot's file has tags about forces or motions that mbocp does not know; they are left out."""


class RobotChangedWarning(UserWarning):
    """Files of a robot are others on this machine than in a result, whose own are used."""


class RobotNotStoredWarning(UserWarning):
    """A result is written without its robot, or without the robot's meshes."""

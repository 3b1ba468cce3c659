"""What problems in each choice of coordinates can have."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from mbocp._arrays import dataclass


@dataclass(frozen=True)
class CoordinatesData:
    """What problems in some coordinates can have.

    Attributes
    ----------
    needs_constraints : bool
        Whether constraints tie the coordinates of any robot, so that a scheme has to solve them.
    limits_joints : bool
        Whether positions and velocities of joints can be limited.
    takes_joint_guess : bool
        Whether a solution in the coordinates of the joints is a guess, and the first one to try.
    has_robot_multipliers : bool
        Whether the multipliers of a solution are those of the robot's own constraints, and no others.
    takes_free_duration : bool
        Whether steps may be of a length that is found.
    takes_holds : bool
        Whether constraints may begin and end along the way.
    lands_softly : bool
        Whether they may begin without an impact: velocities are those of the joints, not chords of bodies.
    has_joint_states : bool
        Whether states are q and v of the joints, so that a start may be free and a motion periodic.
    """

    needs_constraints: bool
    limits_joints: bool
    takes_joint_guess: bool
    has_robot_multipliers: bool
    takes_free_duration: bool
    takes_holds: bool = False
    lands_softly: bool = False
    has_joint_states: bool = False


COORDINATES: Mapping[str, CoordinatesData] = MappingProxyType(
    {
        "joint": CoordinatesData(
            needs_constraints=False,
            limits_joints=True,
            takes_joint_guess=False,
            has_robot_multipliers=True,
            takes_free_duration=True,
            takes_holds=True,
            lands_softly=True,
            has_joint_states=True,
        ),
        # Far from a solution Newton's method gets on badly with bodies: hence the guess.
        "natural": CoordinatesData(
            needs_constraints=True,
            limits_joints=False,
            takes_joint_guess=True,
            has_robot_multipliers=False,
            takes_free_duration=False,
            takes_holds=True,
        ),
    }
)

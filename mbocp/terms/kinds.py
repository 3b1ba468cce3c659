"""All kinds of terms, in the order of the documentation: a class adds itself to its list when it is defined.

Modules with terms of a list are imported here and nowhere else, so that their order is always the same; one
name of each is enough.
"""

# isort: off
from __future__ import annotations

from mbocp._keys import Table
from mbocp.terms.cost import COST_TERMS as COST_TERMS
from mbocp.terms.running import (
    ControlRate as ControlRate,
    Effort as Effort,
    EffortAboutGravity as EffortAboutGravity,
    Potential as Potential,
    Tracking as Tracking,
    Velocity as Velocity,
)
from mbocp.terms.energy import Energy as Energy
from mbocp.terms.energy import Time as Time
from mbocp.terms.end import (
    AccelerationEnd as AccelerationEnd,
    ExactGoal as ExactGoal,
    TerminalCost as TerminalCost,
)
from mbocp.terms.path_term import PATH_TERMS as PATH_TERMS
from mbocp.terms.frame_path import Position as Position
from mbocp.terms.frame_velocity import FrameVelocity as FrameVelocity
from mbocp.terms.braking import Braking as Braking
from mbocp.terms.over_speed import AccelerationOverSpeed as AccelerationOverSpeed
from mbocp.terms.motor import MotorTorque as MotorTorque
from mbocp.terms.kept_poses import Line as Line
from mbocp.terms.follow import Follow as Follow
from mbocp.terms.heights import Height as Height
from mbocp.terms.contact import ContactKeys, ContactTerm


PATH_KEYS: dict[str, type[Table]] = {
    **{kind: term.Keys for kind, term in PATH_TERMS.items()},
    ContactTerm.kind: ContactKeys,
}

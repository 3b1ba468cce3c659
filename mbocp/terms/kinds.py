"""All kinds of terms, in the order of the documentation: a class adds itself to its list when it is defined.

Modules with terms of a list are imported here and nowhere else, so that their order is always the same.
"""

# isort: off
from __future__ import annotations

from mbocp._keys import Table
from mbocp.terms.cost import COST_TERMS
from mbocp.terms.running import (
    ControlRate,
    Effort,
    EffortAboutGravity,
    Potential,
    Tracking,
    Velocity,
)
from mbocp.terms.energy import Energy
from mbocp.terms.time import Time
from mbocp.terms.end import ExactGoal, TerminalCost
from mbocp.terms.path import PATH_TERMS
from mbocp.terms.frame_path import (
    AngularMomentum,
    AngularSpeed,
    CentreOfMass,
    Distance,
    Orientation,
    Position,
    Speed,
)
from mbocp.terms.braking import Braking
from mbocp.terms.motor import Motor
from mbocp.terms.kept import Line, OrientationKept
from mbocp.terms.follow import Follow
from mbocp.terms.contact import ContactKeys, ContactTerm

__all__ = [
    "COST_TERMS",
    "PATH_KEYS",
    "PATH_TERMS",
    "AngularMomentum",
    "AngularSpeed",
    "Braking",
    "CentreOfMass",
    "ControlRate",
    "Distance",
    "Effort",
    "EffortAboutGravity",
    "Energy",
    "ExactGoal",
    "Follow",
    "Line",
    "Motor",
    "Orientation",
    "OrientationKept",
    "Position",
    "Potential",
    "Speed",
    "TerminalCost",
    "Time",
    "Tracking",
    "Velocity",
]

PATH_KEYS: dict[str, type[Table]] = {
    **{kind: term.Keys for kind, term in PATH_TERMS.items()},
    ContactTerm.kind: ContactKeys,
}

"""What a problem is made of: terms of its cost, path constraints, end conditions; one class each."""

from mbocp.terms.clearance import ClearanceRow, ClearanceTerm, HullSlots, clearance_slots
from mbocp.terms.contact import ContactKeys, ContactTerm
from mbocp.terms.cost import (
    COST_TERMS,
    CostTerm,
    CostWeights,
    Reader,
    RunningTerm,
    TermNumbers,
    Weighted,
)
from mbocp.terms.running import ControlRate, Effort, Potential, Tracking, Velocity

from mbocp.terms.time import Time  # isort: skip  # keys in the order of the documentation
from mbocp.terms.end import ExactGoal, TerminalCost  # isort: skip  # after the running cost, as in the file
from mbocp.terms.end_acceleration import AccelerationEnd
from mbocp.terms.frame_goal import FrameGoal
from mbocp.terms.frame_tolerance import FrameTolerance, ToleranceTerm, frame_tolerances
from mbocp.terms.frames import FrameEnd, FrameProjections, FrameShape
from mbocp.terms.held import MeetingTerm
from mbocp.terms.kinematics import Kinematics
from mbocp.terms.own import OwnTerm, end_condition, path_constraint, running_cost, terminal_cost
from mbocp.terms.own_parts import OwnEnd, OwnPath, OwnPathConstraint, own_ends, running_terms
from mbocp.terms.path import PATH_TERMS, PathTerm
from mbocp.terms.periodic import PeriodicEnd, StartEnd, StartState

from mbocp.terms.frame_path import (  # isort: skip  # kinds in the order of the documentation
    AngularSpeed,
    Distance,
    Orientation,
    Position,
    Speed,
)
from mbocp.terms.kept import Line, OrientationKept  # isort: skip  # after them
from mbocp.terms.follow import Follow  # isort: skip
from mbocp.terms.point import Point, Sizes
from mbocp.terms.rates import RATE_TERMS, RateTerm
from mbocp.terms.span import Span
from mbocp.terms.via import ViaFrameShape, ViaTerm

PATH_KEYS = {kind: term.Keys for kind, term in PATH_TERMS.items()} | {ContactTerm.kind: ContactKeys}

__all__ = [
    "COST_TERMS",
    "PATH_KEYS",
    "PATH_TERMS",
    "RATE_TERMS",
    "AccelerationEnd",
    "AngularSpeed",
    "ClearanceRow",
    "ClearanceTerm",
    "ContactKeys",
    "ContactTerm",
    "ControlRate",
    "CostTerm",
    "CostWeights",
    "Distance",
    "Effort",
    "ExactGoal",
    "Follow",
    "FrameEnd",
    "FrameGoal",
    "FrameProjections",
    "FrameShape",
    "FrameTolerance",
    "HullSlots",
    "Kinematics",
    "Line",
    "MeetingTerm",
    "Orientation",
    "OrientationKept",
    "OwnEnd",
    "OwnPath",
    "OwnPathConstraint",
    "OwnTerm",
    "PathTerm",
    "PeriodicEnd",
    "Point",
    "Position",
    "Potential",
    "RateTerm",
    "Reader",
    "RunningTerm",
    "Sizes",
    "Span",
    "Speed",
    "StartEnd",
    "StartState",
    "TermNumbers",
    "TerminalCost",
    "Time",
    "ToleranceTerm",
    "Tracking",
    "Velocity",
    "ViaFrameShape",
    "ViaTerm",
    "Weighted",
    "clearance_slots",
    "end_condition",
    "frame_tolerances",
    "own_ends",
    "path_constraint",
    "running_cost",
    "running_terms",
    "terminal_cost",
]

"""What a problem is made of: terms of its cost, path constraints, end conditions; one class each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.terms.bounded import BoundedTerm, SidesInSteps
    from mbocp.terms.clearance import ClearanceRow, ClearanceTerm, HullSlots, clearance_slots
    from mbocp.terms.contact import ContactKeys, ContactTerm
    from mbocp.terms.cost import CostTerm, CostWeights, Reader, RunningTerm, TermNumbers, Weighted
    from mbocp.terms.end_acceleration import AccelerationEnd
    from mbocp.terms.frame_goal import FrameGoal
    from mbocp.terms.frame_tolerance import FrameTolerance, ToleranceTerm, frame_tolerances
    from mbocp.terms.frames import FrameEnd, FrameProjections, FrameShape
    from mbocp.terms.held import ContactConditionTerm
    from mbocp.terms.kinds import (
        COST_TERMS,
        PATH_KEYS,
        PATH_TERMS,
        AngularMomentum,
        AngularSpeed,
        Braking,
        CentreOfMass,
        ControlRate,
        Distance,
        Effort,
        EffortAboutGravity,
        Energy,
        ExactGoal,
        Follow,
        Line,
        Orientation,
        OrientationKept,
        Position,
        Potential,
        Speed,
        TerminalCost,
        Time,
        Tracking,
        Velocity,
    )
    from mbocp.terms.kinematics import Kinematics
    from mbocp.terms.own import OwnTerm, end_condition, path_constraint, running_cost, terminal_cost
    from mbocp.terms.own_parts import OwnEnd, OwnPath, OwnPathConstraint, own_ends, running_terms
    from mbocp.terms.path import PathTerm
    from mbocp.terms.periodic import KeptRows, PeriodicEnd, StartEnd, StartState
    from mbocp.terms.point import Point, Sizes
    from mbocp.terms.rates import RATE_TERMS, JerkAtEnd, RateTerm
    from mbocp.terms.span import Span
    from mbocp.terms.via import ViaFrameShape, ViaTerm

__all__ = [
    "COST_TERMS",
    "PATH_KEYS",
    "PATH_TERMS",
    "RATE_TERMS",
    "AccelerationEnd",
    "AngularMomentum",
    "AngularSpeed",
    "BoundedTerm",
    "Braking",
    "CentreOfMass",
    "ClearanceRow",
    "ClearanceTerm",
    "ContactConditionTerm",
    "ContactKeys",
    "ContactTerm",
    "ControlRate",
    "CostTerm",
    "CostWeights",
    "Distance",
    "Effort",
    "EffortAboutGravity",
    "Energy",
    "ExactGoal",
    "Follow",
    "FrameEnd",
    "FrameGoal",
    "FrameProjections",
    "FrameShape",
    "FrameTolerance",
    "HullSlots",
    "JerkAtEnd",
    "KeptRows",
    "Kinematics",
    "Line",
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
    "SidesInSteps",
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

__getattr__ = names_of(__name__, __file__)

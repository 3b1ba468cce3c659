"""What a problem is made of: terms of its cost, path constraints, end conditions; one class each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.terms.bounded import BoundedTerm as BoundedTerm
    from mbocp.terms.bounded import SidesInSteps as SidesInSteps
    from mbocp.terms.clearance import ClearanceRow as ClearanceRow
    from mbocp.terms.clearance import ClearanceTerm as ClearanceTerm
    from mbocp.terms.clearance import HullSlots as HullSlots
    from mbocp.terms.clearance import clearance_slots as clearance_slots
    from mbocp.terms.contact import ContactKeys as ContactKeys
    from mbocp.terms.contact import ContactTerm as ContactTerm
    from mbocp.terms.cost import CostTerm as CostTerm
    from mbocp.terms.cost import CostWeights as CostWeights
    from mbocp.terms.cost import Reader as Reader
    from mbocp.terms.cost import RunningTerm as RunningTerm
    from mbocp.terms.cost import TermNumbers as TermNumbers
    from mbocp.terms.cost import Weighted as Weighted
    from mbocp.terms.end_acceleration import AccelerationEnd as AccelerationEnd
    from mbocp.terms.frame_goal import FrameGoal as FrameGoal
    from mbocp.terms.frame_tolerance import FrameTolerance as FrameTolerance
    from mbocp.terms.frame_tolerance import ToleranceTerm as ToleranceTerm
    from mbocp.terms.frame_tolerance import frame_tolerances as frame_tolerances
    from mbocp.terms.frames import FrameEnd as FrameEnd
    from mbocp.terms.frames import FrameProjections as FrameProjections
    from mbocp.terms.frames import FrameShape as FrameShape
    from mbocp.terms.held import ContactConditionTerm as ContactConditionTerm
    from mbocp.terms.kinds import COST_TERMS as COST_TERMS
    from mbocp.terms.kinds import PATH_KEYS as PATH_KEYS
    from mbocp.terms.kinds import PATH_TERMS as PATH_TERMS
    from mbocp.terms.kinds import AngularMomentum as AngularMomentum
    from mbocp.terms.kinds import AngularSpeed as AngularSpeed
    from mbocp.terms.kinds import Braking as Braking
    from mbocp.terms.kinds import CentreOfMass as CentreOfMass
    from mbocp.terms.kinds import ControlRate as ControlRate
    from mbocp.terms.kinds import Distance as Distance
    from mbocp.terms.kinds import Effort as Effort
    from mbocp.terms.kinds import EffortAboutGravity as EffortAboutGravity
    from mbocp.terms.kinds import Energy as Energy
    from mbocp.terms.kinds import ExactGoal as ExactGoal
    from mbocp.terms.kinds import Follow as Follow
    from mbocp.terms.kinds import Height as Height
    from mbocp.terms.kinds import Line as Line
    from mbocp.terms.kinds import Orientation as Orientation
    from mbocp.terms.kinds import OrientationKept as OrientationKept
    from mbocp.terms.kinds import Position as Position
    from mbocp.terms.kinds import Potential as Potential
    from mbocp.terms.kinds import Speed as Speed
    from mbocp.terms.kinds import TerminalCost as TerminalCost
    from mbocp.terms.kinds import Time as Time
    from mbocp.terms.kinds import Tracking as Tracking
    from mbocp.terms.kinds import Velocity as Velocity
    from mbocp.terms.kinematics import Kinematics as Kinematics
    from mbocp.terms.own import OwnTerm as OwnTerm
    from mbocp.terms.own import end_condition as end_condition
    from mbocp.terms.own import path_constraint as path_constraint
    from mbocp.terms.own import running_cost as running_cost
    from mbocp.terms.own import terminal_cost as terminal_cost
    from mbocp.terms.own_parts import OwnEnd as OwnEnd
    from mbocp.terms.own_parts import OwnPath as OwnPath
    from mbocp.terms.own_parts import OwnPathConstraint as OwnPathConstraint
    from mbocp.terms.own_parts import own_ends as own_ends
    from mbocp.terms.own_parts import running_terms as running_terms
    from mbocp.terms.path import PathTerm as PathTerm
    from mbocp.terms.periodic import KeptRows as KeptRows
    from mbocp.terms.periodic import PeriodicEnd as PeriodicEnd
    from mbocp.terms.periodic import StartEnd as StartEnd
    from mbocp.terms.periodic import StartState as StartState
    from mbocp.terms.point import Point as Point
    from mbocp.terms.point import Sizes as Sizes
    from mbocp.terms.rates import RATE_TERMS as RATE_TERMS
    from mbocp.terms.rates import JerkAtEnd as JerkAtEnd
    from mbocp.terms.rates import RateTerm as RateTerm
    from mbocp.terms.span import Span as Span
    from mbocp.terms.via import ViaFrameShape as ViaFrameShape
    from mbocp.terms.via import ViaTerm as ViaTerm


__getattr__ = names_of(__name__, __file__)

"""All features, in the order in which their blocks, controls and parameters stand."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp.formulation.features.braking_within import BrakingWithin
from mbocp.formulation.features.changing_constraints import Reactions, Switches
from mbocp.formulation.features.clock import Clock, Moment
from mbocp.formulation.features.control_values import ControlValues
from mbocp.formulation.features.feature import Feature, StepRequests
from mbocp.formulation.features.found_numbers import FoundNumbers
from mbocp.formulation.features.free_contacts import FreeContacts
from mbocp.formulation.features.heat import Heat
from mbocp.formulation.features.lines_within import LinesWithin
from mbocp.formulation.features.memory import Memory
from mbocp.formulation.features.moved_start import MovedStart
from mbocp.formulation.features.path_progress import Progress
from mbocp.formulation.features.paths_within import PathsWithin
from mbocp.formulation.features.step_lengths import StepLengths, UnequalLengths
from mbocp.formulation.features.varying_weights import VaryingWeights
from mbocp.formulation.features.within_steps import WithinSteps

if TYPE_CHECKING:
    from mbocp.problem import Problem

# Lengths take the time of a step as `Moment` gives it, and the state as a free start moves it.
_KINDS: tuple[type[Feature], ...] = (
    Moment,
    UnequalLengths,
    VaryingWeights,
    ControlValues,
    FoundNumbers,
    Memory,
    WithinSteps,
    LinesWithin,
    BrakingWithin,
    Progress,
    PathsWithin,
    Heat,
    Reactions,
    MovedStart,
    Clock,
    StepLengths,
    Switches,
    FreeContacts,
)


def features_of(problem: Problem, asked: StepRequests) -> tuple[Feature, ...]:
    """Return the features of a problem."""
    found = (kind.of(problem, asked) for kind in _KINDS)
    return tuple(feature for feature in found if feature is not None)

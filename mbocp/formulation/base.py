"""A formulation: a problem's programme, and what its numbers mean."""

from __future__ import annotations

from dataclasses import dataclass

from mbocp.formulation.goal import EndRows
from mbocp.formulation.layout import StateLayout
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import NaturalSpace
from mbocp.problem import Problem
from mbocp.programme import StagewiseProgramme
from mbocp.robot import Label

__all__ = ["Formulation"]


@dataclass(frozen=True)
class Formulation:
    """A problem's programme, and what leads from its numbers to motions of the robot.

    Attributes
    ----------
    problem : Problem
    programme : StagewiseProgramme
        All that a solver sees.
    layout : StateLayout
        What a state consists of.
    space : ConfigurationSpace
        The group that its configurations belong to, or natural coordinates.
    end_rows : EndRows
        Projections of the end condition.
    constraint_labels : tuple of Label
        Name and unit of each holonomic constraint.
    """

    problem: Problem
    programme: StagewiseProgramme
    layout: StateLayout
    space: ConfigurationSpace | NaturalSpace
    end_rows: EndRows
    constraint_labels: tuple[Label, ...] = ()

"""The optimal control problem, from Python or from a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.problem._checks import ProblemWarning
    from mbocp.problem.contact_bounds import ContactBounds
    from mbocp.problem.contact_force import ContactForce
    from mbocp.problem.cost import Cost
    from mbocp.problem.file.load import load_problem, parse_problem
    from mbocp.problem.file.tables import problem_to_toml
    from mbocp.problem.goals.goal import Goal
    from mbocp.problem.guess import Guess
    from mbocp.problem.integration import Stabilisation
    from mbocp.problem.limits import Bounds
    from mbocp.problem.path import PathConstraint
    from mbocp.problem.problem import Problem
    from mbocp.problem.solver import SolverOptions
    from mbocp.problem.timeline.via import ViaPoint
    from mbocp.terms import FrameGoal

__all__ = [
    "Bounds",
    "ContactBounds",
    "ContactForce",
    "Cost",
    "FrameGoal",
    "Goal",
    "Guess",
    "PathConstraint",
    "Problem",
    "ProblemWarning",
    "SolverOptions",
    "Stabilisation",
    "ViaPoint",
    "load_problem",
    "parse_problem",
    "problem_to_toml",
]

__getattr__ = names_of(__name__, __file__)

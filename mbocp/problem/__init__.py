"""The optimal control problem, from Python or from a file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.problem._checks import ProblemWarning as ProblemWarning
    from mbocp.problem.contact_bounds import ContactBounds as ContactBounds
    from mbocp.problem.contact_force import ContactForce as ContactForce
    from mbocp.problem.file.load import load_problem as load_problem
    from mbocp.problem.file.load import parse_problem as parse_problem
    from mbocp.problem.file.tables import problem_to_toml as problem_to_toml
    from mbocp.problem.goals.goal import Goal as Goal
    from mbocp.problem.integration import Stabilisation as Stabilisation
    from mbocp.problem.limits import Bounds as Bounds
    from mbocp.problem.path import PathConstraint as PathConstraint
    from mbocp.problem.problem import Problem as Problem
    from mbocp.problem.solver import Guess as Guess
    from mbocp.problem.solver import SolverOptions as SolverOptions
    from mbocp.problem.timeline.via import ViaPoint as ViaPoint
    from mbocp.problem.weights import Cost as Cost
    from mbocp.terms.frame_goal import FrameGoal as FrameGoal


__getattr__ = names_of(__name__, __file__)

"""Solvers of a stagewise programme: init, step, terminate on an explicit state. They never see a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.programme.iterate import Iterate, zero_multipliers
    from mbocp.solvers.fbsm_gradient import FBSMGradient, GradientState
    from mbocp.solvers.fbsm_newton import FBSMNewton
    from mbocp.solvers.iterating import SolverResult, run
    from mbocp.solvers.monolithic import GlobalisedNewton, PureNewton
    from mbocp.solvers.newton import NewtonState
    from mbocp.solvers.options import Options
    from mbocp.solvers.phases import Outcome, Start
    from mbocp.solvers.protocol import Solver, SolverState
    from mbocp.solvers.records import IterationRecord, Phase, Status
    from mbocp.solvers.registry import SOLVERS, make_solver
    from mbocp.solvers.settings import SolverSettings
    from mbocp.solvers.strategy import run_strategy
    from mbocp.solvers.switch import Switch

__all__ = [
    "SOLVERS",
    "FBSMGradient",
    "FBSMNewton",
    "GlobalisedNewton",
    "GradientState",
    "Iterate",
    "IterationRecord",
    "NewtonState",
    "Options",
    "Outcome",
    "Phase",
    "PureNewton",
    "Solver",
    "SolverResult",
    "SolverSettings",
    "SolverState",
    "Start",
    "Status",
    "Switch",
    "make_solver",
    "run",
    "run_strategy",
    "zero_multipliers",
]

__getattr__ = names_of(__name__, __file__)

"""Solvers of a stagewise programme: init, step, terminate on an explicit state. They never see a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.programme.iterate import Iterate, zero_multipliers
    from mbocp.solvers.newton_method.monolithic import GlobalisedNewton, PureNewton
    from mbocp.solvers.newton_method.newton import PlainState
    from mbocp.solvers.options import Options
    from mbocp.solvers.protocol import Solver, SolverState
    from mbocp.solvers.records import IterationRecord, Phase, Status
    from mbocp.solvers.settings import SolverSettings
    from mbocp.solvers.staggered.fbsm_gradient import FBSMGradient, GradientState
    from mbocp.solvers.staggered.fbsm_newton import FBSMNewton
    from mbocp.solvers.staggered.switch import Switch
    from mbocp.solvers.strategies.iterating import SolverResult, run
    from mbocp.solvers.strategies.phases import Outcome, Start
    from mbocp.solvers.strategies.registry import SOLVERS, make_solver
    from mbocp.solvers.strategies.strategy import run_strategy

__all__ = [
    "SOLVERS",
    "FBSMGradient",
    "FBSMNewton",
    "GlobalisedNewton",
    "GradientState",
    "Iterate",
    "IterationRecord",
    "Options",
    "Outcome",
    "Phase",
    "PlainState",
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

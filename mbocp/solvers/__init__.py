"""Solvers of a stagewise programme: init, step, terminate on an explicit state. They never see a robot."""

from mbocp.programme.iterate import Iterate, zero_multipliers
from mbocp.solvers.fbsm_gradient import FBSMGradient, GradientState, Switch
from mbocp.solvers.fbsm_newton import FBSMNewton
from mbocp.solvers.monolithic import GlobalisedNewton, PureNewton
from mbocp.solvers.newton import NewtonState
from mbocp.solvers.protocol import Solver, SolverState
from mbocp.solvers.records import IterationRecord, Phase, Status
from mbocp.solvers.run import SolverResult, run
from mbocp.solvers.strategy import Methods, Outcome, pursue

__all__ = [
    "FBSMGradient",
    "FBSMNewton",
    "GlobalisedNewton",
    "GradientState",
    "Iterate",
    "IterationRecord",
    "Methods",
    "NewtonState",
    "Outcome",
    "Phase",
    "PureNewton",
    "Solver",
    "SolverResult",
    "SolverState",
    "Status",
    "Switch",
    "pursue",
    "run",
    "zero_multipliers",
]

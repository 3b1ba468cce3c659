"""Solvers of a stagewise programme: init, step, terminate on an explicit state. They never see a robot."""

from mbocp.solvers.iterate import Iterate, zero_multipliers
from mbocp.solvers.monolithic import GlobalisedNewton, PureNewton
from mbocp.solvers.newton import NewtonState, Solver
from mbocp.solvers.records import IterationRecord, Phase, Status
from mbocp.solvers.run import SolverResult, run

__all__ = [
    "GlobalisedNewton",
    "Iterate",
    "IterationRecord",
    "NewtonState",
    "Phase",
    "PureNewton",
    "Solver",
    "SolverResult",
    "Status",
    "run",
    "zero_multipliers",
]

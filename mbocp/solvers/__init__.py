"""Solvers of a stagewise programme: init, step, terminate on an explicit state. They never see a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.programme.iterate import Iterate as Iterate
    from mbocp.programme.iterate import zero_multipliers as zero_multipliers
    from mbocp.solvers.newton_method.monolithic import GlobalisedNewton as GlobalisedNewton
    from mbocp.solvers.newton_method.monolithic import PureNewton as PureNewton
    from mbocp.solvers.newton_method.newton import PlainState as PlainState
    from mbocp.solvers.options import Options as Options
    from mbocp.solvers.options import SolverSettings as SolverSettings
    from mbocp.solvers.options import Switch as Switch
    from mbocp.solvers.protocol import Solver as Solver
    from mbocp.solvers.protocol import SolverState as SolverState
    from mbocp.solvers.records import IterationRecord as IterationRecord
    from mbocp.solvers.records import Phase as Phase
    from mbocp.solvers.records import Status as Status
    from mbocp.solvers.staggered.fbsm_gradient import FBSMGradient as FBSMGradient
    from mbocp.solvers.staggered.fbsm_gradient import GradientState as GradientState
    from mbocp.solvers.staggered.fbsm_newton import FBSMNewton as FBSMNewton
    from mbocp.solvers.strategies.iterating import SolverResult as SolverResult
    from mbocp.solvers.strategies.iterating import run as run
    from mbocp.solvers.strategies.phases import Outcome as Outcome
    from mbocp.solvers.strategies.phases import Start as Start
    from mbocp.solvers.strategies.registry import SOLVERS as SOLVERS
    from mbocp.solvers.strategies.registry import make_solver as make_solver
    from mbocp.solvers.strategies.strategy import run_strategy as run_strategy


__getattr__ = names_of(__name__, __file__)

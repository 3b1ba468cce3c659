"""Optimal control of multibody systems, driven by Pinocchio and URDF.

    import mbocp

    problem = mbocp.load_problem("ur5_reach.toml")
    solution = mbocp.solve(problem)

The public names are loaded on first use, so that `import mbocp` stays light.
"""

from __future__ import annotations

TYPE_CHECKING = False  # as in `typing`, which takes longer to import than all that is here
if TYPE_CHECKING:
    from mbocp.bounds.of_problem import Bound, bound
    from mbocp.exceptions import MbocpError, NotConverged
    from mbocp.identification import excite, identify
    from mbocp.interactive import live
    from mbocp.many import Motions, solve_many
    from mbocp.menus.menu import Menu, menu
    from mbocp.problem import Problem, load_problem
    from mbocp.receding import MovingHorizonEstimator, RecedingHorizon
    from mbocp.robot import Robot, load_robot
    from mbocp.sensitivity import Sensitivities, sensitivities
    from mbocp.solution import Solution
    from mbocp.solving import solve
    from mbocp.stopping import stop
    from mbocp.view.of_solution import replay_solution
    from mbocp.view.plots import plot_solution

__version__ = "0.1.0"

__all__ = [
    "Bound",
    "MbocpError",
    "Menu",
    "Motions",
    "MovingHorizonEstimator",
    "NotConverged",
    "Problem",
    "RecedingHorizon",
    "Robot",
    "Sensitivities",
    "Solution",
    "__version__",
    "bound",
    "excite",
    "identify",
    "live",
    "load_problem",
    "load_robot",
    "menu",
    "plot_solution",
    "replay_solution",
    "sensitivities",
    "solve",
    "solve_many",
    "stop",
]


def __getattr__(name: str) -> object:
    from mbocp._exports import names_of  # only for those who ask for a name

    return names_of(__name__, __file__)(name)


def __dir__() -> list[str]:
    return sorted(__all__)

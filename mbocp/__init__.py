"""Optimal control of multibody systems, driven by Pinocchio and URDF.

    import mbocp

    problem = mbocp.load_problem("ur5_reach.toml")
    solution = mbocp.solve(problem)

The public names are loaded on first use, so that `import mbocp` stays light.
"""

from __future__ import annotations

TYPE_CHECKING = False  # as in `typing`, which takes longer to import than all that is here
if TYPE_CHECKING:
    import typing

    from mbocp.bounds.of_problem import Bound as Bound
    from mbocp.bounds.of_problem import bound as bound
    from mbocp.exceptions import MbocpError as MbocpError
    from mbocp.exceptions import NotConverged as NotConverged
    from mbocp.identification import identify as identify
    from mbocp.interactive import live as live
    from mbocp.many import Motions as Motions
    from mbocp.many import solve_many as solve_many
    from mbocp.menus.menu import Menu as Menu
    from mbocp.menus.menu import menu as menu
    from mbocp.problem import Problem as Problem
    from mbocp.problem import load_problem as load_problem
    from mbocp.receding import MovingHorizonEstimator as MovingHorizonEstimator
    from mbocp.receding import RecedingHorizon as RecedingHorizon
    from mbocp.robot import Robot as Robot
    from mbocp.robot import load_robot as load_robot
    from mbocp.sensitivity import Sensitivities as Sensitivities
    from mbocp.sensitivity import sensitivities as sensitivities
    from mbocp.solution import Solution as Solution
    from mbocp.solving import excite as excite
    from mbocp.solving import solve as solve
    from mbocp.stopping import stop as stop
    from mbocp.view.of_solution import replay_solution as replay_solution
    from mbocp.view.plots import plot_solution as plot_solution

__version__ = "0.2.0"


def __getattr__(name: str) -> typing.Any:
    from mbocp._exports import names_of  # only for those who ask for a name

    found = names_of(__name__, __file__)(name)
    return [*found, "__version__"] if name == "__all__" else found


def __dir__() -> list[str]:
    return sorted(__getattr__("__all__"))

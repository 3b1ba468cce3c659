"""Optimal control of multibody systems, driven by Pinocchio and URDF.

    import mbocp

    problem = mbocp.load_problem("ur5_reach.toml")
    solution = mbocp.solve(problem)

The public names are loaded on first use, so that `import mbocp` stays light.
"""

from __future__ import annotations

TYPE_CHECKING = False  # as in `typing`, which takes longer to import than all that is here
if TYPE_CHECKING:
    from typing import Any

    from mbocp.exceptions import MbocpError as MbocpError
    from mbocp.exceptions import NotConverged as NotConverged
    from mbocp.interactive import live as live
    from mbocp.many import Motions as Motions
    from mbocp.many import solve_many as solve_many
    from mbocp.problem import Problem as Problem
    from mbocp.problem import load_problem as load_problem
    from mbocp.receding import RecedingHorizon as RecedingHorizon
    from mbocp.robot import Robot as Robot
    from mbocp.robot import load_robot as load_robot
    from mbocp.solution import Solution as Solution
    from mbocp.solving import solve as solve
    from mbocp.stopping import stop as stop
    from mbocp.view.of_solution import replay_solution as replay_solution
    from mbocp.view.plots import plot_solution as plot_solution

__version__ = "0.1.0"

_HOME = {
    "MbocpError": "mbocp.exceptions",
    "Motions": "mbocp.many",
    "NotConverged": "mbocp.exceptions",
    "Problem": "mbocp.problem",
    "RecedingHorizon": "mbocp.receding",
    "Robot": "mbocp.robot",
    "Solution": "mbocp.solution",
    "live": "mbocp.interactive",
    "load_problem": "mbocp.problem",
    "load_robot": "mbocp.robot",
    "plot_solution": "mbocp.view.plots",
    "replay_solution": "mbocp.view.of_solution",
    "solve": "mbocp.solving",
    "solve_many": "mbocp.many",
    "stop": "mbocp.stopping",
}

__all__ = [
    "MbocpError",
    "Motions",
    "NotConverged",
    "Problem",
    "RecedingHorizon",
    "Robot",
    "Solution",
    "__version__",
    "live",
    "load_problem",
    "load_robot",
    "plot_solution",
    "replay_solution",
    "solve",
    "solve_many",
    "stop",
]


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is None:
        raise AttributeError(f"module 'mbocp' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(home), name)


def __dir__() -> list[str]:
    return sorted(__all__)

"""The paper's problems: systems, ways to enforce the end, step sizes, strategies, as `Problem`.

The four systems are problem files, examples/paper, which an installed mbocp carries along.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import mbocp
from mbocp.exceptions import ProblemFileError
from mbocp.problem import Problem, load_problem
from mbocp_papers.pendulums.data import Strategy

Form = Literal["lagrange", "penalty", "tracking"]

_PENALTY: Mapping[str, Any] = {"goal.enforce": "penalty", "cost.terminal": 1.0, "cost.effort": 1e-3}


@dataclass(frozen=True)
class System:
    """One of the paper's systems.

    Attributes
    ----------
    name : str
        Stem of its problem file.
    title : str
    section : str
        Where the paper treats it.
    forms : tuple of str
        How the end is enforced in its table, the form of the paper's DOF column first: "lagrange"
        (gamma = 1), "penalty" (gamma = 0, beta_T = 1, alpha = 1e-3), or "tracking" (no end condition).
    """

    name: str
    title: str
    section: str
    forms: tuple[Form, ...]


SYSTEMS: Mapping[str, System] = {
    system.name: system
    for system in (
        System("elastic_pendulum", "3D elastic pendulum", "6.1", ("lagrange",)),
        System("rigid_pendulum", "3D rigid pendulum", "6.2", ("penalty", "lagrange")),
        System("cart_pendulum_rigid", "2D rigid pendulum on a cart", "6.3.1", ("tracking",)),
        System("cart_pendulum_elastic", "2D elastic pendulum on a cart", "6.3.2", ("tracking",)),
    )
}


def problem_file(name: str) -> Path:
    """Where the problem file of a system is: in the installed package, or in examples/paper of the sources.

    Raises
    ------
    ProblemFileError
        If there is none: mbocp is not installed as it should be.
    """
    package = Path(mbocp.__file__).resolve().parent
    places = [
        folder / f"{name}.toml"
        for folder in (package / "data" / "paper", package.parent / "examples" / "paper")
    ]
    for place in places:
        if place.is_file():
            return place
    looked = " and ".join(str(place.parent) for place in places)
    raise ProblemFileError(f"{name}.toml", f"not found in {looked}; install mbocp again, or from its sources")


def paper_problem(
    name: str, form: Form, steps: int | None = None, settings: Mapping[str, Any] | None = None
) -> Problem:
    """Problem of the paper.

    Parameters
    ----------
    name : str
        Key of `SYSTEMS`.
    form : {"lagrange", "penalty", "tracking"}
    steps : int, optional
        N; default: that of the problem file, dt = 0.01 s.
    settings : mapping, optional
        Further changes of the problem file, by dotted key.
    """
    changes: dict[str, Any] = dict(_PENALTY) if form == "penalty" else {}
    if steps is not None:
        changes["horizon.steps"] = steps
    return load_problem(problem_file(name), {**changes, **(settings or {})})


def strategy_settings(
    strategy: Strategy, globalisation: str = "default", gradient_iterations: int = 25
) -> dict[str, Any]:
    """Settings of a problem file that choose a strategy.

    The hybrids switch after a fixed number of gradient iterations, as in the paper's tables, and not where
    section 5.3 would let them.
    """
    settings: dict[str, Any] = {
        "solver.method": strategy.method,
        "solver.globalisation": globalisation,
        "solver.adjoint": strategy.adjoint,
    }
    if strategy.is_hybrid:
        settings |= {
            "solver.switch_residual": 0.0,
            "solver.switch_cost": 0.0,
            "solver.switch_iterations": gradient_iterations,
            "solver.theta_max": 1.0,
        }
    return settings

"""How the problem is solved."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from mbocp.problem._checks import check_choice, check_integer, check_positive

__all__ = ["GLOBALISATIONS", "METHODS", "Globalisation", "SolverOptions"]

Globalisation = Literal["default", "none"]

METHODS: tuple[str, ...] = ("monolithic",)
GLOBALISATIONS: tuple[Globalisation, ...] = ("default", "none")


@dataclass(frozen=True, kw_only=True)
class SolverOptions:
    """Choice of the solver and of its stopping rule.

    Attributes
    ----------
    method : {"monolithic"}
        All optimality conditions of all steps as one system, by Newton's method.
    globalisation : {"default", "none"}
        ``none`` is the paper's pure Newton method; ``default`` corrects the inertia and searches along the
        step, and so ends at a minimum.
    tolerance : float
        The solver has converged when residual and increment are both below it. The paper's 1e-9.
    max_iterations : int
        Newton steps before the solver gives up.
    """

    method: str = "monolithic"
    globalisation: Globalisation = "default"
    tolerance: float = 1e-9
    max_iterations: int = 200

    def __post_init__(self) -> None:
        check_choice("solver.method", self.method, METHODS)
        check_choice("solver.globalisation", self.globalisation, GLOBALISATIONS)
        object.__setattr__(self, "tolerance", check_positive("solver.tolerance", self.tolerance))
        object.__setattr__(
            self, "max_iterations", check_integer("solver.max_iterations", self.max_iterations, minimum=1)
        )

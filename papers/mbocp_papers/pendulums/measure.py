"""One strategy on one problem: how it ended, in how many iterations, in what time."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from statistics import median
from typing import Any

from mbocp.exceptions import MbocpError
from mbocp.problem import Problem
from mbocp.solution import Solution, Status
from mbocp.solving import solve
from mbocp.study.run_task import NO_SOLVER, solver_seconds
from mbocp_papers.pendulums.cases import Form, paper_problem, strategy_settings
from mbocp_papers.pendulums.data import Strategy

_LONG_ENOUGH = 0.3  # [s] of repeated runs; longer ones need no median
_SAME_COST = 1e-8  # relative: the optimum is flat, and both runs end within 1e-9 of it


@dataclass(frozen=True)
class Run:
    """A strategy on a problem.

    Attributes
    ----------
    status : str
        Of the solution; the class of the error where there is none.
    advice : str
    iterations : tuple of int
        Of each phase of the solver.
    seconds : float
        Wall time of the solver's phases, without compilation, guess and diagnostics; the median of the
        repetitions [s].
    solution : Solution or None
    """

    status: str
    advice: str
    iterations: tuple[int, ...] = ()
    seconds: float = math.nan
    solution: Solution | None = None

    @property
    def converged(self) -> bool:
        """Whether the tolerances were met."""
        return self.solution is not None and self.solution.converged

    @property
    def is_minimum(self) -> bool:
        """Whether what was found is a strict local minimum."""
        return self.converged and "strict local minimum" in self.advice

    @property
    def cost(self) -> float:
        """Objective at the end; NaN without a solution."""
        return self.solution.cost if self.solution is not None else math.nan

    @property
    def count(self) -> str:
        """Iterations as the paper writes them: 15, 25+6."""
        return "+".join(map(str, self.iterations)) or "-"

    def agrees_with(self, other: Run) -> bool:
        """Whether both found the same optimum, by its cost."""
        return self.converged and other.converged and math.isclose(self.cost, other.cost, rel_tol=_SAME_COST)

    def to_dict(self) -> dict[str, Any]:
        """As plain values, for JSON."""
        return {
            "status": self.status,
            "iterations": list(self.iterations),
            "seconds": finite(self.seconds),
            "cost": finite(self.cost),
            "is_minimum": self.is_minimum,
        }


def run_strategy(
    system: str,
    form: Form,
    steps: int,
    strategy: Strategy,
    *,
    globalisation: str = "default",
    gradient_iterations: int = 25,
    repetitions: int = 1,
) -> Run:
    """Measure a strategy on one of the paper's problems; an error of mbocp becomes the run's status."""
    settings = strategy_settings(strategy, globalisation, gradient_iterations)
    try:
        return measure(paper_problem(system, form, steps, settings), repetitions)
    except MbocpError as error:
        return Run(type(error).__name__, str(error))


def measure(problem: Problem, repetitions: int = 1) -> Run:
    """Solve once, and, where that is quick, up to `repetitions` times more for the time alone.

    The first of several runs is a rehearsal: it compiles or loads the functions and fills the caches.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a table has its own way to say that a run went wrong
        solution = solved(problem)
        times = [solver_seconds(solution)]
        if repetitions > 1 and times[0] < _LONG_ENOUGH:
            times = []
            while len(times) < repetitions and sum(times) < _LONG_ENOUGH:
                times.append(solver_seconds(solved(problem)))
    return Run(
        status=str(solution.status),
        advice=solution.advice,
        iterations=tuple(p.iterations for p in solution.phases if p.name not in NO_SOLVER),
        seconds=median(times),
        solution=solution,
    )


def solved(problem: Problem, **how: Any) -> Solution:
    """Solve, but let Ctrl-C end all of it: `solve` itself returns the best iterate."""
    solution = solve(problem, **how)
    if solution.status is Status.INTERRUPTED:
        raise KeyboardInterrupt
    return solution


def finite(value: float) -> float | None:
    """Return None for what JSON has no number for."""
    return value if math.isfinite(value) else None

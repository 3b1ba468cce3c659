"""How the problem is solved, as a user says it."""

from __future__ import annotations

from dataclasses import dataclass

from mbocp._environment import available_threads
from mbocp.exceptions import InvalidValue
from mbocp.problem._checks import check_choice, check_integer, check_number, check_positive
from mbocp.solvers.options import (
    ADJOINTS,
    GLOBALISATIONS,
    HESSIANS,
    LINEAR_SOLVERS,
    LOOPS,
    METHODS,
    Options,
)

_LARGEST_TOLERANCE = 1e-2  # the paper's is 1e-9; half of the residual of rough solves around obstacles


@dataclass(frozen=True, kw_only=True)
class SolverOptions(Options):
    """Choice of the solver and of its stopping rule, checked; `mbocp.solvers.Options` explains them.

    Attributes
    ----------
    starts : int
        Number of guesses from which the problem is solved; the best result is the solution.
    seed : int
        Of the random ones among them.
    threads : int or "auto"
        Threads of a solve, which change no bit of its result; "auto": as many as there are processors.

    Raises
    ------
    InvalidValue
        If an option is none of the words for it, or a number that cannot be right.
    """

    starts: int = 1
    seed: int = 0
    threads: int | str = 1

    def __post_init__(self) -> None:
        check_choice("solver.method", self.method, METHODS)
        check_choice("solver.globalisation", self.globalisation, GLOBALISATIONS)
        check_choice("solver.hessian", self.hessian, HESSIANS)
        check_choice("solver.adjoint", self.adjoint, ADJOINTS)
        check_choice("solver.loop", self.loop, LOOPS)
        check_choice("solver.linear_solver", self.linear_solver, LINEAR_SOLVERS)
        for key in ("tolerance", "theta_max"):
            object.__setattr__(self, key, check_positive(f"solver.{key}", getattr(self, key)))
        if self.tolerance > _LARGEST_TOLERANCE:
            raise InvalidValue(
                "solver.tolerance",
                self.tolerance,
                f"at most {_LARGEST_TOLERANCE:g}: with larger residuals a motion does not keep its equations",
            )
        for key, least in (("starts", 1), ("seed", 0)):
            number = check_integer(f"solver.{key}", getattr(self, key), minimum=least)
            object.__setattr__(self, key, number)
        if isinstance(self.threads, str):
            check_choice("solver.threads", self.threads, ("auto",), "or a whole number of at least 1")
        else:
            object.__setattr__(self, "threads", check_integer("solver.threads", self.threads, minimum=1))
        if self.max_iterations is not None:
            limit = check_integer("solver.max_iterations", self.max_iterations, minimum=1)
            object.__setattr__(self, "max_iterations", limit)
        if self.time_limit is not None:
            limit_s = check_positive("solver.time_limit", self.time_limit, "s")
            object.__setattr__(self, "time_limit", limit_s)
        for key in ("switch_residual", "switch_cost"):
            value = check_number(f"solver.{key}", getattr(self, key))
            if value < 0.0:
                raise InvalidValue(f"solver.{key}", value, "a number >= 0; 0 switches the criterion off")
            object.__setattr__(self, key, value)
        steps = check_integer("solver.switch_iterations", self.switch_iterations, minimum=1)
        object.__setattr__(self, "switch_iterations", steps)

    @property
    def num_threads(self) -> int:
        """Number of threads of a solve here: no more than processors, one where others work beside us."""
        available = available_threads()
        return available if self.threads == "auto" else min(int(self.threads), available)

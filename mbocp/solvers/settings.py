"""What a strategy knows about how to solve: the user's options, and what follows from the programme."""

from __future__ import annotations

from dataclasses import replace

from mbocp._arrays import dataclass
from mbocp.programme import StagewiseProgramme
from mbocp.solvers.options import Options, Switch

_INTERIOR_ITERATIONS, _GRADIENT_ITERATIONS = 1000, 5000
_UNHURRIED_ITERATIONS = 1500  # of Newton's method, where somebody watches whether it makes progress


@dataclass(frozen=True)
class SolverSettings:
    """The options of a problem, for one programme.

    Attributes
    ----------
    options : Options
    control_weight : float
        Unit of the Hessian's shift, see `StagewiseProgramme`.
    has_inequalities : bool
        Whether there are limits, path constraints or guards.
    is_doubtful : bool
        Whether IPOPT has found the problem infeasible from another guess: `auto` does not ask it again.
    time_limit : float or None
        What is left of the options' [s].
    is_careful : bool
        Whether Newton's method is to change its shift by small factors.
    rough : float
        Residual with which Newton's method may end, whatever the increment; 0: it is to converge.
    threads : int
        Share the work of Newton's method on the stages.
    most : int or None
        Limit of iterations in the place of the options'; None: theirs holds.
    """

    options: Options
    control_weight: float
    has_inequalities: bool = False
    is_doubtful: bool = False
    time_limit: float | None = None
    is_careful: bool = False
    rough: float = 0.0
    threads: int = 1
    most: int | None = None

    @classmethod
    def of(
        cls,
        options: Options,
        programme: StagewiseProgramme,
        *,
        has_inequalities: bool = False,
        threads: int = 1,
    ) -> SolverSettings:
        """Settings with the options of a problem."""
        return cls(
            options,
            programme.control_weight,
            has_inequalities=has_inequalities,
            time_limit=options.time_limit,
            threads=threads,
        )

    @property
    def tolerance(self) -> float:
        """Of residual and increment, of all methods."""
        return self.options.tolerance

    @property
    def switch(self) -> Switch:
        """When a hybrid goes over to Newton's method."""
        o = self.options
        return Switch(o.switch_residual, o.switch_cost, o.switch_iterations)

    @property
    def max_iterations(self) -> int | None:
        """Limit of iterations; None: each method has its own."""
        return self.options.max_iterations if self.most is None else self.most

    @property
    def newton_iterations(self) -> int:
        """Limit of a Newton method."""
        return self.options.newton_iterations if self.most is None else self.most

    @property
    def gradient_iterations(self) -> int:
        """Limit of `fbsm_bb` on its own."""
        limit = self.max_iterations
        return _GRADIENT_ITERATIONS if limit is None else limit

    def is_spent(self, taken: int) -> bool:
        """Whether so many iterations use up the limit of all phases together."""
        limit = self.max_iterations
        return limit is not None and taken >= limit

    def within(self, taken: int) -> SolverSettings:
        """Settings with what so many iterations leave of their limit, one at least."""
        limit = self.max_iterations
        return self if limit is None else replace(self, most=max(1, limit - taken))

    def with_patience(self) -> SolverSettings:
        """Settings for a Newton method that may go on while it makes progress, if the user sets no limit."""
        return self if self.max_iterations is not None else replace(self, most=_UNHURRIED_ITERATIONS)

    def interior_iterations(self, taken: int) -> int:
        """Limit of an interior-point method after so many iterations of others."""
        limit = self.max_iterations
        return _INTERIOR_ITERATIONS if limit is None else limit - taken

"""How a problem is solved: the user's options, and what follows from the programme."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from mbocp._arrays import dataclass
from mbocp.programme import StagewiseProgramme

SOLVER_TOLERANCE = 1e-9  # of residual and increment, unless the problem says otherwise: the paper's

Globalisation = Literal["default", "none"]

METHODS: tuple[str, ...] = (
    "auto",
    "monolithic",
    "fbsm_newton",
    "fbsm_bb",
    "fbsm_bb+monolithic",
    "fbsm_bb+fbsm_newton",
    "ipopt",
    "fatrop",
)
BOUNDED_METHODS: tuple[str, ...] = (
    "auto",
    "monolithic",
    "ipopt",
    "fatrop",
)  # those that keep limits and path constraints
GLOBALISATIONS: tuple[Globalisation, ...] = ("default", "none")
HESSIANS: tuple[str, ...] = ("structured", "dense", "finite-difference")
ADJOINTS: tuple[str, ...] = ("direct", "auxiliary")
LOOPS: tuple[str, ...] = ("auto", "open", "closed")
LINEAR_SOLVERS: tuple[str, ...] = ("auto", "mumps", "ma27")

_NEWTON_ITERATIONS = 200


@dataclass(frozen=True, kw_only=True)
class Options:
    r"""Choice of the solver and of its stopping rule; `mbocp.problem.SolverOptions` checks what a user says.

    Attributes
    ----------
    method : str
        ``monolithic``: all optimality conditions of all steps as one system, by Newton's method (section
        5.1). ``fbsm_newton``: Newton's method on the controls alone, with a forward sweep for the state and a
        backward sweep for the adjoint (5.2). ``fbsm_bb``: gradient steps of Barzilai-Borwein length between
        the same sweeps. ``fbsm_bb+monolithic``, ``fbsm_bb+fbsm_newton``: gradient steps first, then Newton's
        (5.3). ``ipopt``, ``fatrop``: interior-point methods. Limits and path constraints are kept by these
        two and by ``monolithic``, with a barrier of its own. ``auto`` starts with ``monolithic``; when that
        makes no progress it goes over to ``ipopt`` where there are limits, and else to the others.
    globalisation : {"default", "none"}
        Of the Newton methods. ``none`` is the paper's: no safeguards for ``monolithic``, halving the step
        until :math:`\|r_u\|` falls for ``fbsm_newton``. ``default`` corrects the inertia and searches along
        the step, and so ends at a minimum.
    tolerance : float
        The solver has converged when residual and increment are both below it (``fbsm_bb``: the residual).
        The paper's 1e-9.
    max_iterations : int or None
        Steps before the solver gives up. None: 200 for the Newton methods, 5000 for ``fbsm_bb``; ``auto``
        goes on with ``monolithic`` to 1500 while it makes progress. A number is the limit of a hybrid's
        Newton phase, and of all phases of ``auto`` together.
    hessian : {"structured", "dense", "finite-difference"}
        How ``fbsm_newton`` gets its step: by the structured factorisation, in linear time; from the dense
        matrix K of Algorithm 2, exact; or from K by finite differences, the paper's.
    adjoint : {"direct", "auxiliary"}
        How the backward sweep gets the adjoint: with the end condition's multiplier, eq. (30), or as
        :math:`\mu = \sigma + A\eta`, eqs. (33) to (44).
    loop : {"auto", "open", "closed"}
        Whether the sweeps of the staggered solvers run in open loop, the paper's, or in closed loop: with
        controls that answer deviations from the states of the iterate before, without which the sweeps of an
        unstable robot explode. ``auto`` closes it where it has to be. (``globalisation = "none"``: open.)
    theta_max : float
        :math:`\theta_{max}`, the longest gradient step of ``fbsm_bb`` (Euclidean norm over all controls
        [N, N m]): the stabilisation of the Barzilai-Borwein step.
    switch_residual, switch_cost, switch_iterations : float, float, int
        A hybrid goes over to Newton's method when the residual is below `switch_residual`, or the cost below
        this part of the guess's, or after so many gradient steps. 0 switches one of the first two off.
    time_limit : float or None
        Wall time after which the solve is given up, compiling included [s]; None: never.
    linear_solver : {"auto", "mumps", "ma27"}
        Of ``ipopt``.
    """

    method: str = "auto"
    globalisation: Globalisation = "default"
    tolerance: float = SOLVER_TOLERANCE
    max_iterations: int | None = None
    hessian: str = "structured"
    adjoint: str = "direct"
    loop: str = "auto"
    theta_max: float = 1.0
    switch_residual: float = 10.0
    switch_cost: float = 0.5
    switch_iterations: int = 25
    time_limit: float | None = None
    linear_solver: str = "auto"

    @property
    def is_interior_point(self) -> bool:
        """Whether the method itself is one of those that keep limits."""
        return self.method in ("ipopt", "fatrop")

    @property
    def is_pure_newton(self) -> bool:
        """Whether Newton's method is asked for without safeguards."""
        return self.globalisation == "none" and not self.is_interior_point

    @property
    def newton_iterations(self) -> int:
        """Limit of a Newton method."""
        return _NEWTON_ITERATIONS if self.max_iterations is None else self.max_iterations


@dataclass(frozen=True)
class Switch:
    """When a hybrid goes over to Newton's method, step 2 of section 5.3; 0 switches a criterion off.

    Attributes
    ----------
    residual : float
        Once r_u is smaller.
    cost : float
        Once the cost is below this part of the guess's.
    iterations : int
        After so many steps.
    """

    residual: float = 10.0
    cost: float = 0.5
    iterations: int = 25


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
    is_newton_alone : bool
        Whether `auto` within limits ends before IPOPT.
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
    is_newton_alone: bool = False

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

"""How a problem is solved: from which guess, and with which options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp._environment import available_threads
from mbocp._keys import Check, Key, Table, checks_of
from mbocp.exceptions import DimensionMismatch, InvalidValue, ProblemError
from mbocp.problem._checks import (
    check_choice,
    check_finite,
    check_integer,
    check_number,
    check_positive,
    choice,
    positive,
    whole,
)
from mbocp.solvers.added import find_added_solvers
from mbocp.solvers.options import ADJOINTS, GLOBALISATIONS, HESSIANS, LINEAR_SOLVERS, LOOPS, METHODS, Options
from mbocp.terms.written import Finite

GuessKind = Literal["auto", "control", "line", "way", "at_rest", "hold", "joint", "solution"]

GUESSES: tuple[GuessKind, ...] = ("auto", "control", "line", "way", "at_rest", "hold", "joint", "solution")

_OWNERS = (
    ("u", "u", "control"),
    ("q", "q", "way"),
    ("path", "file", "solution"),
    ("at", "at", "solution"),
)  # attribute, key of the file and the kind that it belongs to


@dataclass(frozen=True, kw_only=True, eq=False)
class Guess:
    """Initial guess of the trajectory.

    Attributes
    ----------
    kind : {"auto", "control", "line", "way", "at_rest", "hold", "joint", "solution"}
        ``control``: a constant control and the forward simulation with it (the paper's);
        ``line``: a straight line in the configuration space with inverse dynamics;
        ``way``: straight lines through given configurations, as a path planner finds them;
        ``at_rest``: the same line with all velocities and controls zero, which no dynamics agree with;
        ``hold``: stay at the start with gravity compensated;
        ``joint``: the optimum in joint coordinates, for natural coordinates only;
        ``solution``: a saved solution, of any number of steps;
        ``auto``: what suits the problem.
    u : ndarray, shape (nu,), optional
        The constant control, for ``control`` only [N, N m].
    path : Path, optional
        The saved solution, for ``solution`` only.
    q : ndarray, shape (n, nq), optional
        Configurations between start and goal, for ``way`` only.
    at : float, optional
        Time [s] on the motion of the saved solution at which the problem begins, for ``solution`` only; None:
        it is found.
    """

    kind: GuessKind = "auto"
    u: Array | None = None
    path: Path | None = None
    q: Array | None = None
    at: float | None = None

    def __post_init__(self) -> None:
        check_choice("guess.kind", self.kind, GUESSES)
        if self.u is not None:
            u = frozen_array(self.u, shape=(None,), name="guess.u")
            check_finite("guess.u", u)
            object.__setattr__(self, "u", u)
        if self.q is not None:
            q = frozen_array(self.q, shape=(None, None), name="guess.q")
            check_finite("guess.q", q)
            object.__setattr__(self, "q", q)
        if self.path is not None:
            object.__setattr__(self, "path", Path(self.path))
        if self.at is not None:
            object.__setattr__(self, "at", float(self.at))
            check_finite("guess.at", np.array([self.at]))
        for key, file_key, owner in _OWNERS:
            given = getattr(self, key) is not None
            if self.kind == owner and not given and key != "at":
                raise ProblemError(f'guess: kind = "{owner}" needs the key {file_key!r}')
            if self.kind != owner and given:
                raise ProblemError(
                    f'guess.{file_key}: only used with kind = "{owner}", got kind = "{self.kind}"'
                )

    def check_dimensions(self, nq: int, nu: int) -> None:
        """Refuse what does not fit a robot of `nq` coordinates with `nu` actuators."""
        if self.u is not None and self.u.shape != (nu,):
            raise DimensionMismatch("guess.u", self.u.shape, (nu,))
        if self.q is not None and self.q.shape[1:] != (nq,):
            raise DimensionMismatch("guess.q", self.q.shape, (None, nq))


MENU = "menu"  # in the place of a number of starts
_LARGEST_TOLERANCE = 1e-2  # the paper's is 1e-9; half of the residual of rough solves around obstacles


def _tolerance(key: str, value: Any) -> float:
    number = check_positive(key, value)
    if number > _LARGEST_TOLERANCE:
        expected = (
            f"at most {_LARGEST_TOLERANCE:g}: with larger residuals a motion does not keep its equations"
        )
        raise InvalidValue(key, number, expected)
    return number


def _method(key: str, value: Any) -> str:
    known = value in METHODS
    return check_choice(key, value, METHODS if known else (*METHODS, *sorted(find_added_solvers().names)))


def _threshold(key: str, value: Any) -> float:
    number = check_number(key, value)
    if number < 0.0:
        raise InvalidValue(key, number, "a number >= 0; 0 switches the criterion off")
    return number


def _whole_or(word: str) -> Check:
    def work(key: str, value: Any) -> int | str:
        if isinstance(value, str):
            return check_choice(key, value, (word,), "or a whole number of at least 1")
        return check_integer(key, value, minimum=1)

    schema = {"anyOf": [{"type": "integer", "minimum": 1}, {"const": word}]}
    return Check(f'whole number > 0 or `"{word}"`', schema, work=work)


_METHODS = choice(METHODS)
_THRESHOLD = Check("number >= 0", {"minimum": 0}, work=_threshold)


@dataclass(frozen=True, kw_only=True)
class SolverOptions(Options):
    """Choice of the solver and of its stopping rule, checked; `mbocp.solvers.Options` explains them.

    Attributes
    ----------
    starts : int or "menu"
        Number of guesses from which the problem is solved, or the ways of a menu; the best result is the
        solution.
    seed : int
        Of the random ones among them.
    threads : int or "auto"
        Threads of a solve, which change no bit of its result; "auto": as many as there are processors.

    Raises
    ------
    InvalidValue
        If an option is none of the words for it, or a number that cannot be right.
    """

    starts: int | str = 1
    seed: int = 0
    threads: int | str = 1

    def __post_init__(self) -> None:
        for key, check in _CHECKS.items():
            value = getattr(self, key)
            if value is not None or getattr(SolverOptions, key) is not None:
                object.__setattr__(self, key, check(f"solver.{key}", value))

    @property
    def num_starts(self) -> int:
        """Number of guesses of one solve; each way of a menu is one of its own."""
        return 1 if self.starts == MENU else int(self.starts)

    @property
    def num_threads(self) -> int:
        """Number of threads of a solve here: no more than processors, one where others work beside us."""
        available = available_threads()
        return available if self.threads == "auto" else min(int(self.threads), available)


class SolverTable(Table):
    """How the problem is solved; `mbocp.solvers.Options` explains the methods."""

    method: Annotated[
        str,
        Check(_METHODS.takes, _METHODS.schema, work=_method),
        Key("[which does what](solver.md#which-solver)"),
    ] = SolverOptions.method
    globalisation: Annotated[
        str, choice(GLOBALISATIONS), Key('`"none"`: the paper\'s methods, without safeguards')
    ] = SolverOptions.globalisation
    tolerance: Annotated[
        Finite,
        Check("number > 0", {"exclusiveMinimum": 0, "maximum": _LARGEST_TOLERANCE}, work=_tolerance),
        Key("of residual and increment"),
    ] = SolverOptions.tolerance
    max_iterations: Annotated[
        int | None, whole(1), Key("steps before a method gives up", default='200; 5000 for `"fbsm_bb"`')
    ] = SolverOptions.max_iterations
    hessian: Annotated[str, choice(HESSIANS), Key("of `fbsm_newton`")] = SolverOptions.hessian
    adjoint: Annotated[str, choice(ADJOINTS), Key("of the sweeps")] = SolverOptions.adjoint
    loop: Annotated[str, choice(LOOPS), Key("of the sweeps")] = SolverOptions.loop
    theta_max: Annotated[Finite, positive(), Key("longest gradient step", "N, N m")] = SolverOptions.theta_max
    switch_residual: Annotated[Finite, _THRESHOLD, Key("a hybrid switches below this residual; 0: never")] = (
        SolverOptions.switch_residual
    )
    switch_cost: Annotated[Finite, _THRESHOLD, Key("or below this part of the guess's cost; 0: never")] = (
        SolverOptions.switch_cost
    )
    switch_iterations: Annotated[int, whole(1), Key("or after so many gradient steps")] = (
        SolverOptions.switch_iterations
    )
    time_limit: Annotated[
        Finite | None,
        positive("s"),
        Key("wall time; else [twenty times](solver.md#when-attempts-fail) the first attempt", "s"),
    ] = SolverOptions.time_limit
    linear_solver: Annotated[str, choice(LINEAR_SOLVERS), Key("of `ipopt`")] = SolverOptions.linear_solver
    starts: Annotated[
        int | str,
        _whole_or(MENU),
        Key("[guesses](solver.md#several-starts), or ways of a [menu](menu.md), of which the best is taken"),
    ] = SolverOptions.starts
    seed: Annotated[int, whole(0), Key("of the random guesses among them", takes="whole number")] = (
        SolverOptions.seed
    )
    threads: Annotated[
        int | str, _whole_or("auto"), Key('[threads](solver.md#threads); `"auto"`: as many as processors')
    ] = SolverOptions.threads


_CHECKS = checks_of(SolverTable)

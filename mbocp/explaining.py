"""Why a problem has no solution: what arithmetic tells, and else which limit has to give, and by how much."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import MbocpError
from mbocp.problem.limits import LIMITS, Bounds
from mbocp.problem.path import PathConstraint
from mbocp.problem.problem import Problem
from mbocp.problem.reasons.cause import Cause
from mbocp.problem.reasons.causes import causes_of
from mbocp.solution import Solution
from mbocp.solving import solve

_ITERATIONS = 150  # of a solve; a problem that is solvable takes some thirty
_CLOSE = 1.03  # factors nearer to each other than this are not told apart
_LETTERS = {key.removeprefix("limits."): letter for letter, key in LIMITS.items()}
_STORED = ("u", "v", "q")  # whose values a solution has
_TINY = 1e-9
_WIDEST = {"q": 4.0, "v": 30.0}  # times what there is, by letter of `LIMITS`
_WIDEST_OTHER = 300.0
_LONGEST = 8.0
_SMALL = 0.1  # [m, m/s, rad] by which a bound near zero is widened


@dataclass(frozen=True, eq=False)
class Remedy:
    """A kind of limit that makes the problem solvable when it gives.

    Parameters
    ----------
    kind : str
        A key of `[limits]`, "duration", "obstacle" or "path NAME".
    factor : float
        Smallest factor found; infinite where it has to go.
    words : str
        One line: which joint, when, how much.
    """

    kind: str
    factor: float
    words: str


@dataclass(frozen=True, eq=False)
class Explanation:
    """What was found.

    Parameters
    ----------
    causes : tuple of Cause
        What arithmetic tells.
    given : tuple of Remedy
        Limits of which each makes the problem solvable by itself, the smallest step first; empty where
        causes are certain, or nobody looked.
    is_solvable : bool
        Whether the problem as it is was solved while looking.
    words : str
        Where neither says anything: what is known.
    """

    causes: tuple[Cause, ...]
    given: tuple[Remedy, ...] = ()
    is_solvable: bool = False
    words: str = ""


def explain(
    problem: Problem, *, search: bool = True, tell: Callable[[str], object] | None = None
) -> Explanation:
    """Say why a problem cannot be solved.

    Parameters
    ----------
    problem : Problem
    search : bool
        Where no cause is certain, solve it with limits that are wider and wider: some dozens of solves.
    tell : callable, optional
        Called with a line on what is looked at.
    """
    causes = causes_of(problem)
    if any(cause.is_certain for cause in causes) or not search:
        return Explanation(causes)
    say = tell or (lambda _: None)
    say("as it is")
    if _solve(problem, None) is not None:
        return Explanation(causes, is_solvable=True)
    found = []
    for relaxation in relaxations(problem):
        is_time = relaxation.kind == "duration"
        say("with a longer duration" if is_time else f"with more room for {relaxation.kind}")
        given = _find_factor(problem, relaxation)
        found += [given] if given is not None else []
    found.sort(key=lambda one: one.factor)
    return Explanation(causes, tuple(found), words="" if found else _without_all(problem, say))


def _find_factor(problem: Problem, relaxation: Relaxation) -> Remedy | None:
    """Smallest factor of one kind of limit; None if it does not help."""
    solution = _relax(relaxation, relaxation.widest, None)
    if solution is None:
        return None
    if not relaxation.is_gradual:
        return Remedy(
            relaxation.kind,
            math.inf,
            "without obstacles and self_collision it is solved: they are in the way",
        )
    low, high = 1.0, relaxation.widest
    while high / low > _CLOSE:
        middle = math.sqrt(low * high)
        again = _relax(relaxation, middle, solution)
        if again is None:
            low = middle
        else:
            high, solution = middle, again
    return Remedy(relaxation.kind, high, _words(problem, relaxation, high, solution))


def _relax(relaxation: Relaxation, factor: float, near: Solution | None) -> Solution | None:
    try:
        problem = relaxation.problem(factor)
    except MbocpError:
        return None
    found = _solve(problem, near)
    return found if found is not None or near is None else _solve(problem, None)


def _solve(problem: Problem, near: Solution | None) -> Solution | None:
    """The solution, if Newton's method finds one."""
    options = replace(
        problem.solver, method="monolithic", starts=1, max_iterations=_ITERATIONS, time_limit=None
    )
    try:
        solution = solve(problem.with_(solver=options), warm_start=near)
    except MbocpError:
        return None
    return solution if solution.converged else None


def _words(problem: Problem, relaxation: Relaxation, factor: float, solution: Solution) -> str:
    kind = relaxation.kind
    if kind == "duration":
        T = (problem.duration_range or (0.0, problem.duration))[1]
        return f"in {factor * T:.3g} s in place of {T:.4g} s it is solved{_contact(solution)}"
    letter = _LETTERS.get(kind, "")
    if letter in _STORED:
        return _largest(problem, letter, factor, solution)
    name = kind if kind.startswith("path ") else f"limits.{kind}"
    return f"{name} would have to be {factor:.3g} times as wide{_contact(solution)}"


def _largest(problem: Problem, letter: str, factor: float, solution: Solution) -> str:
    """Which entry leaves its limits by the most, where, and when."""
    values = getattr(solution, f"{letter}s")[0 if letter == "u" else 1 :]
    lower, upper = (np.broadcast_to(side, values.shape) for side in problem.limits_along()[letter])
    over = np.fmax(values - upper, lower - values) / _sizes(lower, upper)
    n, i = np.unravel_index(int(np.argmax(np.where(np.isfinite(over), over, -np.inf))), over.shape)
    value, column = values[n, i], getattr(solution.labels, letter)[i]
    bound = upper[n, i] if value - upper[n, i] > lower[n, i] - value else lower[n, i]
    if letter != "q":
        value, bound = abs(value), abs(bound)
    when = solution.t[n if letter == "u" else n + 1]
    return (
        f"{column.name} would need {value:.4g} {column.unit} at {when:.3g} s, and has {bound:.4g} "
        f"{column.unit} ({LIMITS[letter].removeprefix('limits.')}: {factor:.3g} times as wide)"
    )


def _sizes(lower: Array, upper: Array) -> Array:
    """Size of the larger finite bound of each entry."""
    finite = (np.where(np.isfinite(side), np.abs(side), 0.0) for side in (lower, upper))
    return np.fmax(np.fmax(*finite), _TINY)


def _contact(solution: Solution) -> str:
    names = list(dict.fromkeys(f"{limit.kind} {limit.name}" for limit in solution.active_limits))
    return f", with {', '.join(names[:3])} at the limit" if names else ""


def _without_all(problem: Problem, say: Callable[[str], object]) -> str:
    """What is known where no single kind of limit helps."""
    say("with all limits wider")
    wider, names = problem, []
    for relaxation in relaxations(problem):
        try:
            one = next(r for r in relaxations(wider) if r.kind == relaxation.kind)
            wider = one.problem(one.widest)
            names.append(relaxation.kind)
        except (MbocpError, StopIteration):
            continue
    if names and _solve(wider, None) is not None:
        return f"no single kind of limit is to blame: it is solved when {', '.join(names)} give together"
    return (
        "not even without its limits is it solved: another guess, more steps, a softer goal "
        '(goal.enforce = "penalty") or fewer conditions at the end may help'
    )


@dataclass(frozen=True, eq=False)
class Relaxation:
    """One kind of limit that may be widened.

    Parameters
    ----------
    kind : str
        A key of `[limits]`, "duration", "obstacle", or "path NAME".
    widest : float
        Factor beyond which it counts as gone.
    problem : callable
        The problem for a factor of 1 or more.
    is_gradual : bool
        Whether factors between make a difference.
    """

    kind: str
    widest: float
    problem: Callable[[float], Problem]
    is_gradual: bool = True


def relaxations(problem: Problem) -> Iterator[Relaxation]:
    """All kinds of limits that a problem has, the duration last."""
    widest = problem.widest_limits
    for letter, key in LIMITS.items():
        if widest.finite(letter).any():
            most = _WIDEST.get(letter, _WIDEST_OTHER)
            yield Relaxation(key.removeprefix("limits."), most, partial(_with_wider_limits, problem, letter))
    for constraint in problem.frame_constraints:
        if not np.array_equal(constraint.lower, constraint.upper):
            yield Relaxation(
                f"path {constraint.name}", _WIDEST_OTHER, partial(_with_wider_path, problem, constraint.name)
            )
    if problem.obstacle or problem.self_collision is not None:
        yield Relaxation(
            "obstacle", 2.0, lambda _: problem.with_(obstacle=(), self_collision=None), is_gradual=False
        )
    if not problem.phase and not problem.via:
        yield Relaxation("duration", _LONGEST, partial(_with_more_time, problem))


def _with_wider_limits(problem: Problem, letter: str, factor: float) -> Problem:
    phases = tuple(replace(p, limits=_wider(p.limits, letter, factor)) for p in problem.phase)
    return problem.with_(limits=_wider(problem.limits, letter, factor), phase=phases)


def _wider(bounds: Bounds, letter: str, factor: float) -> Bounds:
    lower, upper = bounds.sides(letter)
    if letter == "q":
        lower, upper = _spread(lower, upper, factor)
    else:
        lower, upper = (np.where(np.isfinite(side), factor * side, side) for side in (lower, upper))
    return replace(bounds, **{f"{letter}_lower": lower, f"{letter}_upper": upper})


def _spread(lower: Array, upper: Array, factor: float) -> tuple[Array, Array]:
    """Bounds that are farther apart; a single one moves by its size."""
    with np.errstate(invalid="ignore"):
        width = np.where(np.isfinite(upper - lower), upper - lower, np.nan)
    sizes = np.fmax(*(np.where(np.isfinite(side), np.abs(side), 0.0) for side in (lower, upper)))
    half = 0.5 * (factor - 1.0) * np.fmax(np.where(np.isnan(width), sizes, width), _SMALL)
    return lower - half, upper + half


def _with_wider_path(problem: Problem, name: str, factor: float) -> Problem:
    def widen(constraint: PathConstraint) -> PathConstraint:
        lower, upper = np.asarray(constraint.lower), np.asarray(constraint.upper)
        if constraint.kind == "position":
            lower, upper = _spread(lower, upper, factor)
        else:
            lower, upper = np.where(np.isfinite(lower), lower / factor, lower), factor * upper
        return replace(constraint, lower=lower, upper=upper)

    path = tuple(widen(c) if isinstance(c, PathConstraint) and c.name == name else c for c in problem.path)
    return problem.with_(path=path)


def _with_more_time(problem: Problem, factor: float) -> Problem:
    bounds = problem.duration_range
    longer = None if bounds is None else (bounds[0], factor * bounds[1])
    return problem.with_(duration=factor * problem.duration, duration_range=longer)

"""A problem with one kind of limit widened: what `mbocp explain` looks for when it asks which has to give."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mbocp._arrays import Array
from mbocp.problem.limits import LIMITS, Bounds
from mbocp.problem.path import PathConstraint
from mbocp.problem.problem import Problem

_WIDEST = {"q": 4.0, "v": 30.0}  # times what there is, by letter of `LIMITS`
_WIDEST_OTHER = 300.0
_LONGEST = 8.0
_SMALL = 0.1  # [m, m/s, rad] by which a bound near zero is widened


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
    lower, upper = getattr(bounds, f"{letter}_lower"), getattr(bounds, f"{letter}_upper")
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
    def widened(constraint: PathConstraint) -> PathConstraint:
        lower, upper = np.asarray(constraint.lower), np.asarray(constraint.upper)
        if constraint.kind == "position":
            lower, upper = _spread(lower, upper, factor)
        else:
            lower, upper = np.where(np.isfinite(lower), lower / factor, lower), factor * upper
        return replace(constraint, lower=lower, upper=upper)

    path = tuple(widened(c) if isinstance(c, PathConstraint) and c.name == name else c for c in problem.path)
    return problem.with_(path=path)


def _with_more_time(problem: Problem, factor: float) -> Problem:
    bounds = problem.duration_range
    longer = None if bounds is None else (bounds[0], factor * bounds[1])
    return problem.with_(duration=factor * problem.duration, duration_range=longer)

"""Limits left out first, and brought back in parts.

An interior-point method cuts its steps short of every limit. From a guess that is far from feasible it may
so creep to a point where linearised equations and limits cannot both hold, and call a problem infeasible that
is not. The same problem without limits often has a solution at hand, by full Newton steps. From there limits
are brought back: at once where the motion keeps them nearly, else first so wide that it keeps them, and then
closer part by part, each time from the solution before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.programme.kernel import kernel_programme
from mbocp.solvers.newton_method.limits import why_limits_cannot_be_kept
from mbocp.solvers.records import Status
from mbocp.solvers.strategies.iterating import SolverResult

_FAR = 1e100  # a side that no value gets near, but a number: the row is evaluated
_MOST_RUNS, _MOST_FAILURES = 8, 2

Solve = Callable[[StagewiseProgramme, Iterate], SolverResult | None]


def can_leave_out_limits(programme: StagewiseProgramme) -> bool:
    """Whether there are limits to leave out, and the problem still means something without them.

    Free step lengths need theirs: a step of negative length is none.
    """
    has_some = bool((programme.bounds.limited & ~programme.bounds.are_equations).any())
    return has_some and not programme.has_free_lengths and why_limits_cannot_be_kept(programme) is None


def without_limits(programme: StagewiseProgramme) -> StagewiseProgramme:
    """The programme with equations alone."""
    bounds = programme.bounds
    keep = bounds.are_equations
    return replace(
        programme,
        bounds=bounds.with_sides(np.where(keep, bounds.lower, -np.inf), np.where(keep, bounds.upper, np.inf)),
    )


def measure_excess(programme: StagewiseProgramme, iterate: Iterate) -> tuple[Array, Array]:
    """Return how far an iterate goes beyond its limits at most, by row: below and above, (nx + nu + nh,)."""
    bounds = programme.bounds
    limited, lower, upper = bounds.limited, bounds.lower, bounds.upper
    far = bounds.with_sides(np.where(limited, -_FAR, -np.inf), np.where(limited, _FAR, np.inf))
    native = kernel_programme(replace(programme, bounds=far), has_limits=True)
    iterate.load_into(native)
    native.start_limits(1.0, 0.0)
    values = np.zeros(limited.shape)
    values[limited] = native.slack[: np.count_nonzero(limited)]
    is_limit = limited & ~bounds.are_equations
    below = np.where(is_limit & np.isfinite(lower), lower - values, 0.0)
    above = np.where(is_limit & np.isfinite(upper), values - upper, 0.0)
    return below.max(axis=0, initial=0.0), above.max(axis=0, initial=0.0)


def widen(programme: StagewiseProgramme, width: tuple[Array, Array], part: float) -> StagewiseProgramme:
    """Return the programme with limits farther out by a part of `width`, below and above."""
    bounds = programme.bounds
    return replace(
        programme,
        bounds=bounds.with_sides(bounds.lower - part * width[0], bounds.upper + part * width[1]),
    )


def bring_limits_back(programme: StagewiseProgramme, iterate: Iterate, solve: Solve) -> SolverResult | None:
    """Solve with all limits, from a solution without; return what was stopped, or None if it leads nowhere.

    `solve` returns None where it may not go on.
    """
    width = measure_excess(programme, iterate)
    reached, step, failures = 1.0, 0.5, 0
    for _ in range(_MOST_RUNS):
        part = max(0.0, reached - step)
        found = solve(programme if part == 0.0 else widen(programme, width, part), iterate)
        if found is None:
            return None
        if found.status.is_stopped or (part == 0.0 and found.status is Status.CONVERGED):
            return found
        if found.status is Status.CONVERGED:
            reached, iterate = part, found.iterate
        else:
            step, failures = 0.5 * step, failures + 1
            if failures > _MOST_FAILURES:
                return None
    return None

"""From a solution to a point where its optimality conditions hold to round-off, with its active limits."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.exceptions import InvalidValue, SolverError
from mbocp.formulation import Formulation
from mbocp.formulation.formulate import formulate_with_independent_ends, formulation_in_use
from mbocp.formulation.iterates import take_end_of
from mbocp.problem.obstacles.reserves import with_room
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.sensitivity.kkt import Kkt, Optimum
from mbocp.sensitivity.of_robot import open_words
from mbocp.solution import Solution
from mbocp.solvers.newton_method.held_limits import active_limits
from mbocp.solvers.newton_method.limit_multipliers import compute_bounded_values, explain_limits_not_kept

_GRAIN = 8 * 2.0**-52  # of a bound: distances below it are round-off
_STIFFNESSES = (1.0, 1e3, 1e6)  # at which limits count as active
_ROUNDS = 8  # in which the active limits are found
_WEAK, _NEAR = 1e-8, 1e-6  # of the largest multiplier; of a value's size: below it a limit is degenerate
_STEPS = 8  # of Newton's method from the end of a solve; one or two are typical
_STILL = 1e-10  # a step of it, by the size of what it moves
_FAR = 1e-2  # the first one, likewise: the solution is one of other conditions

_Limits = tuple[Array, Array, BoolArray, Array]


@dataclass(frozen=True, eq=False)
class Found:
    """An optimum in its formulation.

    Attributes
    ----------
    formulation : Formulation
    kkt : Kkt
        Its conditions, which hold to round-off.
    degenerate : tuple of str
        Limits of which it is in doubt whether they are active.
    """

    formulation: Formulation
    kkt: Kkt
    degenerate: tuple[str, ...]


def formulate_again(solution: Solution, wrt: Sequence[str] = ()) -> tuple[Formulation, Iterate]:
    """Formulation that a solution is one of, and its iterate there.

    Parameters
    ----------
    solution : Solution
    wrt : sequence of str
        Words of numbers that functions have to take as parameters.

    Raises
    ------
    SolverError
        If it did not converge.
    InvalidValue
        If it does not hold the solver's last iterate, or is one of several goals.
    """
    if not solution.converged:
        raise SolverError(
            f"sensitivities: the solution is {solution.status}, and only an optimum has derivatives: "
            f"{solution.advice}"
        )
    if solution.problem.robust is not None:
        raise SolverError(
            "sensitivities: the solution is robust, and the room that its limits leave moves with all "
            "numbers; solve without [robust]"
        )
    return formulate_as_solved(solution, wrt)


def formulate_as_solved(solution: Solution, wrt: Sequence[str] = ()) -> tuple[Formulation, Iterate]:
    """The same of any solution, without the room that limits leave for what is uncertain.

    Raises
    ------
    InvalidValue
        If it does not hold the solver's last iterate, or is one of several goals.
    """
    carried = solution.iterate
    if carried is None:
        raise InvalidValue("solution.iterate", None, "the solver's last iterate, as `mbocp.solve` keeps it")
    problem = take_end_of(solution.problem.with_steps_at(solution.t), carried)
    if problem.limits_within != carried.limits_within:
        problem = replace(problem, limits_within=carried.limits_within)
    if problem.goals:
        raise InvalidValue("problem.goals", len(problem.goals), "one goal: that which was reached")
    if carried.room.size:
        problem = with_room(problem, carried.room, solution.t, solution.qs)
    problem = open_words(problem, wrt)
    formulation = formulation_in_use(problem) or formulate_with_independent_ends(problem, math.inf)[0]
    if not carried.fits(formulation.programme):
        raise InvalidValue("solution.iterate", "one of other unknowns", "that of its problem")
    return formulation, carried.into(formulation.programme)


def find_optimum(formulation: Formulation, iterate: Iterate) -> Found:
    """The optimum near an iterate, with its active limits as equations.

    Which these are is a guess, see `mbocp.solvers.newton_method.held_limits`; where it leads nowhere, a
    stricter one follows. What a barrier leaves in doubt is decided where the conditions hold to round-off:
    active limits pull, and others are kept.

    Raises
    ------
    SolverError
        If there is none, or not one with any of these limits active.
    """
    programme = formulation.programme
    for stiffness in _STIFFNESSES[:-1]:
        with suppress(SolverError):
            return _with_decided_limits(formulation, with_active_limits(programme, iterate, stiffness))
    return _with_decided_limits(formulation, with_active_limits(programme, iterate, _STIFFNESSES[-1]))


def _with_decided_limits(formulation: Formulation, optimum: Optimum) -> Found:
    for _ in range(_ROUNDS):
        kkt = Kkt.near(optimum, most_steps=_STEPS, still=_STILL, far=_FAR)
        if optimum.programme.bounds.is_empty:
            return Found(formulation, kkt, ())
        limits = _limits(kkt.optimum)
        optimum = _correct(kkt.optimum, limits)
        if optimum is kkt.optimum:
            return Found(formulation, kkt, _degenerate(optimum, limits))
    raise SolverError(
        "sensitivities: it is in doubt which limits are active at the solution, which has no derivative there"
    )


def _correct(optimum: Optimum, limits: _Limits) -> Optimum:
    """With limits let go that would have to pull the other way, and with those active that are not kept."""
    lower, upper, is_equation, values = limits
    is_upper = optimum.sides == upper
    pulls = np.where(is_upper, optimum.ws, -optimum.ws)
    keeps = optimum.held & ((pulls >= 0.0) | is_equation)
    grain = _GRAIN * np.maximum(1.0, np.abs(values))
    above, below = (~optimum.held & beyond for beyond in (values > upper + grain, values < lower - grain))
    held = keeps | above | below
    if np.array_equal(held, optimum.held):
        return optimum
    sides = np.where(above, upper, np.where(below, lower, optimum.sides))
    return replace(optimum, held=held, sides=np.where(held, sides, 0.0), ws=np.where(held, optimum.ws, 0.0))


def _degenerate(optimum: Optimum, limits: _Limits) -> tuple[str, ...]:
    """Limits that are active with next to no multiplier, or nearly active."""
    lower, upper, is_equation, values = limits
    room = np.minimum(upper - values, values - lower)
    largest = max(np.abs(optimum.ws).max(initial=0.0), np.abs(optimum.iterate.ms).max(initial=0.0))
    has_none = np.abs(optimum.ws) <= _WEAK * largest
    is_near = room <= _NEAR * np.maximum(1.0, np.abs(values))
    chosen = np.where(optimum.held, has_none, is_near) & ~is_equation
    programme = optimum.programme
    rows, limited = programme.kind.ndx + programme.kind.ny, programme.bounds.has_limit
    return tuple(
        programme.describe_row(int(stage), rows + int(np.count_nonzero(limited[stage, :entry])))
        for stage, entry in np.argwhere(chosen)
    )


def _limits(optimum: Optimum) -> _Limits:
    """Lower and upper bounds, which are equations, and the values that they bound."""
    bounds = optimum.programme.bounds
    return (
        bounds.lower,
        bounds.upper,
        bounds.are_equations,
        compute_bounded_values(optimum.programme, optimum.iterate),
    )


def with_active_limits(programme: StagewiseProgramme, iterate: Iterate, stiffness: float = 1.0) -> Optimum:
    """The iterate of a solver with its active limits, as far as its multipliers tell."""
    if explain_limits_not_kept(programme):  # while it eliminates bodies one by one, and not all at once
        programme = replace(programme, kind=replace(programme.kind, groups=()))
    ws, held, sides = active_limits(programme, iterate, stiffness)
    return Optimum(programme, iterate, ws, held, np.where(held, sides, 0.0))

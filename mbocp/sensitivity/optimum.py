"""From a solution to a point where its optimality conditions hold to round-off, with its active limits."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.exceptions import InvalidValue, SolverError
from mbocp.formulation import Formulation
from mbocp.formulation.formulate import formulate_with_independent_ends
from mbocp.problem.obstacles.reserves import with_room
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.sensitivity.kkt import Kkt, Optimum, call, moved
from mbocp.solution import Solution

_GRAIN = 8 * 2.0**-52  # of a bound: distances below it are round-off
_ROUNDS = 8  # in which the active limits are found
_WEAK, _NEAR = 1e-8, 1e-6  # of the largest multiplier; of a value's size: below it a limit is degenerate
_STEPS = 8  # of Newton's method from the end of a solve; one or two are typical
_STILL = 1e-10  # a step of it, by the size of what it moves
_FAR = 1e-2  # the first one, likewise: the solution is one of other conditions


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


def formulate_again(solution: Solution) -> tuple[Formulation, Iterate]:
    """Formulation that a solution is one of, and its iterate there.

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
    carried = solution.iterate
    if carried is None:
        raise InvalidValue("solution.iterate", None, "the solver's last iterate, as `mbocp.solve` keeps it")
    problem = replace(solution.problem, limits_within=carried.limits_within)
    if problem.goals:
        raise InvalidValue("problem.goals", len(problem.goals), "one goal: that which was reached")
    if carried.room.size:
        problem = with_room(problem, carried.room, solution.qs)
    formulation, _ = formulate_with_independent_ends(problem, math.inf)
    if not carried.fits(formulation.programme):
        raise InvalidValue("solution.iterate", "one of other unknowns", "that of its problem")
    return formulation, carried.into(formulation.programme)


def find_optimum(formulation: Formulation, iterate: Iterate) -> Found:
    """The optimum near an iterate, with its active limits as equations.

    A limit is active where its multiplier is larger than the force on a control that is as far from its
    optimum as the motion is from the limit, as in `mbocp.solvers.newton_method.held`. What a barrier leaves
    in doubt is decided where the conditions hold to round-off: active limits pull, and others are kept.

    Raises
    ------
    SolverError
        If there is none, or not one with any of these limits active.
    """
    optimum = with_active_limits(formulation.programme, iterate)
    for _ in range(_ROUNDS):
        kkt = _polished(optimum)
        optimum = _corrected(kkt.optimum)
        if np.array_equal(optimum.held, kkt.optimum.held):
            return Found(formulation, kkt, _degenerate(optimum))
    raise SolverError(
        "sensitivities: it is in doubt which limits are active at the solution, which has no derivative there"
    )


def _corrected(optimum: Optimum) -> Optimum:
    """With limits let go that would have to pull the other way, and with those active that are not kept."""
    lower, upper, is_equation, values = _limits(optimum)
    is_upper = optimum.sides == upper
    pulls = np.where(is_upper, optimum.ws, -optimum.ws)
    keeps = optimum.held & ((pulls >= 0.0) | is_equation)
    grain = _GRAIN * np.maximum(1.0, np.abs(values))
    above, below = (~optimum.held & beyond for beyond in (values > upper + grain, values < lower - grain))
    held = keeps | above | below
    sides = np.where(above, upper, np.where(below, lower, optimum.sides))
    return replace(optimum, held=held, sides=np.where(held, sides, 0.0), ws=np.where(held, optimum.ws, 0.0))


def _degenerate(optimum: Optimum) -> tuple[str, ...]:
    """Limits that are active with next to no multiplier, or nearly active."""
    lower, upper, is_equation, values = _limits(optimum)
    room = np.minimum(upper - values, values - lower)
    largest = max(np.abs(optimum.ws).max(initial=0.0), np.abs(optimum.ms).max(initial=0.0))
    has_none = np.abs(optimum.ws) <= _WEAK * largest
    is_near = room <= _NEAR * np.maximum(1.0, np.abs(values))
    chosen = np.where(optimum.held, has_none, is_near) & ~is_equation
    programme = optimum.programme
    rows, limited = programme.kind.ndx + programme.kind.ny, programme.bounds.limited
    return tuple(
        programme.describe_row(int(stage), rows + int(np.count_nonzero(limited[stage, :entry])))
        for stage, entry in np.argwhere(chosen)
    )


def _limits(optimum: Optimum) -> tuple[Array, Array, BoolArray, Array]:
    """Lower and upper bounds, which are equations, and the values that they bound."""
    bounds = optimum.programme.bounds
    return bounds.lower, bounds.upper, bounds.are_equations, _values(optimum)


def with_active_limits(programme: StagewiseProgramme, iterate: Iterate) -> Optimum:
    """The iterate of a solver with its active limits, as far as its multipliers tell."""
    given, shape = iterate.bounds, programme.bounds.limited.shape
    ws = np.zeros(shape) if given is None else np.hstack([given.xs[1:], given.us, given.path])
    arrays = (iterate.xs, iterate.ys, iterate.us, iterate.ms, iterate.eta, ws)
    nobody = np.zeros(shape, dtype=np.bool_)
    lower, upper, is_equation, values = _limits(Optimum(programme, *arrays, held=nobody, sides=ws))
    distances = np.where(ws > 0.0, upper - values, values - lower)
    forces = programme.control_weight * np.maximum(distances, _GRAIN * np.maximum(1.0, np.abs(values)))
    held = ((np.abs(ws) > forces) & np.isfinite(forces)) | is_equation
    sides = np.where((ws > 0.0) | is_equation, upper, lower)
    return Optimum(programme, *arrays, held=held, sides=np.where(held, sides, 0.0))


def _values(optimum: Optimum) -> Array:
    """States, controls and path functions, shape (N, nx + nu + nh)."""
    programme = optimum.programme
    nh, N = programme.bounds.nh, programme.num_steps
    path = np.zeros((N, 0))
    if nh:
        given = [optimum.xs[1:], optimum.us, programme.theta]
        path = call(programme.functions, "path_values", N, given)[0].dense(nh)
    return np.hstack([optimum.xs[1:], optimum.us, path])


def _polished(optimum: Optimum) -> Kkt:
    """The conditions where they hold, found by Newton's method.

    Raises
    ------
    SolverError
        If that does not stay near.
    """
    length = math.inf
    for number in range(_STEPS):
        kkt = Kkt.at(optimum)
        step = kkt.solve(-kkt.residual[:, None])[:, 0]
        before, length = length, _relative(step, kkt)
        if not length <= (_FAR if number == 0 else before):
            break
        if length <= _STILL:
            return kkt
        optimum = moved(optimum, kkt.places.only(step))
    raise SolverError(
        "sensitivities: the optimality conditions do not hold near the solution with the limits that are "
        f"active there (a Newton step is {length:.1e} of the motion); solve to a smaller tolerance"
    )


def _relative(step: Array, kkt: Kkt) -> float:
    """The largest entry of a step in motion and controls, by the size of these."""
    parts, optimum = kkt.places.split(step[:, None]), kkt.optimum
    pairs = ((parts.xs, optimum.xs), (parts.us, optimum.us))
    return max(
        float(np.abs(move).max(initial=0.0) / (1.0 + np.abs(whole).max(initial=0.0))) for move, whole in pairs
    )

"""When a globalised Newton method has arrived, though round-off keeps residual or increment large."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mbocp._linear import norm
from mbocp.solvers.newton_method.newton import NewtonState, is_resolved
from mbocp.solvers.newton_method.round_off import (
    has_a_say,
    relative_increment,
    round_off,
    round_off_of_terms,
)

if TYPE_CHECKING:
    from mbocp.programme.native import Evaluation

_STALL_RATIO = 0.5  # far above round-off, Newton's method leaves less of residual and increment
_STALL_WITHIN_LIMITS = 0.05  # the same of increments there, which vary more where they are round-off
_RESOLVED = 1e-2  # of the tolerance, for the residual, ...
_AT_REST = 1e-3  # of the tolerance, for the residual before a step that is not worth taking, ...
_FORESEEN = 0.1  # ... and for that step, which is foreseen to a few per cent, ...
_FORESEEN_OF_UNKNOWNS = 1e-3  # ... or relative to the unknowns: long horizons have many, and large norms
STILL = 2  # steps in a row that halve neither residual nor increment
_NOISE = 1e3  # ... and times the tolerance, for increments that do not shrink any more


def has_arrived(state: NewtonState, tolerance: float) -> bool:
    """Whether the residual is far below the tolerance, and increments are round-off, or will be.

    Where steps are short and constraints are many, the multipliers' increments stay above the tolerance
    though the residual is as small as it gets.
    """
    return (
        _is_noise(state, tolerance)
        or _is_centred(state, tolerance)
        or _is_at_rest(state, tolerance)
        or is_within_round_off(state, tolerance)
    )


def _is_noise(state: NewtonState, tolerance: float) -> bool:
    """Whether residual and increments are round-off, which no step makes less.

    With limits multipliers are sums of many others where limits are active from end to end, and jump though
    the motion rests.
    """
    native, is_still = state.native, state.still >= STILL
    if not math.isfinite(state.increment):  # before the first step
        return False
    if not (is_still or state.barrier > 0.0) or not _is_round_off(state, state.increment, tolerance):
        return False
    return is_still or (norm(native.dx) <= tolerance and norm(native.du) <= tolerance)


def _is_round_off(state: NewtonState, increment: float, tolerance: float) -> bool:
    """Whether the residual is far below the tolerance, or about round-off, and an increment may be that, too.

    The longer the horizon, the larger the norms of residual, increment and unknowns. With limits the barrier
    leaves something of the residual by construction, which does not count.
    """
    evaluation, native = state.evaluation, state.native
    left = evaluation.barrier_error if state.barrier else evaluation.residual
    return (
        evaluation.residual <= tolerance
        and (increment <= _NOISE * tolerance or relative_increment(native) <= tolerance)
        and (left <= _RESOLVED * tolerance or left <= max(_round_off(state)))
    )


def leads_no_farther(state: NewtonState, increment: float, tolerance: float) -> bool:
    """Whether a full step of Newton's method that is refused is one among round-off."""
    stuck = state._replace(increment=increment, still=STILL)
    return _is_round_off(stuck, increment, tolerance) or is_within_round_off(stuck, tolerance)


def _round_off(state: NewtonState) -> tuple[float, float]:
    """What round-off may leave of the residual: by the terms themselves where steps have led no farther."""
    if state.still < STILL:
        return round_off(state.native)
    return round_off_of_terms(state.native, state.evaluation)


def _is_at_rest(state: NewtonState, tolerance: float) -> bool:
    """Whether the residual is about round-off, and the next step would be far below the tolerance.

    That step by itself, or relative to the unknowns, the more of which there are, the more round-off it has.
    """
    residual, native = state.evaluation.residual, state.native
    if not math.isfinite(state.next_increment) or residual > tolerance:
        return False
    if residual > max(_AT_REST * tolerance, *round_off(native)):
        return False
    return (
        state.next_increment <= _FORESEEN * tolerance
        or state.contraction * relative_increment(native) <= _FORESEEN_OF_UNKNOWNS * tolerance
    )


def _is_centred(state: NewtonState, tolerance: float) -> bool:
    """Whether all conditions hold with the least barrier that round-off allows, not with the last one."""
    return (
        state.least_barrier > 0.0
        and state.barrier == state.least_barrier
        and state.evaluation.barrier_error <= _RESOLVED * tolerance
        and state.increment <= _NOISE * tolerance
    )


def is_within_round_off(state: NewtonState, tolerance: float) -> bool:
    """Whether round-off is above the tolerance, has a say in the residual, and leaves no more to gain."""
    native, is_still = state.native, state.still >= STILL
    if not (is_still or is_resolved(state, tolerance, round_off(native))):  # the quickest of the questions
        return False
    if relative_increment(native) > tolerance or not is_resolved(state, tolerance, _round_off(state)):
        return False
    return has_a_say(native, state.evaluation)


def stillness(state: NewtonState, evaluation: Evaluation, increment: float) -> int:
    """How many steps in a row, with the one to this evaluation, halved neither residual nor increment."""
    before = state.evaluation.residual
    least = (_STALL_WITHIN_LIMITS if state.barrier else _STALL_RATIO) * state.increment
    is_still = evaluation.residual > _STALL_RATIO * before and increment > least
    return state.still + 1 if is_still else 0

"""How far to go along a Newton step: what the filter accepts, with a second-order correction."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp.solvers.newton_method.newton import Direction, NewtonState

if TYPE_CHECKING:
    from mbocp.programme.native import Evaluation, Trial

MAX_TURN = 1.0  # of a joint in one iteration [rad]: beyond, its linearisation has little to do with it
_CORRECTABLE, _NEARLY = 3.0, 0.1  # violation that is worth a correction: by the iterate's, or in all


def search(state: NewtonState, direction: Direction, shortest: float) -> tuple[float, bool] | None:
    """Step length that the filter accepts and whether for its cost, or None; the kernel has moved.

    The length is relative to the longest step. One with which slacks stop has to lower the violation.
    """
    native, before, longest = state.native, state.evaluation, direction.longest

    def verdict(trial: Trial, length: float) -> tuple[bool, bool]:
        if length > direction.limit and not trial.violation < before.violation:
            return False, False
        return state.filter.accepts(before, trial, direction.slope, length * longest)

    length = 1.0
    while length >= shortest:
        trial = native.trial(length * longest)
        accepted, by_cost = verdict(trial, length)
        if not accepted and length == 1.0 and _is_correctable(before, trial):
            # The corrected direction replaces the plain one in the kernel ...
            corrected = Direction.of(native.correct(longest), MAX_TURN, may_stop=state.may_stop)
            accepted, by_cost = verdict(native.trial(min(longest, corrected.longest)), 1.0)
            if not accepted:
                native.solve()  # ... which has to be had again when that does not help
        if accepted:
            return length, by_cost
        length = direction.shorter(length)
    return None


def _is_correctable(before: Evaluation, trial: Trial) -> bool:
    """Whether a second-order correction may help: a step that went far astray is beyond it."""
    most = max(_CORRECTABLE * before.violation, _NEARLY)
    return trial.finite and before.violation <= trial.violation <= most

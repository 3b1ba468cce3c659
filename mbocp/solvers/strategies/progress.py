"""Whether Newton's method makes progress, as the strategy `auto` sees it from the records of a run."""

from __future__ import annotations

import math
from collections.abc import Sequence

from mbocp.solvers.records import IterationRecord

WINDOW = 40  # iterations in which progress is wanted ...
_PROGRESS = 0.5  # ... by this factor in the residual, ...
_GAIN = 0.02  # ... or by this part of the cost, ...
_FEASIBLE_PART = 0.5  # ... while violations are no more than this part of the residual
_SLOW_GAIN = 1e-4  # of the cost: what is far above round-off gets ...
_LONG_WINDOW = 100  # ... more iterations, if the motion is nearly feasible
_NEARLY = 0.1  # of the largest violation on the way: less is nearly feasible
_LATELY = 10  # iterations: violations go up and down from step to step, and the smallest of a few counts


def has_stalled(history: Sequence[IterationRecord], window: int = WINDOW) -> bool:
    """Whether over the last iterations neither the residual has halved nor the cost fallen by much.

    Far from a minimum the residual may stand still for long while the cost falls from step to step. Near a
    saddle, where the Hessian is indefinite and the gradient small, the cost falls by little at first.
    """
    if not _stands_still(history, window):
        return False
    before, now = history[-window - 1], history[-1]
    is_slow = before.cost - now.cost > _SLOW_GAIN * abs(before.cost) and is_nearly_feasible(history)
    return not is_slow or (len(history) > _LONG_WINDOW and _stands_still(history, max(window, _LONG_WINDOW)))


def is_nearly_feasible(history: Sequence[IterationRecord]) -> bool:
    """Whether a run violates its equations no more than by a small part of what it has on its way."""
    return _least_violation(history) <= _NEARLY * max(r.primal for r in history)


def _stands_still(history: Sequence[IterationRecord], window: int) -> bool:
    if len(history) <= window:
        return False
    residuals = [r.residual if math.isfinite(r.residual) else math.inf for r in history]
    if min(residuals[-window:]) <= _PROGRESS * min(residuals[:-window]):
        return False
    before, now = history[-window - 1], history[-1]
    is_feasible = _least_violation(history) <= max(_FEASIBLE_PART * now.residual, before.primal)
    return not (is_feasible and now.cost < before.cost - _GAIN * abs(before.cost))


def _least_violation(history: Sequence[IterationRecord]) -> float:
    return min(r.primal for r in history[-_LATELY:])

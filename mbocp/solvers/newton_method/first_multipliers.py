"""Multipliers for a first iterate that has none: by least squares, or by a backward sweep along the guess."""

from __future__ import annotations

import numpy as np

from mbocp.solvers.newton_method.newton import NewtonState, factorise
from mbocp.solvers.staggered.multiplier import end_multiplier
from mbocp.solvers.staggered.sweep import Kept, Sweeps

_MAX_ADJOINT = 1e8  # of a backward sweep that is worth starting from
_STIFF = 100.0  # shift with which a Newton step gives multipliers that fit, hardly moving the states
_EXPLAINED = 0.2  # of the gradient: what they may leave


def with_least_squares(state: NewtonState, control_weight: float) -> NewtonState:
    """First iterate with multipliers that leave least of the gradient, where they explain most of it.

    Then they know the curvature that turning bodies add to the Hessian. On drones that took a fifth of the
    iterations, on arms and legs, where they leave more, it cost some.
    """
    native, kind = state.native, state.kind
    is_curved = kind is not None and kind.nx != kind.ndx
    if not is_curved or state.failure is not None or native.m.any() or native.eta.any():
        return state
    factorisation = factorise(state, _STIFF * control_weight)
    if not (factorisation.ok and native.solve().finite):
        return state
    native.m, native.eta = native.dm.copy(), native.deta.copy()
    evaluation = native.evaluate()
    if evaluation.finite and evaluation.dual <= _EXPLAINED * state.evaluation.dual:
        return state._replace(evaluation=evaluation, augmentation=factorisation.augmentation)
    native.m, native.eta = np.zeros_like(native.m), np.zeros_like(native.eta)
    return state._replace(evaluation=native.evaluate())


def with_adjoint(state: NewtonState) -> NewtonState | None:
    """First iterate with the multipliers of a backward sweep; None where it has some, or the sweep explodes.

    With multipliers zero the first Hessian knows nothing of the dynamics' curvature. Often that is the better
    start; where it leads to a short step, it is not.
    """
    native = state.native
    if state.iteration or native.m.any() or native.eta.any():
        return None
    kept = Kept.of(native)
    evaluation = native.gradient()
    if evaluation.finite:
        evaluation = end_multiplier(native, Sweeps())
    if evaluation.finite and 0.0 < np.abs(native.m).max() < _MAX_ADJOINT:
        return state._replace(evaluation=native.evaluate())
    kept.restore(native)
    native.evaluate()
    return None

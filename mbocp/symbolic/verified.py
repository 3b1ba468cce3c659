"""The last line of defence against a native part that does not fit: compare it with numeric Pinocchio."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbocp.exceptions import NativeMismatch
from mbocp.symbolic.algorithms import ModelFunctions
from mbocp.symbolic.model_numbers import ModelNumber, values_of, with_values

# Round-off of a recursion over a hundred joints stays below this, relative to the largest joint force;
# numbers read through a foreign memory layout do not.
TOLERANCE = 1e-8

_CACHE_SIZE = 16  # models; a humanoid's graphs are some ten megabytes
_cache: dict[str, ModelFunctions] = {}


def model_functions(model: pin.Model, given: Sequence[ModelNumber] = ()) -> ModelFunctions:
    """Return the functions of `model`, self-tested: the same object for equal models.

    Parameters
    ----------
    model : pinocchio.Model
        Any model. It is copied: a model that was changed has other functions.
    given : sequence of ModelNumber
        Numbers that the functions take as their last argument: models that differ in these alone share them.

    Raises
    ------
    NativeMismatch
        If the native part does not fit the installed Pinocchio or CasADi.
    """
    key = text_without(model, given)
    functions = _cache.pop(key, None)
    if functions is None:
        functions = ModelFunctions(model, given)
        _compare(model, functions)
    _cache[key] = functions  # the latest last
    while len(_cache) > _CACHE_SIZE:
        _cache.pop(next(iter(_cache)))
    return functions


def text_without(model: pin.Model, given: Sequence[ModelNumber]) -> str:
    """All numbers of a model but those that are given, and which these are; without any, all of it."""
    if not given:
        return str(model.saveToString())
    others = with_values(model, given, np.zeros(len(given)))
    for frame in others.frames:
        frame.inertia = pin.Inertia.Zero()  # what is told of a body's parts; no equation knows it
    return f"{others.saveToString()} {[tuple(number) for number in given]}"


def self_test(model: pin.Model) -> None:
    """Check the symbolic inverse dynamics of `model` against `pinocchio.aba` at a random state.

    Symbolic RNEA must undo numeric ABA. Where ABA does not apply (mimic joints, massless bodies) numeric RNEA
    takes its place. `model_functions` has done this once for each model of the process; a mechanics needs
    RNEA anyway, so it costs little more than one evaluation.

    Raises
    ------
    NativeMismatch
        If the two disagree.
    """
    _compare(model, model_functions(model))


def _compare(model: pin.Model, functions: ModelFunctions) -> None:
    rng = np.random.default_rng(0)
    data = pin.Data(model)  # model.createData() would make it twice, and copy
    # Pinocchio's own generator of random configurations is left alone: its state is the user's.
    numbers = [values_of(model, functions.given)] if functions.given else []
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1.0, 1.0, model.nv))
    v, a = rng.standard_normal((2, model.nv))
    tau = np.array(functions.rnea(q, v, a, *numbers)).ravel()
    reference = pin.rnea(model, data, q, v, a)
    if not len(model.mimicking_joints):
        acceleration = pin.aba(model, data, q, v, tau)
        if np.isfinite(acceleration).all():
            reference = np.array(functions.rnea(q, v, acceleration, *numbers)).ravel()
    error = float(np.abs(tau - reference).max(initial=0.0))
    scale = max(1.0, float(np.abs(tau).max(initial=0.0)))
    if not error <= TOLERANCE * scale:  # written so that NaN fails
        raise NativeMismatch(
            f"mbocp's native part does not agree with the installed Pinocchio {pin.__version__} on model "
            f"{model.name!r}: joint forces differ by {error:.3g} of {scale:.3g} [N, N m]. Reinstall mbocp, "
            "so that it is compiled against this Pinocchio"
        )

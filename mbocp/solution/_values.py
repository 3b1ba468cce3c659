"""Habits of the values in a solution: shapes, comparison, and copies that survive a file."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import Array, frozen_array
from mbocp.exceptions import DimensionMismatch, InvalidValue
from mbocp.storage.content import QUANTITIES, StoredQuantity

_NAMED = ("lam", "zeta", "symmetry", "path")  # axes of which there may be none


def same(a: Any, b: Any) -> bool:
    """Whether two values are equal to the last bit, in depth; NaN equals NaN."""
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=True)
    if isinstance(a, float):
        return a == b or (isinstance(b, float) and math.isnan(a) and math.isnan(b))
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and same(_fields(a), _fields(b))
    if isinstance(a, dict):
        is_alike = isinstance(b, dict) and a.keys() == b.keys()
        return is_alike and all(same(value, b[key]) for key, value in a.items())
    if isinstance(a, (list, tuple)):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


def _fields(value: Any) -> list[Any]:
    return [getattr(value, field.name) for field in dataclasses.fields(value)]


def json_copy(name: str, value: Mapping[str, Any]) -> Any:
    """Return a deep copy in the types that JSON knows, so that what is loaded equals what was saved.

    Raises
    ------
    InvalidValue
        If `value` holds something else.
    """
    try:
        return json.loads(json.dumps(dict(value), default=_plain))
    except (TypeError, ValueError) as error:
        raise InvalidValue(name, error, "numbers, texts, lists and tables") from error


def check_arrays(given: Mapping[str, Any], num_momenta: int, num_path: int) -> dict[str, Array]:
    """Copy the arrays of a solution, read-only, and check that their shapes fit together.

    What is empty is absent: no constraints, no symmetries, a control Hamiltonian that nobody evaluated, no
    limits.

    Raises
    ------
    DimensionMismatch
        If a shape does not fit the others.
    """
    t = frozen_array(given["t"], shape=(None,), name="t")
    if len(t) < 2:
        raise DimensionMismatch("t", t.shape, (None,), "a trajectory has at least one step, so two nodes")
    sizes = _sizes(given, len(t), num_momenta, num_path)
    found = {}
    for name, quantity in QUANTITIES.items():
        array, shape = np.asarray(given[name], dtype=float), tuple(sizes[axis] for axis in quantity.axes)
        if quantity.may_lack and quantity.absent is None and not array.size:
            array, shape = np.zeros((0,) * len(shape)), (0,) * len(shape)
        elif quantity.absent is not None and not array.size:
            array = _absent(quantity, sizes)
        found[name] = frozen_array(array, shape=shape, name=name)
    return found


def _sizes(given: Mapping[str, Any], nodes: int, num_momenta: int, num_path: int) -> dict[str, int | None]:
    """Lengths of the axes of `QUANTITIES`; None where any will do."""
    vs = frozen_array(given["vs"], shape=(nodes, None), name="vs")
    nv, nu, nq = vs.shape[1], _width("us", given["us"]), _width("qs", given["qs"])
    nc = _width("lams", given["lams"]) if np.size(given["lams"]) else 0
    num_values = np.size(given["u_shares"])
    moves = np.shape(given["gains"])[-1]  # linear controls answer what they are away themselves, too
    return {
        "node": nodes,
        "later node": nodes - 1,
        "step": nodes - 1,
        "side": 2,
        "condition": None,
        "q": nq,
        "v": nv,
        "p": nv,
        "u": nu,
        "lam": nc,
        "zeta": nc,
        "mu": 2 * nv,
        "symmetry": num_momenta,
        "path": num_path,
        "share": num_values,
        "answer": max(num_values, 1) * nu,
        "move": 2 * nv,
        **({"move": moves} if num_values == 2 and moves == 2 * nv + nu else {}),
    }


def _absent(quantity: StoredQuantity, sizes: Mapping[str, int | None]) -> Array:
    """What stands for numbers that nobody has worked out; what has names of its own has no columns then."""
    shape = [0 if axis in _NAMED else sizes[axis] or 0 for axis in quantity.axes]
    array = np.full(shape, quantity.absent)
    if quantity.axes[0] == "side":
        array[0] *= -1.0
    return array


def _width(name: str, rows: Any) -> int:
    """Number of columns."""
    shape = np.shape(rows)
    if len(shape) != 2:
        raise DimensionMismatch(name, shape, (None, None))
    return int(shape[1])


def _plain(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    raise TypeError(f"{type(value).__name__} {value!r}")

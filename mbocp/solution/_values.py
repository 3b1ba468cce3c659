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

__all__ = ["checked_arrays", "json_copy", "same"]


def same(a: Any, b: Any) -> bool:
    """Whether two values are equal to the last bit, in depth; NaN equals NaN."""
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b, equal_nan=True)
    if isinstance(a, float):
        return a == b or (isinstance(b, float) and math.isnan(a) and math.isnan(b))
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(
            same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a)
        )
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(v, b[key]) for key, v in a.items())
    if isinstance(a, (list, tuple)):
        return type(a) is type(b) and len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return bool(a == b)


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


def checked_arrays(given: Mapping[str, Any], num_momenta: int, num_path: int) -> dict[str, Array]:
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
    nodes, steps = len(t), len(t) - 1
    vs = frozen_array(given["vs"], shape=(nodes, None), name="vs")
    lams = _or_absent(given["lams"], np.zeros((steps, 0)))
    nv, nc = vs.shape[1], _width("lams", lams)
    shapes: dict[str, tuple[int | None, ...]] = {
        "t": (nodes,),
        "qs": (nodes, None),
        "vs": (nodes, nv),
        "ps": (nodes, nv),
        "us": (steps, None),
        "lams": (steps, nc),
        "mus": (nodes, 2 * nv),
        "zetas": (steps, nc),
        "eta": (None,),
        "control_hamiltonians": (steps,),
        "control_momenta": (nodes, num_momenta),
        "manifold_drifts": (nodes,),
        "lam_path": (steps, num_path),
        "gains": (None, None, None),
        "u_values": (None, None, None),
        "u_shares": (None,),
    }
    widths = (
        ("u", _width("us", given["us"]), steps),
        ("v", nv, nodes),
        ("q", _width("qs", given["qs"]), nodes),
    )
    for letter, size, rows in widths:
        shapes |= {f"limits_{letter}": (2, size), f"lam_{letter}s": (rows, size)}
    absent = {
        "lams": np.zeros((steps, 0)),
        "zetas": np.zeros((steps, 0)),
        "control_hamiltonians": np.full(steps, np.nan),
        "control_momenta": np.zeros((nodes, 0)),
        "manifold_drifts": np.full(nodes, np.nan),
        "lam_path": np.zeros((steps, 0)),
        "gains": np.zeros((0, 0, 0)),
        "u_values": np.zeros((0, 0, 0)),
        "u_shares": np.zeros(0),
    }
    num_u, num_values = _width("us", given["us"]), np.size(given["u_shares"])
    if num_values or np.size(given["u_values"]):
        shapes["u_values"] = (steps, num_values, num_u)
    if np.size(given["gains"]):
        width = np.shape(given["gains"])[-1]  # linear controls answer what they are away themselves, too
        width = width if num_values == 2 and width == 2 * nv + num_u else 2 * nv
        shapes["gains"] = (steps, max(num_values, 1) * num_u, width)
    for letter in "uvq":
        size = shapes[f"limits_{letter}"][1] or 0
        absent[f"limits_{letter}"] = np.outer([-np.inf, np.inf], np.ones(size))
        absent[f"lam_{letter}s"] = np.zeros((shapes[f"lam_{letter}s"][0] or 0, size))
    values = {
        name: _or_absent(given[name], absent[name]) if name in absent else given[name] for name in shapes
    }
    return {name: frozen_array(values[name], shape=shape, name=name) for name, shape in shapes.items()}


def _width(name: str, rows: Any) -> int:
    """Number of columns."""
    shape = np.shape(rows)
    if len(shape) != 2:
        raise DimensionMismatch(name, shape, (None, None))
    return int(shape[1])


def _or_absent(value: Any, substitute: Array) -> Array:
    array = np.asarray(value, dtype=float)
    return array if array.size else substitute


def _plain(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    raise TypeError(f"{type(value).__name__} {value!r}")

"""Small habits of the values in a solution: comparison, and copies that survive a file."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue

__all__ = ["json_copy", "or_absent", "same"]


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


def or_absent(value: Array, shape: tuple[int, int]) -> Array:
    """Return `value`, or zeros of `shape` if it is empty."""
    array = np.asarray(value, dtype=float)
    return array if array.size else np.zeros(shape)


def _plain(value: Any) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    raise TypeError(f"{type(value).__name__} {value!r}")

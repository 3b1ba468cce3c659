"""Array types and the two habits every frozen value shares: copied in, made read-only."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mbocp._text import show
from mbocp.exceptions import DimensionMismatch, InvalidValue

Array: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]
IntArray: TypeAlias = NDArray[np.intp]


def frozen_array(
    value: ArrayLike, *, shape: tuple[int | None, ...] | None = None, name: str = "array"
) -> Array:
    """Copy `value` into a read-only float64 array.

    Parameters
    ----------
    value : array_like
        Numbers.
    shape : tuple of int or None, optional
        Expected shape; None stands for any length along that axis.
    name : str
        What the value is called in the error.

    Raises
    ------
    DimensionMismatch, InvalidValue
        If the shape is not the expected one, or if there are no numbers.
    """
    try:
        array = np.array(value, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:  # words, tables or ragged lists
        raise InvalidValue(name, show(value), "an array of numbers") from error
    if shape is not None and array.shape != shape:
        lengths = zip(shape, array.shape, strict=False)
        if array.ndim != len(shape) or any(asked is not None and asked != n for asked, n in lengths):
            raise DimensionMismatch(name, got=array.shape, expected=shape)
    array.setflags(write=False)
    return array


def freeze(value: object, field: str, shape: tuple[int | None, ...], name: str) -> None:
    """Put a read-only copy into a field of a frozen value, while it is made; `name` is for the error."""
    object.__setattr__(value, field, frozen_array(getattr(value, field), shape=shape, name=name))


def frozen_mask(value: ArrayLike, *, size: int, name: str = "mask") -> BoolArray:
    """Copy `value` into a read-only boolean array of `size` entries."""
    mask = np.array(value, dtype=np.bool_)
    if mask.shape != (size,):
        raise DimensionMismatch(name, got=mask.shape, expected=(size,))
    mask.setflags(write=False)
    return mask


def plain(value: Any) -> Any:
    """Turn NumPy arrays and tuples into values of a TOML file."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    return value


def plain_json(value: Any) -> Any:
    """Turn arrays into lists, and what JSON has no number for into None."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): plain_json(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain_json(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, (bool, int)) else str(value)

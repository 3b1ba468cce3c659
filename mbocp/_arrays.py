"""Values: arrays, linear algebra of them, and frozen dataclasses, whose arrays are copied and read-only.

A command from the shell defines four hundred of these classes. The standard library compiles six functions
for each; here `__init__` alone is compiled for a class, and all classes share the other five. What has to be
imported without NumPy, as commands that print their help, takes those of the standard library.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any, TypeAlias

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


if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(cls: Any = None, /, *, frozen: bool = False, slots: bool = False, **options: bool) -> Any:
        """Do what `dataclasses.dataclass` does, in less time where the class is frozen and has no slots.

        One thing differs: a field with `init=False` that the class has not set can be set once from outside.
        """
        if not frozen or slots:
            return dataclasses.dataclass(cls, frozen=frozen, slots=slots, **options)
        eq, show = options.pop("eq", True), options.pop("repr", True)

        def define(cls: type) -> type:
            # For the standard library a class and those it inherits from are all frozen, or none is.
            bases = [b.__dataclass_params__ for b in cls.__mro__[1:] if "__dataclass_params__" in b.__dict__]
            for params in bases:
                params.frozen = False
            dataclasses.dataclass(eq=False, repr=False, **options)(cls)
            for params in (*bases, cls.__dataclass_params__):
                params.frozen = True
            own = cls.__dict__
            cls.__setattr__, cls.__delattr__ = _set_once, _refuse_to_delete
            if show and "__repr__" not in own:
                cls.__repr__ = _describe
            if eq and "__eq__" not in own:
                cls.__eq__ = _equal
            if eq and own.get("__hash__") is None:
                cls.__hash__ = _hash
            return cls

        return define


def is_frozen_value(value: Any) -> bool:
    """Whether a value is of a class that `dataclass` made here, and all of it is in its fields."""
    cls: Any = type(value)
    return cls.__setattr__ is _set_once and "__dataclass_fields__" in cls.__dict__


def _set_once(self: Any, name: str, value: Any) -> None:
    if name in self.__dict__ or name not in self.__dataclass_fields__:
        raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
    self.__dict__[name] = value


def _refuse_to_delete(self: Any, name: str) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")


@cache
def _names(cls: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the fields that are compared, and of those that are hashed."""
    fields = dataclasses.fields(cls)
    hashed = (f.name for f in fields if (f.compare if f.hash is None else f.hash))
    return tuple(f.name for f in fields if f.compare), tuple(hashed)


def _values(self: Any) -> tuple[Any, ...]:
    return tuple([getattr(self, name) for name in _names(self.__class__)[0]])


def _equal(self: Any, other: Any) -> bool:
    return _values(self) == _values(other) if other.__class__ is self.__class__ else NotImplemented


def _hash(self: Any) -> int:
    return hash(tuple([getattr(self, name) for name in _names(self.__class__)[1]]))


@recursive_repr()
def _describe(self: Any) -> str:
    shown = (f"{f.name}={getattr(self, f.name)!r}" for f in dataclasses.fields(self) if f.repr)
    return f"{type(self).__qualname__}({', '.join(shown)})"


_SMALL = 1e-150  # squares of what is smaller lose their digits
_TIE = 0.99  # rows, and entries, from this part of the largest on count as equally large


def null_space(matrix: Array, tolerance: float) -> Array:
    """Return an orthonormal basis of the null space, as columns.

    Parameters
    ----------
    matrix : ndarray, shape (m, n)
    tolerance : float
        Singular values up to this multiple of the largest one, or of 1 if that is larger, count as zero.
        (`scipy.linalg.null_space` has no such floor: it finds a rank in a matrix of round-off.)

    Returns
    -------
    basis : ndarray, shape (n, n - rank)
    """
    rows, columns = matrix.shape
    # A tall matrix has a large left factor that nobody needs; its triangle has the same null space.
    triangle: Array = np.asarray(np.linalg.qr(matrix, mode="r")) if rows > columns else matrix
    _, singular, vt = np.linalg.svd(triangle)
    rank = int(np.count_nonzero(singular > tolerance * max(singular.max(initial=0.0), 1.0)))
    return vt[rank:].T


def independent_rows(matrix: Array, tolerance: float) -> Array:
    """Return orthonormal combinations of rows that are independent, or the identity if all rows are.

    Parameters
    ----------
    matrix : ndarray, shape (m, n)
    tolerance : float
        Of singular values, as in `null_space`.

    Returns
    -------
    combinations : ndarray, shape (rank, m)
    """
    count = len(matrix)
    if not matrix.size:
        return np.zeros((0, count))
    left, values, _ = np.linalg.svd(matrix, full_matrices=False)
    rank = int(np.sum(values > tolerance * max(values[0], 1.0)))
    return np.eye(count) if rank == count else np.ascontiguousarray(left[:, :rank].T)


def select_spanning_rows(matrix: Array, tolerance: float) -> list[int]:
    """Return which rows span all of them, each the one farthest from what those before it span.

    Of rows that are as long but for a hundredth the first is taken: round-off decides nothing.

    Parameters
    ----------
    matrix : ndarray, shape (m, n)
    tolerance : float
        A row that is no longer than this multiple of the longest one, or of 1 if that is larger, is left out.
    """
    left = np.array(matrix, dtype=np.float64)
    found: list[int] = []
    least = tolerance * max(float(np.linalg.norm(left, axis=1).max(initial=0.0)), 1.0)
    for _ in range(min(left.shape)):
        lengths = np.linalg.norm(left, axis=1)
        longest = lengths.max()
        if longest <= least:
            break
        place = int(np.argmax(lengths >= _TIE * longest))
        found.append(place)
        unit = left[place] / lengths[place]
        left -= np.outer(left @ unit, unit)
    return sorted(found)


def largest_entry(row: Array) -> int:
    """Return where the largest entry of a row is, by size; of those that are equal but for 1 % the first."""
    sizes = np.abs(row)
    return int(np.argmax(sizes >= _TIE * sizes.max()))


def align(basis: Array) -> Array:
    """Return the orthonormal basis of the same space of which round-off decides nothing.

    An SVD leaves open how singular vectors of equal values are turned. Of this basis, entries that say all
    others make a lower triangle with a positive diagonal.

    Parameters
    ----------
    basis : ndarray, shape (n, k)
        Orthonormal columns.
    """
    if not basis.size:
        return basis
    entries = select_spanning_rows(basis, 0.0)
    found: Array = basis @ np.linalg.qr(basis[entries].T)[0]
    return found * np.sign(np.diag(found[entries]))


def norm(vector: Array) -> float:
    """Return the Euclidean norm of a vector, shape (n,), also where squares of entries have no number.

    An iterate that runs away is no error of arithmetic: its norm is a large number, or infinite.
    """
    with np.errstate(over="ignore"):
        size = math.sqrt(vector.dot(vector))
    has_no_squares = math.isinf(size) or (size < _SMALL and vector.any())
    return math.hypot(*vector.tolist()) if has_no_squares else size

"""Values: array types, and frozen dataclasses, whose arrays are copied in and made read-only.

A command from the shell defines four hundred of these classes. The standard library compiles six functions
for each; here `__init__` alone is compiled for a class, and all classes share the other five. What has to be
imported without NumPy, as commands that print their help, takes those of the standard library.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
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


def _values(self: Any) -> tuple[Any, ...]:
    return tuple(getattr(self, f.name) for f in dataclasses.fields(self) if f.compare)


def _equal(self: Any, other: Any) -> bool:
    return _values(self) == _values(other) if other.__class__ is self.__class__ else NotImplemented


def _hash(self: Any) -> int:
    fields = dataclasses.fields(self)
    return hash(tuple(getattr(self, f.name) for f in fields if (f.compare if f.hash is None else f.hash)))


@recursive_repr()
def _describe(self: Any) -> str:
    shown = (f"{f.name}={getattr(self, f.name)!r}" for f in dataclasses.fields(self) if f.repr)
    return f"{type(self).__qualname__}({', '.join(shown)})"

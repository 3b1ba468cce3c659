"""Frozen dataclasses that are quick to define.

A command from the shell defines four hundred of them. The standard library compiles six functions for each;
here `__init__` alone is compiled for a class, and all classes share the other five.
"""

from __future__ import annotations

import dataclasses
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any

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

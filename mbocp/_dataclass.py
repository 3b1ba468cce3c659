"""The decorator `dataclass` of the standard library, with methods that are not compiled class by class.

The standard one writes and compiles six functions for each frozen class. A solve has more than three hundred
classes, and their functions took as long as NumPy, CasADi and Pinocchio take to import. Here `__eq__`,
`__hash__`, `__repr__` and what guards frozen instances are the same functions for all classes, and
`__init__` is compiled when it is first asked for. The fields are the standard library's: `fields`, `replace`
and `asdict` know them.

`order`, `slots` and `InitVar` are not here.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from functools import cache
from operator import attrgetter
from reprlib import recursive_repr
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass  # type checkers know this one
else:

    def dataclass(
        cls: type | None = None,
        /,
        *,
        frozen: bool = False,
        eq: bool = True,
        repr: bool = True,  # noqa: A002
        kw_only: bool = False,
    ) -> Any:
        """Make a class a dataclass, with options as in `dataclasses.dataclass`."""

        def decorated(cls: type) -> type:
            own = {name for name in _METHODS if name in vars(cls)}
            cls.__doc__ = cls.__doc__ or cls.__name__  # the standard one works a signature out
            dataclasses.dataclass(init=False, repr=False, eq=False, kw_only=kw_only)(cls)
            for name, method in _methods(cls, own, frozen=frozen, eq=eq, with_repr=repr):
                setattr(cls, name, method)
            return cls

        return decorated if cls is None else decorated(cls)


__all__ = ["dataclass"]

_METHODS = ("__init__", "__repr__", "__eq__", "__hash__")


def _methods(
    cls: type, own: set[str], *, frozen: bool, eq: bool, with_repr: bool
) -> Iterator[tuple[str, Any]]:
    """Methods that a class gets; those that it has itself stay."""
    if "__init__" not in own:
        yield "__init__", _Init(cls, frozen)
    if with_repr and "__repr__" not in own:
        yield "__repr__", _repr
    if eq:
        if "__eq__" not in own:
            yield "__eq__", _eq
        if "__hash__" not in own or (vars(cls)["__hash__"] is None and "__eq__" in own):
            yield "__hash__", _hash if frozen else None
    if frozen:
        yield "__setattr__", _refuse_setting
        yield "__delattr__", _refuse_deleting


class _Init:
    """`__init__` of a class until it is asked for: then it is compiled, and takes this place."""

    def __init__(self, cls: type, frozen: bool) -> None:
        self._cls, self._frozen = cls, frozen

    def __get__(self, instance: object, owner: type | None = None) -> Any:
        """The method, bound to the instance if there is one."""
        method = _compiled_init(self._cls, self._frozen)
        setattr(self._cls, "__init__", method)  # noqa: B010  # type checkers refuse the plain assignment
        return method if instance is None else method.__get__(instance, owner)


def _compiled_init(cls: Any, frozen: bool) -> Callable[..., None]:
    """`__init__` that sets the fields in their order, and calls `__post_init__` where there is one."""
    names: dict[str, Any] = {"_unset": dataclasses.MISSING, "_set": object.__setattr__}
    first: list[str] = ["self"]
    by_keyword: list[str] = []
    body: list[str] = []
    for field in dataclasses.fields(cls):
        name, value = field.name, field.name
        if field.default_factory is not dataclasses.MISSING:
            names[f"_new_{name}"] = field.default_factory
            value = f"_new_{name}()" + (f" if {name} is _unset else {name}" if field.init else "")
            default = " = _unset"
        elif field.default is not dataclasses.MISSING:
            names[f"_default_{name}"] = field.default
            default = f" = _default_{name}"
        else:
            default = ""
        if field.init:
            (by_keyword if field.kw_only else first).append(f"{name}{default}")
        elif field.default_factory is dataclasses.MISSING:
            continue  # it is an attribute of the class, or `__post_init__` sets it
        body.append(f"_set(self, {name!r}, {value})" if frozen else f"self.{name} = {value}")
    if hasattr(cls, "__post_init__"):
        body.append("self.__post_init__()")
    words = ", ".join([*first, *(["*", *by_keyword] if by_keyword else [])])
    text = f"def __init__({words}):\n" + "\n".join(f"    {line}" for line in body or ["pass"])
    exec(compile(text, f"<fields of {cls.__qualname__}>", "exec"), names)
    method: Callable[..., None] = names["__init__"]
    method.__qualname__, method.__module__ = f"{cls.__qualname__}.__init__", cls.__module__
    method.__annotations__ = {f.name: f.type for f in dataclasses.fields(cls) if f.init} | {"return": None}
    return method


@recursive_repr()
def _repr(self: Any) -> str:
    shown = ", ".join(f"{f.name}={getattr(self, f.name)!r}" for f in dataclasses.fields(self) if f.repr)
    return f"{type(self).__qualname__}({shown})"


def _eq(self: Any, other: object) -> Any:
    if other.__class__ is not self.__class__:
        return NotImplemented
    return _compared_values(self) == _compared_values(other)


def _hash(self: Any) -> int:
    return hash(_compared_values(self))


def _compared_values(instance: Any) -> tuple[Any, ...]:
    kind: Any = type(instance)
    return _compared(kind)(instance)


@cache
def _compared(cls: Any) -> Callable[[Any], tuple[Any, ...]]:
    """From an instance to the fields that are compared and hashed."""
    names = [field.name for field in dataclasses.fields(cls) if field.compare]
    return attrgetter(*names) if len(names) > 1 else lambda self: tuple(getattr(self, name) for name in names)


def _is_guarded(instance: Any, name: str) -> bool:
    """Whether the name is a field, or the class is a dataclass itself and not a plain child of one."""
    return "__dataclass_fields__" in vars(type(instance)) or name in instance.__dataclass_fields__


def _refuse_setting(self: Any, name: str, value: object) -> None:
    if _is_guarded(self, name):
        raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")
    object.__setattr__(self, name, value)


def _refuse_deleting(self: Any, name: str) -> None:
    if _is_guarded(self, name):
        raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")
    object.__delattr__(self, name)

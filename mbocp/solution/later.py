"""Fields of a frozen dataclass that are worked out when one of them is first asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from types import MappingProxyType
from typing import Any, TypeVar

T = TypeVar("T")

_REST = "_rest"  # in the place of the fields that are not there yet, what gives them
_ALONE = "_alone"  # what gives some of them one by one


class LateField:
    """Stands in a class for a field that an instance may not have yet; one that is there takes its place."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __get__(self, instance: Any, owner: type | None = None) -> Any:
        """Value of the field, by itself where it can be had so; else all others are worked out with it."""
        if instance is None or is_complete(instance):
            raise AttributeError(self.name)
        alone = vars(instance)[_ALONE].get(self.name)
        if alone is not None:
            vars(instance)[self.name] = alone()
        else:
            complete(instance)
        return vars(instance)[self.name]


def defer(
    cls: type[T],
    now: Mapping[str, Any],
    rest: Callable[[], Mapping[str, Any]],
    alone: Mapping[str, Callable[[], Any]] = MappingProxyType({}),
) -> T:
    """Instance of a dataclass with some of its fields.

    Parameters
    ----------
    cls : type
        Whose other fields are `LateField`.
    now : mapping
        Fields that are there, as the instance has them.
    rest : callable
        Gives the others. It is called at most once, and checked with the others as the class does.
    alone : mapping
        What gives a field by itself, as the instance has it, without the others; called at most once.
    """
    instance = object.__new__(cls)
    vars(instance).update(now)
    vars(instance).update({_REST: rest, _ALONE: alone})
    return instance


def is_complete(instance: object) -> bool:
    """Whether all fields are there."""
    return _REST not in vars(instance)


def is_there(instance: object, name: str) -> bool:
    """Whether a field is there already."""
    return name in vars(instance)


def complete(instance: object) -> None:
    """Work out the fields that are missing."""
    rest = vars(instance).get(_REST)
    if rest is None:
        return
    names = {f.name for f in fields(instance)}  # type: ignore[arg-type]  # of a dataclass
    given = {name: value for name, value in vars(instance).items() if name in names}
    whole = type(instance)(**{**rest(), **given})
    vars(instance).update({name: value for name, value in vars(whole).items() if name not in given})
    for name in (_REST, _ALONE):
        vars(instance).pop(name, None)


def retold(instance: T, **changes: Any) -> T:
    """Copy with other values of fields that are there, which nothing else depends on."""
    other = object.__new__(type(instance))
    vars(other).update({**vars(instance), **changes})
    return other

"""`--set key.path=value`: changes of single keys of a problem file."""

from __future__ import annotations

import copy
import re
from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from mbocp._arrays import plain
from mbocp._files import parse_toml
from mbocp._text import show
from mbocp.exceptions import ProblemFileError, Unreadable

# A word that is no TOML value, and a number with a unit, are strings: quotes inside a shell's are no fun.
_BARE_WORDS = re.compile(r"[A-Za-z_./~][\w./~+-]*|[+-]?[\d.]+(?:e[+-]?\d+)? [A-Za-z][\w/()^* ]*")

SHORT = {"robot": "name", "solver": "method"}  # `robot = "ur5"` is short for `[robot] name = "ur5"`

# Keys of a table of which one says what another would: the one that is set takes the place of the others.
RIVALS = MappingProxyType(
    {"horizon": ("steps", "accuracy", "lengths"), "start": ("v", "p"), "goal": ("v", "p")}
)


def without_rivals(name: str, table: Mapping[str, Any], keys: Collection[str]) -> dict[str, Any]:
    """Return a table of a problem file without those keys whose place `keys` take."""
    rivals = RIVALS.get(name, ())
    taken = {rival for key in rivals if key in keys for rival in rivals if rival != key}
    return {key: value for key, value in table.items() if key not in taken}


def parse_override(text: str) -> tuple[tuple[str, ...], Any]:
    """Split ``key.path=value`` into the path and the value.

    Raises
    ------
    ProblemFileError
        If `text` has no ``=``, or key or value is not TOML.
    """
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise _error(text, "expected key.path=value, as in --set horizon.steps=200")
    return _parse_key(key.strip(), text), _parse_value(value.strip(), text)


def apply_overrides(
    document: Mapping[str, Any], overrides: Mapping[str, Any] | Sequence[str]
) -> dict[str, Any]:
    """Return a copy of `document` with the `overrides` in place, without what they take the place of.

    Parameters
    ----------
    document : mapping
        The parsed problem file.
    overrides : mapping or sequence of str
        Values by dotted key, or strings ``key.path=value`` with TOML values.
    """
    result: dict[str, Any] = copy.deepcopy(dict(document))
    if isinstance(overrides, str):
        overrides = [overrides]
    if isinstance(overrides, Mapping):
        pairs = [(_parse_key(str(key), str(key)), plain(value)) for key, value in overrides.items()]
    else:
        pairs = [parse_override(text) for text in overrides]
    for name in RIVALS:
        if isinstance(table := result.get(name), dict):
            keys = {path[1] for path, _ in pairs if path[0] == name and len(path) == 2}
            result[name] = without_rivals(name, table, keys)
    for path, value in pairs:
        _put(result, path, value)
    return result


def _parse_key(key: str, text: str) -> tuple[str, ...]:
    try:
        nested: Any = parse_toml(f"{key} = 0")
    except Unreadable as error:
        raise _error(text, f"{show(key)} is not a key such as horizon.steps") from error
    path: list[str] = []
    while isinstance(nested, dict):
        if len(nested) != 1:
            raise _error(text, f"{show(key)} is not one key such as horizon.steps")
        ((name, nested),) = nested.items()
        path.append(name)
    return tuple(path)


def _parse_value(value: str, text: str) -> Any:
    try:
        parsed = parse_toml(f"value = {value}")
    except Unreadable as error:
        if _BARE_WORDS.fullmatch(value):
            return value
        if type(error.__cause__).__name__ != "TOMLDecodeError":  # it is TOML, but too long or too deep
            raise _error(text, error.reason) from error
        allowed = 'a number, [a, list], true, or a "string"'
        raise _error(text, f"{show(value)} is not a TOML value ({allowed})") from error
    if set(parsed) != {"value"}:
        raise _error(text, "one key at a time; repeat --set for more")
    return parsed["value"]


def _put(document: dict[str, Any], path: tuple[str, ...], value: Any) -> None:
    table: Any = document
    for depth, name in enumerate(path[:-1], start=1):
        below = table[_place(table, name)] if isinstance(table, list) else table.setdefault(name, {})
        short = SHORT.get(name) if depth == 1 else None
        if short is not None and isinstance(below, str):
            below = table[name] = {short: below}
        if not (isinstance(below, dict) or _has_entry(below, path[depth])):
            here = ".".join(path[:depth])
            reason = f"{here} is {show(below)}, which has no keys below it; set {here} as a whole"
            raise _error(".".join(path), reason)
        table = below
    table[_place(table, path[-1]) if isinstance(table, list) else path[-1]] = value


def _has_entry(below: Any, name: str) -> bool:
    """Whether `name` is an entry of a list by its place or its name: path.0.frame, phase.lift.duration."""
    return isinstance(below, list) and (name in map(str, range(len(below))) or name in _names(below))


def _place(entries: list[Any], name: str) -> int:
    names = _names(entries)
    return names.index(name) if name in names else int(name)


def _names(entries: list[Any]) -> list[Any]:
    return [entry.get("name") if isinstance(entry, dict) else None for entry in entries]


def _error(text: str, reason: str) -> ProblemFileError:
    return ProblemFileError("--set", f"{reason}; got {show(text)}")

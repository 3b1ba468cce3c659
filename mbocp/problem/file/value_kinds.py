"""Kinds of values that only tables of a problem file have: rates, limits, durations, one table or several."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal, TypeAlias, TypeVar

from pydantic import Field

from mbocp._keys import Kind, OneOrSeveral
from mbocp._quantities import finite_number, is_number
from mbocp._text import show
from mbocp.terms.written import Named, Vector, range_of, read_side, read_vector

T = TypeVar("T")
Limit: TypeAlias = float | list[float]
_Limits: TypeAlias = bool | float | list[Limit] | dict[str, Limit | list[Limit]]
_Size: TypeAlias = Annotated[float, Field(gt=0)]
_Sizes: TypeAlias = _Size | list[_Size] | dict[str, _Size | list[_Size]]
_Ranges: TypeAlias = bool | list[Vector] | dict[str, Vector | list[Vector]]


def _as_list(value: Any) -> Any:
    """One table, or several."""
    return [value] if isinstance(value, Mapping) else value


def _rate(value: Any) -> Vector | Named | float:
    """Velocities or momenta; 0 means that all are zero."""
    if is_number(value) and value == 0:
        return 0.0
    if is_number(value):
        raise ValueError(
            f"got {show(value)}, expected 0 for rest, a list of as many numbers as mbocp robots NAME "
            "counts for v, or a table by joint name such as { elbow_joint = 0.5 }"
        )
    return read_vector(value)


def _rate_or_free(value: Any) -> Any:
    """Accelerations at the end, or that nothing is asked of them."""
    return value if value == "free" else _rate(value)


def _releases(value: Any) -> Any:
    """Names of constraints, or tables with more."""
    entries = [value] if isinstance(value, (str, Mapping)) else value
    if not isinstance(entries, list):
        return entries
    return [{"name": entry} if isinstance(entry, str) else entry for entry in entries]


def _each(value: Any, read: Callable[[Any, str], T]) -> Any:
    """Values of a list or of a table by name, read one by one, or the one value there is."""
    if isinstance(value, list):
        return _list(value, read, "")
    if isinstance(value, Mapping):
        return {name: _of_name(entry, read, f" for {show(name)}") for name, entry in value.items()}
    return read(value, "")


def _list(value: list[Any], read: Callable[[Any, str], T], where: str) -> list[T]:
    return [read(entry, f"{where} at index {i}") for i, entry in enumerate(value)]


def _of_name(value: Any, read: Callable[[Any, str], T], where: str) -> T | list[T]:
    """Of one name; of a part or a pattern a list with an entry for each of its joints, too."""
    return _list(value, read, where) if is_list_of_limits(value) else read(value, where)


def is_list_of_limits(value: Any) -> bool:
    """Whether limits of several joints are in a list: it is no pair [lower, upper]."""
    return isinstance(value, list) and (len(value) != 2 or any(isinstance(one, list) for one in value))


def _limit(value: Any, where: str) -> Limit:
    return range_of(value, where) if isinstance(value, list) else read_side(value, where)


def _limits(value: Any) -> _Limits:
    if isinstance(value, str):
        raise ValueError(f"got {show(value)}, expected true, a number, a list or a table by name")
    return value if isinstance(value, bool) else _each(value, _limit)


def _sizes(value: Any) -> _Sizes:
    """Positive numbers, for all or for each; infinite where there is no limit."""
    return _each(value, _size)


def _size(value: Any, where: str) -> float:
    found = read_side(value, where)
    if not found > 0.0:
        raise ValueError(f"got {show(value)}{where}, expected a number above 0 (inf for no limit)")
    return found


def _ranges(value: Any) -> _Ranges:
    if isinstance(value, bool):
        return value
    if isinstance(value, list | Mapping):
        return _each(value, range_of)
    raise ValueError(f"got {show(value)}, expected true, a list of [lower, upper] or a table of them by name")


def _profile(value: Any) -> bool | str | None:
    if value is None or isinstance(value, bool | str):
        return value
    raise ValueError(f"got {show(value)}, expected true, a name or a path")


def _duration(value: Any) -> float | dict[str, float] | None:
    if value is None:
        return None
    if isinstance(value, Mapping):
        return {name: finite_number(entry, f" for {show(name)}") for name, entry in value.items()}
    if isinstance(value, str):
        raise ValueError(f"got {show(value)}, expected a number, or {{ min, max, guess }} for a free one")
    return finite_number(value)


def _via_time(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {
            name: entry if name == "phase" else finite_number(entry, f" for {show(name)}")
            for name, entry in value.items()
        }
    return value if value is None or isinstance(value, str) else finite_number(value)


def _free(value: Any) -> Any:
    if value is None or value is True or value in ("q", "v") or isinstance(value, Mapping):
        return value
    raise ValueError(
        f'got {show(value)}, expected true, "q", "v" or a table with q and v such as '
        '{ v = true, q = ["elbow"] }'
    )


def _periodic(value: Any) -> Any:
    if value is None or value is True or isinstance(value, Mapping):
        return value
    raise ValueError(
        f"got {show(value)}, expected true, or a table with swap, mirror, combine, moved, except, impact"
    )


SEVERAL = OneOrSeveral("table, or several", _as_list, None)
RELEASED = OneOrSeveral("strings, or tables", _releases, str)
_Free = Literal[True] | list[str] | dict[str, Literal[True] | Vector | list[str]]
Rate = Annotated[Any, Kind("vector, or 0", _rate, Literal[0] | Vector | Named)]
RateOrFree = Annotated[
    Any, Kind('vector, 0, or `"free"`', _rate_or_free, Literal[0, "free"] | Vector | Named)
]
Limits = Annotated[Any, Kind("true, number, list, table", _limits, _Limits)]
Sizes = Annotated[Any, Kind("number, list, table", _sizes, _Sizes)]
ProfileName = Annotated[Any, Kind("true, string", _profile, bool | str)]
Ranges = Annotated[Any, Kind("true, list or table of pairs", _ranges, _Ranges)]
Duration = Annotated[
    Any,
    Kind(
        "number > 0, or `{ min, max, guess }`", _duration, float | dict[Literal["min", "max", "guess"], float]
    ),
]
Free = Annotated[
    Any,
    Kind('`true`, `"q"`, `"v"`, or table', _free, Literal[True, "q", "v"] | dict[Literal["q", "v"], _Free]),
]
PeriodicWords = Annotated[
    Any,
    Kind(
        "`true`, or table",
        _periodic,
        Literal[True] | dict[Literal["swap", "mirror", "combine", "moved", "except", "impact"], Any],
    ),
]
ViaTime = Annotated[
    Any,
    Kind(
        'number, `"free"`, `{ min, max, guess }`, name of a phase, or `{ phase, share }`',
        _via_time,
        float | str | dict[Literal["min", "max", "guess", "phase", "share"], float | str],
    ),
]

"""What a study varies: values of a grid, named values, random samples, lists of settings."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from mbocp._arrays import dataclass
from mbocp._memory import check_memory
from mbocp._quantities import Quantity, as_float, is_number
from mbocp._text import show
from mbocp.exceptions import ProblemFileError, StudyError
from mbocp.problem.file.overrides import apply_overrides
from mbocp.study.study_schema import AxisTable

LABEL = "label"
_COUNT = "count"
_MAX_VALUES = 1_000_000  # of one key
_BYTES = 200  # of a value that was drawn, about


@dataclass(frozen=True)
class DimensionValue:
    """One value along a dimension.

    Attributes
    ----------
    values : mapping
        What a row says of it: keys, or names of axes, and their values.
    overrides : mapping
        What it does to the problem: values by dotted key.
    """

    values: Mapping[str, Any]
    overrides: Mapping[str, Any]


@dataclass(frozen=True)
class Dimension:
    """Something that varies by itself; a study is the product of its dimensions.

    Attributes
    ----------
    kind : {"grid", "axis", "sample", "list"}
    points : tuple of DimensionValue
    """

    kind: str
    points: tuple[DimensionValue, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """What rows call it: keys, or the name of an axis, in the order of their first use."""
        return tuple(dict.fromkeys(name for point in self.points for name in point.values))

    @property
    def keys(self) -> tuple[str, ...]:
        """Problem keys that it sets."""
        return tuple(dict.fromkeys(key for point in self.points for key in point.overrides))


def check_fixed(written: Mapping[str, Any]) -> dict[str, Any]:
    """Overrides of [fixed], checked.

    Raises
    ------
    StudyError
        If a key is not one, as by all functions here: the message begins with the place.
    """
    for key, value in written.items():
        _check_key(key, value, f"fixed.{key}")
    return dict(written)


def grid_dimensions(written: Mapping[str, Any]) -> Iterator[Dimension]:
    """One dimension for each key of [grid]."""
    for key, entry in written.items():
        where = f"grid.{key}"
        _check_key(key, None if _is_table_of(entry, _RANGES) else entry, where)
        values = _grid_values(entry, where)
        yield Dimension("grid", tuple(DimensionValue({key: value}, {key: value}) for value in values))


def axis_dimension(table: AxisTable, index: int) -> Dimension:
    """Dimension of an [[axis]]."""
    points, seen = [], set()
    for i, entry in enumerate(table.values):
        where = f"axis.{index}.values.{i}"
        label = entry.get(LABEL)
        if not isinstance(label, str) or not label:
            raise StudyError(f'{where}: a value of axis {table.name!r} needs a name: label = "..."')
        if label in seen:
            raise StudyError(f"{where}: label {label!r} stands twice in axis {table.name!r}")
        seen.add(label)
        points.append(DimensionValue({table.name: label}, _entry_keys(entry, where)))
    if not points:
        raise StudyError(f"axis.{index}.values: axis {table.name!r} has no values")
    return Dimension("axis", tuple(points))


def list_dimension(entries: Sequence[Mapping[str, Any]]) -> Dimension:
    """Dimension of all [[list]] entries; a `label` among the keys goes into the rows and nowhere else."""
    points = []
    for i, entry in enumerate(entries):
        keys = _entry_keys(entry, f"list.{i}")
        named = {LABEL: entry[LABEL], **keys} if LABEL in entry else keys
        points.append(DimensionValue(named, keys))
    return Dimension("list", tuple(points))


def sample_dimension(written: Mapping[str, Any], seed: int) -> Dimension:
    """Dimension of [sample].

    Each key has random numbers of its own, which depend on the seed and its name alone: another key, or a
    larger count, leaves the values as they are.
    """
    count = written.get(_COUNT)
    if isinstance(count, bool) or not isinstance(count, int) or count < 1:
        raise StudyError(f"sample.count: got {show(count)}, expected a whole number above 0")
    keys = [key for key in written if key != _COUNT]
    if not keys:
        raise StudyError("sample: has a count but no key, as in " + _EXAMPLE)
    check_memory(_BYTES * len(keys) * count, f"sample.count = {count}", "Take fewer")
    columns = []
    for key in keys:
        where = f"sample.{key}"
        _check_key(key, None if _is_table_of(written[key], _DRAWS) else written[key], where)
        generator = np.random.default_rng([seed, zlib.crc32(key.encode())])
        columns.append(_draw(written[key], count, generator, where))
    rows = [dict(zip(keys, values, strict=True)) for values in zip(*columns, strict=True)]
    return Dimension("sample", tuple(DimensionValue(row, row) for row in rows))


_EXAMPLE = '"goal.q.elbow_joint" = { uniform = [-1, 1] }'


def _entry_keys(entry: Mapping[str, Any], where: str) -> dict[str, Any]:
    keys = {key: value for key, value in entry.items() if key != LABEL}
    for key, value in keys.items():
        _check_key(key, value, f"{where}.{key}")
    return keys


def _check_key(key: str, value: Any, where: str) -> None:
    """Refuse what is no dotted key, and the table that `solver.method = ...` without quotes becomes."""
    if isinstance(value, Mapping) and "." not in key:
        inner = next(iter(value), "name")
        raise StudyError(f'{where}: got a table; write dotted keys in quotes: "{key}.{inner}" = ...')
    try:
        apply_overrides({}, {key: 0})
    except ProblemFileError as error:
        raise StudyError(f"{where}: {error.reason}") from error


def _is_table_of(entry: Any, names: Container[str]) -> bool:
    return isinstance(entry, Mapping) and all(name in names for name in entry)


def _grid_values(entry: Any, where: str) -> list[Any]:
    if isinstance(entry, list):
        if not entry:
            raise StudyError(f"{where}: the list is empty, expected at least one value")
        return entry
    if isinstance(entry, Mapping) and len(entry) == 1 and (name := next(iter(entry))) in _RANGES:
        ends, unit = _of_unit(entry[name], f"{where}.{name}")
        return _in_unit(_RANGES[name](ends, f"{where}.{name}"), unit)
    raise StudyError(
        f"{where}: got {show(entry)}, expected a list of values, {{ linspace = [first, last, count] }} or "
        "{ geomspace = [first, last, count] }"
    )


def _range_ends(written: Any, where: str) -> tuple[float, float, int]:
    if not isinstance(written, list) or len(written) != 3 or not all(map(_is_number, written)):
        raise StudyError(f"{where}: got {show(written)}, expected [first, last, count]")
    first, last, count = written
    if not isinstance(count, int) or not 1 <= count <= _MAX_VALUES:
        raise StudyError(f"{where}: got count {show(count)}, expected a whole number from 1 to {_MAX_VALUES}")
    return float(first), float(last), count


def _linspace(written: Any, where: str) -> list[Any]:
    return list(np.linspace(*_range_ends(written, where)).tolist())


def _geomspace(written: Any, where: str) -> list[Any]:
    first, last, count = _range_ends(written, where)
    if first * last <= 0.0:
        raise StudyError(
            f"{where}: got {first:g} to {last:g}, expected two numbers of one sign, none of them 0"
        )
    return list(np.geomspace(first, last, count).tolist())


def _draw(entry: Any, count: int, generator: np.random.Generator, where: str) -> list[Any]:
    if isinstance(entry, Mapping) and len(entry) == 1 and (name := next(iter(entry))) in _DRAWS:
        if name == "choice":
            return _choice(entry[name], count, generator, f"{where}.{name}")
        ends, unit = _of_unit(entry[name], f"{where}.{name}")
        return _in_unit(_DRAWS[name](ends, count, generator, f"{where}.{name}"), unit)
    raise StudyError(
        f"{where}: got {show(entry)}, expected {{ uniform = [low, high] }}, "
        "{ normal = [mean, deviation] } or { choice = [...] }"
    )


def _uniform(written: Any, count: int, generator: np.random.Generator, where: str) -> list[Any]:
    low, high = _two(written, where, "[low, high]")
    if np.any(low > high):
        raise StudyError(f"{where}: got {show(written)}, but low is above high")
    return list(generator.uniform(low, high, (count, *low.shape)).tolist())


def _normal(written: Any, count: int, generator: np.random.Generator, where: str) -> list[Any]:
    mean, deviation = _two(written, where, "[mean, deviation]")
    if np.any(deviation < 0.0):
        raise StudyError(f"{where}: got {show(written)}, but the deviation is below 0")
    deviation = np.abs(deviation)  # NumPy refuses -0.0
    return list(generator.normal(mean, deviation, (count, *mean.shape)).tolist())


def _choice(written: Any, count: int, generator: np.random.Generator, where: str) -> list[Any]:
    if not isinstance(written, list) or not written:
        raise StudyError(f"{where}: got {show(written)}, expected a list of at least one value")
    return [written[i] for i in generator.integers(len(written), size=count)]


def _two(written: Any, where: str, what: str) -> tuple[Any, Any]:
    """Two numbers, or two lists of numbers of one length."""
    if isinstance(written, list) and len(written) == 2:
        if all(map(_is_number, written)):
            return np.float64(written[0]), np.float64(written[1])
        rows = [row for row in written if isinstance(row, list) and row and all(map(_is_number, row))]
        if len(rows) == 2 and len(rows[0]) == len(rows[1]):
            return np.array(rows[0], dtype=float), np.array(rows[1], dtype=float)
    raise StudyError(f"{where}: got {show(written)}, expected {what}, each a number or a list of one length")


def _of_unit(written: Any, where: str) -> tuple[Any, Quantity | None]:
    """Ends of a range with numbers in the place of texts with units of one sort, and one of these."""
    if not isinstance(written, list):
        return written, None
    texts = [Quantity.of(end, ()) if isinstance(end, str) else None for end in written]
    read = [end if text is None else text for end, text in zip(written, texts, strict=True)]
    found = [end for end in read if isinstance(end, Quantity)]
    if len({end.powers for end in found}) > 1:
        raise StudyError(f"{where}: got {show(written)}, expected units of one sort")
    return read, found[0] if found else None


def _in_unit(values: list[Any], unit: Quantity | None) -> list[Any]:
    return values if unit is None else [unit.like(value) for value in values]


def _is_number(value: Any) -> bool:
    return is_number(value) and math.isfinite(as_float(value))


_RANGES: Mapping[str, Callable[[Any, str], list[Any]]] = {"linspace": _linspace, "geomspace": _geomspace}
_DRAWS: Mapping[str, Callable[[Any, int, np.random.Generator, str], list[Any]]] = {
    "uniform": _uniform,
    "normal": _normal,
    "choice": _choice,
}

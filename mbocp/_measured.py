"""Keys that take numbers with units: read before anything else, and refused where the unit does not fit."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler, ValidationError
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema, core_schema

from mbocp._quantities import EXAMPLES, KNOWN, PATTERN, Quantity, has_unit, unit_of
from mbocp._text import show
from mbocp.exceptions import InvalidValue

_PART = "share"  # of a phase or of the horizon, which has no unit whatever its key has
_OF_NUMBER = "those of the number"  # how a key is declared whose unit is that of a number of the robot


@dataclass(frozen=True)
class KeyUnits:
    """That a key takes numbers with units, too.

    Attributes
    ----------
    unit : str
        As the key is declared: "m", or several as "m, rad"; "rad/s; N m" are those of two columns.
    parts : tuple of (str, KeyUnits)
        Keys of a table in the key's place that have other units.
    """

    unit: str
    parts: tuple[tuple[str, KeyUnits], ...] = ()

    @property
    def units(self) -> tuple[str, ...]:
        """Each unit; none where that of a number of the robot holds."""
        return () if self.unit == _OF_NUMBER else tuple(re.split("[,;] ", self.unit))

    @property
    def is_known(self) -> bool:
        """Whether texts can be checked against it."""
        return bool(self.unit) and all(unit_of(one) is not None for one in self.units)

    def check(self, value: Any, where: str = "") -> Any:
        """Return a value with numbers in the place of texts with units, which have to fit.

        Raises
        ------
        ValueError
        """
        if isinstance(value, str):
            quantity = Quantity.of(value, self.units)
            return value if quantity is None else self.check(quantity, where)
        if isinstance(value, Quantity):
            if self.units and not value.fits(self.units):
                expected = " or ".join(self.units)
                raise ValueError(f"got {value.describe(where)}, expected a number in {expected}")
            value.units = self.units
            return value
        if ";" in self.unit and isinstance(value, list) and all(isinstance(row, list) for row in value):
            columns = [KeyUnits(unit) for unit in self.unit.split("; ")]
            return [
                [one.plain(one.check(entry, f" in row {n}")) for entry, one in zip(row, cycle(columns))]
                for n, row in enumerate(value)
            ]
        if isinstance(value, list | tuple):
            if all(type(entry) is float for entry in value):
                return value
            return type(value)(self.check(entry, f" at index {i}{where}") for i, entry in enumerate(value))
        if isinstance(value, Mapping):
            parts = dict(self.parts)
            return {
                name: entry if name == _PART else parts.get(name, self).check(entry, f" for {show(name)}")
                for name, entry in value.items()
            }
        return value

    def plain(self, checked: Any) -> Any:
        """Return a value with plain numbers, where there is no other unit that they could be in."""
        return _floats(checked) if len(self.units) == 1 else checked

    def _read(self, value: Any, inner: Callable[[Any], Any]) -> Any:
        checked = self.check(value)
        try:
            read = inner(checked)
        except ValidationError as error:
            if (text := _text_of_unknown(checked)) is not None:
                expected = " or ".join(self.units) or "its unit"
                expected = f"a number in {expected}, or a text such as {EXAMPLES}; units: {KNOWN}"
                raise ValueError(f"got {show(text)}, expected {expected}") from error
            raise
        if type(checked) is float or (type(checked) is list and all(type(one) is float for one in checked)):
            return read  # no quantity
        return _floats(read) if len(self.units) == 1 else _quantities_in(read, checked)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Read numbers with units before anything else."""
        return core_schema.no_info_wrap_validator_function(self._read, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> JsonSchemaValue:
        """Return the schema, in which texts stand beside numbers."""
        return _or_text(handler(schema))


def plain_number(value: float, unit: str, name: str) -> float:
    """Return a number of a key that takes several units as one of a component of the robot.

    Parameters
    ----------
    value : float
    unit : str
        Of the component: of its units the key takes that of angles, if this is one, or that of lengths.
    name : str
        Of key and component, for messages.

    Raises
    ------
    InvalidValue
        If it was written with another unit.
    """
    if not isinstance(value, Quantity):
        return value
    alike = [one for one in value.units if _is_of_angle(one) == _is_of_angle(unit)]
    own = unit if unit in alike or not unit else next(iter(alike), unit)
    if not own or not value.fits((own,)):
        raise InvalidValue(name, value.describe(), f"a number in {own}" if own else "a number without unit")
    return float(value)


def plain_numbers(values: Sequence[float], units: Sequence[tuple[str, str]], key: str) -> list[float]:
    """Return numbers of components, given by name and unit, as `plain_number` does; further ones stay."""
    numbers = zip(values, units, strict=False)
    found = [plain_number(one, unit, f"{key}{name and '.'}{name}") for one, (name, unit) in numbers]
    return [*found, *values[len(units) :]]


def in_unit(value: Any, metadata: Iterable[Any], unit: str, name: str) -> Any:
    """Return a value of a key of several kinds of tables, as that of one kind takes it.

    Parameters
    ----------
    value
    metadata : iterable
        Of the kind's key.
    unit : str
        Of the kind, where the key has several all the same.
    name : str
        For messages.

    Raises
    ------
    InvalidValue
        If it was written with another unit.
    """
    if isinstance(value, list):
        return [in_unit(entry, metadata, unit, name) for entry in value]
    units = next((item.units for item in metadata if isinstance(item, KeyUnits)), ())
    if isinstance(value, Quantity):
        value.units = units
        return plain_number(value, units[0] if len(units) == 1 else unit, name)
    return value


def _is_of_angle(unit: str) -> bool:
    """Whether it is the unit of a turning joint among two of a key."""
    return any(word in unit for word in ("rad", "N m", "kg m^2"))


def _quantities_in(read: Any, checked: Any) -> Any:
    """What was read, with the quantities that pydantic made floats of."""
    if isinstance(checked, Quantity) and isinstance(read, float):
        return checked
    if isinstance(read, list | tuple) and isinstance(checked, list | tuple) and len(read) == len(checked):
        return type(read)(_quantities_in(*pair) for pair in zip(read, checked, strict=True))
    if isinstance(read, dict) and isinstance(checked, Mapping):
        return {name: _quantities_in(entry, checked.get(name)) for name, entry in read.items()}
    return read


def _floats(value: Any) -> Any:
    if isinstance(value, Quantity):
        return float(value)
    if isinstance(value, list):
        return [_floats(entry) for entry in value]
    return {key: _floats(entry) for key, entry in value.items()} if isinstance(value, dict) else value


def _text_of_unknown(value: Any) -> str | None:
    """The first text that has a number and something behind it."""
    if isinstance(value, str):
        return value if has_unit(value) else None
    if isinstance(value, Mapping):
        value = [entry for name, entry in value.items() if name != _PART]
    texts = (_text_of_unknown(entry) for entry in value) if isinstance(value, list | tuple) else ()
    return next((text for text in texts if text is not None), None)


def _or_text(schema: Any) -> Any:
    if isinstance(schema, list):
        return [_or_text(entry) for entry in schema]
    if not isinstance(schema, dict):
        return schema
    found = {key: _or_text(entry) for key, entry in schema.items()}
    text = {"type": ["number", "string"], "pattern": PATTERN}
    return {**found, **text} if found.get("type") == "number" else found

"""`inertias` of `[robot]` and of a robot.toml: masses and inertias that the file of a robot does not give."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from mbocp._keys import Key, Kind
from mbocp._keys import Table as KeyTable
from mbocp._measured import Measured
from mbocp._numbers import finite_number
from mbocp._text import show
from mbocp.exceptions import RobotError
from mbocp.robot.loading.payload_table import Inertia, check_body
from mbocp.robot.loading.schema_errors import first_complaint, read_table
from mbocp.robot.loading.table_types import Position, Table
from mbocp.robot.payload import MAX_VALUE

_Positive = Annotated[float, Kind("positive number", finite_number, float), Field(gt=0, le=MAX_VALUE)]


class LinkTable(Table):
    """Mass of a link, and its centre of mass and inertia; those of its shapes where they are missing."""

    mass: Annotated[_Positive, Measured("kg")]
    com: Position | None = None
    inertia: Inertia | None = None

    @model_validator(mode="after")
    def _is_a_body(self) -> LinkTable:
        check_body(frame="", **self.model_dump(exclude_none=True))
        return self

    @property
    def is_whole(self) -> bool:
        """Whether it says all."""
        return self.com is not None and self.inertia is not None


def _links(value: Any) -> dict[str, LinkTable]:
    if not isinstance(value, Mapping):
        raise ValueError(f"got {show(value)}, expected a table for each link")
    return {link: _link(link, table) for link, table in value.items()}


def _link(link: str, table: Any) -> LinkTable:
    if isinstance(table, LinkTable):
        return table
    try:
        return LinkTable.model_validate(table)
    except ValidationError as error:
        key, reason = first_complaint(error, table, lambda _: list(LinkTable.model_fields))
        raise ValueError(f"{link}{key and '.'}{key}: {reason}") from error


class InertiasTable(KeyTable):
    """Where masses and inertias of links come from that the file does not give."""

    density: Annotated[
        _Positive | None,
        Key("of the shapes of [links without inertias](robots.md#robots-without-inertias)", "kg/m^3"),
    ] = None
    mass: Annotated[
        _Positive | None, Key("of the whole robot, from which the density of these shapes follows", "kg")
    ] = None
    links: Annotated[
        Any,
        Kind("table", _links, dict[str, dict[str, Any]]),
        Key("`mass`, `com`, `inertia` by link, in place of what the file says", "kg, m, kg m^2"),
    ] = Field(default={})

    @model_validator(mode="after")
    def _says_one_of_them(self) -> InertiasTable:
        if self.density is not None and self.mass is not None:
            raise ValueError("give either density [kg/m^3] or mass [kg], of the whole robot")
        if self.density is None and self.mass is None and not self.links:
            raise ValueError("give density [kg/m^3], mass [kg] of the whole robot, or links")
        return self

    @property
    def is_whole(self) -> bool:
        """Whether it has numbers alone, and no shape is needed."""
        return self.density is self.mass is None and all(link.is_whole for link in self.links.values())

    def within(self, prefix: str) -> InertiasTable:
        """Those links whose names begin so, without the prefix."""
        links = {
            name.removeprefix(prefix): link for name, link in self.links.items() if name.startswith(prefix)
        }
        return self.model_copy(update={"links": links})


def read_inertias(value: InertiasTable | Mapping[str, Any] | None) -> InertiasTable | None:
    """Read the table that Python gives.

    Raises
    ------
    RobotError
        For an unknown or missing key or a wrong value, naming it.
    """
    if value is None:
        return None
    if not isinstance(value, InertiasTable | Mapping):
        raise RobotError(f"inertias: got {show(value)}, expected a table with density, mass or links")
    return read_table(InertiasTable, value, "inertias")

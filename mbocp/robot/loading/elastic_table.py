"""`[[elastic]]` of a robot.toml, `[[robot.elastic]]` of a problem file: springs between joints and motors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import Field

from mbocp._keys import Key, Kind, Table
from mbocp._numbers import finite_number
from mbocp.robot.loading.schema_errors import read_table
from mbocp.robot.payload import MAX_VALUE

_SUFFIX = "_motor"

_Positive = Annotated[float, Kind("positive number", finite_number, float), Field(gt=0, le=MAX_VALUE)]
_NotNegative = Annotated[float, Kind("number of 0 or more", finite_number, float), Field(ge=0, le=MAX_VALUE)]


class ElasticTable(Table):
    """A joint between which and its motor there are a spring and a damper."""

    joint: Annotated[str, Key("a revolute or prismatic joint")]
    stiffness: Annotated[_Positive, Key("of the spring between joint and motor", "N m/rad, N/m")]
    damping: Annotated[_NotNegative, Key("of the damper beside it", "N m s/rad, N s/m")] = 0.0
    motor_inertia: Annotated[_Positive, Key("of the rotor, at the joint's side of the gear", "kg m^2, kg")]


def read_elastic(rows: Sequence[ElasticTable | Mapping[str, Any]] | None) -> list[ElasticTable] | None:
    """Read the tables that Python gives.

    Raises
    ------
    RobotError
        For an unknown or missing key or a wrong value, naming it.
    """
    if rows is None:
        return None
    return [read_table(ElasticTable, row, f"elastic[{number}]") for number, row in enumerate(rows)]


def motor_of(joint: str) -> str:
    """Name of the joint of an elastic joint's motor."""
    return joint + _SUFFIX

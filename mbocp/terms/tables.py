"""Tables within tables: targets and weights of states."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic.json_schema import SkipJsonSchema

from mbocp._keys import Key, Kind, Table
from mbocp.terms.written import Control, Trajectory, Vector, VectorOrNamed


class TargetTable(Table):
    """What the running cost tracks."""

    q: Annotated[Trajectory, Key("of the goal, or one for every step", "m, rad", "the goal's")] = None
    p: Annotated[
        Trajectory, Key("of the goal, or one for every step", "kg m/s, N m s", "that of the goal")
    ] = None


class WeightsTable(Table):
    """Diagonal weights on (q, p): one list, or `q` and `p` apart."""

    qp: Annotated[VectorOrNamed, SkipJsonSchema()] = None  # where a plain list lands
    q: Annotated[Control, Key("weights on q", default="0")] = None
    p: Annotated[Control, Key("on p, or on v where the goal gives v", default="0")] = None


def _listed_weights(value: Any) -> Any:
    return {"qp": value} if isinstance(value, list) else value


Weights = Annotated[WeightsTable, Kind("2 nv numbers, or table with `q` and `p`", _listed_weights, Vector)]

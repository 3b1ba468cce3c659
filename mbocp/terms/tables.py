"""Tables within tables: targets and weights of states."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator

from mbocp.terms.written import Control, Table, Trajectory, VectorOrNamed


class TargetTable(Table):
    """What the running cost tracks."""

    q: Trajectory = None
    p: Trajectory = None


class WeightsTable(Table):
    """Diagonal weights on (q, p): one list, or `q` and `p` apart."""

    qp: VectorOrNamed = None
    q: Control = None
    p: Control = None


def _listed_weights(value: Any) -> Any:
    return {"qp": value} if isinstance(value, list) else value


Target = TargetTable
Weights = Annotated[WeightsTable, BeforeValidator(_listed_weights)]

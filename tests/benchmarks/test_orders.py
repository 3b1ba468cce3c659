"""Orders of states, multipliers, costs and adjoints: each cell of the table is what its row expects."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from benchmarks.orders import GIVEN, OrderCase, Row, by_scheme, orders_of, rows_of
from mbocp.integrators import PAIRS

_QUICK = {
    ("elastic pendulum", "gauss1"),
    ("elastic pendulum", "lobatto3"),
    ("four-bar linkage", "midpoint"),
    ("unicycle", "heun"),
}


def _cases() -> list[object]:
    return [
        pytest.param(
            case,
            row,
            id=f"{case.name}, {row.scheme}, {row.controls}",
            marks=[] if (case.name, row.scheme) in _QUICK else [pytest.mark.slow],
        )
        for case, row in rows_of()
    ]


@pytest.mark.filterwarnings("ignore::UserWarning")  # coarse steps are told to be coarse
@pytest.mark.parametrize(("case", "row"), _cases())
def test_orders_are_those_expected(case: OrderCase, row: Row) -> None:
    found = orders_of(case, row)
    assert found.states == pytest.approx(row.expected, abs=0.2)
    assert found.cost == pytest.approx(row.expected, abs=0.2)
    assert found.adjoint == pytest.approx(row.expected, abs=0.2)
    assert np.isfinite(found.multipliers) == bool(case.robot().nc)
    if case.robot().nc:
        assert found.multipliers == pytest.approx(row.expected, abs=0.2)


def test_every_system_has_what_converges() -> None:
    """Under given controls and at an optimum; each pair of stages on some system with controls at stages."""
    rows = list(rows_of())
    for case, _ in rows:
        kinds = {row.controls for other, row in rows if other is case}
        assert {GIVEN, "constant"} <= kinds
    assert set(PAIRS) - {"gauss1"} <= {row.scheme for _, row in rows if row.controls == "stages"}
    assert "gauss1" in {row.scheme for _, row in rows}


def test_the_page_sums_up_the_file() -> None:
    root = Path(__file__).parents[2]
    with (root / "benchmarks" / "orders.csv").open(encoding="utf-8", newline="") as file:
        _, *rows = map(tuple, csv.reader(file))
    assert by_scheme(rows).markdown() in (root / "benchmarks" / "measured" / "orders.md").read_text("utf-8")
    assert {(case.name, row.scheme, row.controls) for case, row in rows_of()} == {row[:3] for row in rows}

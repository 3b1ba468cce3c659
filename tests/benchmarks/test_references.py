"""Limits of costs: what they are extrapolated from, and the data that tests compare with."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.references import CASES, limit_of, reference_of

DATA = json.loads((Path(__file__).parents[1] / "data/reference_costs.json").read_text())
NUMBERS = st.floats(-10.0, 10.0)


@given(NUMBERS, NUMBERS, NUMBERS, NUMBERS)
def test_limits_of_expansions_are_exact(limit: float, a: float, b: float, c: float) -> None:
    for is_symmetric, powers in ((True, (2, 4, 6)), (False, (2, 3, 4)), (False, (1, 2, 3))):
        costs = [
            limit + sum(x * h**p for x, p in zip((a, b, c), powers, strict=True))
            for h in (0.5, 0.25, 0.125, 0.0625, 0.03125)
        ]
        found, error = limit_of(costs, is_symmetric=is_symmetric, first=powers[0])
        assert found == pytest.approx(limit, abs=1e-11)
        assert error < 1e-10


def test_every_system_has_data() -> None:
    assert {case.name for case in CASES} == set(DATA)
    assert all(entry["error"] < 1e-6 for entry in DATA.values())


@pytest.mark.parametrize("name", ["elastic_pendulum", "cart_pendulum_rigid"])
def test_the_data_are_what_two_schemes_agree_on(name: str) -> None:
    case = next(case for case in CASES if case.name == name)
    found = reference_of(replace(case, levels=4))
    assert found.error < 1e-9
    assert found.cost == pytest.approx(DATA[name]["cost"], rel=1e-9)


def test_a_cost_that_is_known() -> None:
    """Of a closed form, with a limit that acts: Bryson, Denham, Dreyfus (1963)."""
    assert DATA["bryson_denham"]["cost"] == pytest.approx(4.0, rel=1e-9)

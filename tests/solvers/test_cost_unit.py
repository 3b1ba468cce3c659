"""Costs far below any tolerance: the same motions as with weights of ordinary size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.formulation import build
from tests.campaign.run import run_task
from tests.integrators.conftest import interpreted_functions

TINY = 2.0**-44  # 6e-14


@pytest.fixture(autouse=True)
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "load_functions", interpreted_functions)


def solved(factor: float, callback: Any = None, **others: Any) -> mbocp.Solution:
    problem = mbocp.Problem.create(
        "double_pendulum",
        1.5,
        30,
        goal={"q": [2.0, -1.0], "v": [0.0, 0.0]},
        cost={"effort": factor, "velocity": 0.01 * factor},
        **others,
    )
    return mbocp.solve(problem, check=True, callback=callback)


@pytest.mark.parametrize(
    "others",
    [{}, {"limits": {"effort": 0.6}}, {"solver": {"method": "ipopt"}}, {"solver": {"method": "fbsm_newton"}}],
    ids=["auto", "limits", "ipopt", "sweeps"],
)
def test_weights_do_not_matter_but_for_the_price(others: dict[str, Any]) -> None:
    seen: list[float] = []
    plain, tiny = solved(1.0, **others), solved(TINY, lambda record: seen.append(record.cost), **others)
    np.testing.assert_allclose(tiny.us, plain.us, atol=1e-5 * np.abs(plain.us).max())
    assert tiny.cost == pytest.approx(TINY * plain.cost, rel=1e-8)
    for name in ("mus", "eta", "lam_us"):
        whole, part = getattr(plain, name), getattr(tiny, name)
        np.testing.assert_allclose(part / TINY, whole, atol=1e-4 * np.abs(whole).max(initial=1e-3))
    assert max(seen) < 1e-6
    assert "weighed" in tiny.advice
    assert "weighed" not in plain.advice


def test_a_warm_start_of_a_tiny_problem_begins_at_its_solution() -> None:
    cold = solved(TINY)
    problem = mbocp.Problem.create(
        "double_pendulum",
        1.5,
        30,
        goal={"q": [2.0, -1.0], "v": [0.0, 0.0]},
        cost={"effort": TINY, "velocity": 0.01 * TINY},
    )
    assert mbocp.solve(problem, warm_start=cold, check=True).iterations <= 2


@pytest.mark.parametrize("seed", [0, 4])
def test_an_arm_of_a_millimetre_and_a_gram(seed: int, tmp_path: Path) -> None:
    row = run_task("tiny_arm", seed, tmp_path)
    assert row["cost"] < 1e-10
    assert (row["status"], row["failures"]) == ("converged", [])

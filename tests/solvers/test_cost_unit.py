"""Costs far below any tolerance: the same motions as with weights of ordinary size."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from tests.campaign.run import run_task

TINY = 2.0**-44  # 6e-14


def solved(factor: float, callback: Any = None, **others: Any) -> mbocp.Solution:
    problem = mbocp.Problem.create(
        "double_pendulum",
        1.5,
        30,
        goal={"q": [2.0, -1.0], "v": [0.0, 0.0]},
        cost={"effort": factor, "velocity": 0.01 * factor},
        **{"integrator": {"scheme": "se1"}, **others},
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
        scheme="se1",
    )
    assert mbocp.solve(problem, warm_start=cold, check=True).iterations <= 2


@pytest.mark.parametrize("factor", [1.0, TINY])
def test_a_cost_that_turns_out_tiny_is_weighed_once_more(factor: float) -> None:
    """What gravity takes does not show that the motion is short: the solver finds the cost tiny."""
    seen: list[float] = []
    s = nudged(factor, lambda record: seen.append(record.cost))
    newton = [phase.name for phase in s.phases if phase.name.startswith("monolithic")]
    assert len(newton) == 2
    assert newton[1].startswith("monolithic (cost times ")
    assert "the cost is so small that it was weighed" in s.advice
    assert ("; solved with cost weighed" in s.advice) == (factor != 1.0)
    assert s.cost == seen[-1] == s.history[-1].cost
    plain = nudged(2.0**18)
    assert "weighed" not in plain.advice
    assert s.cost / factor == pytest.approx(plain.cost / 2.0**18, rel=1e-8)
    np.testing.assert_allclose(s.us, plain.us, atol=1e-5 * np.abs(plain.us).max())
    for name in ("mus", "eta"):
        whole, part = getattr(plain, name) / 2.0**18, getattr(s, name) / factor
        np.testing.assert_allclose(part, whole, atol=1e-5 * np.abs(whole).max())


def nudged(factor: float, callback: Any = None) -> mbocp.Solution:
    problem = mbocp.Problem.create(
        "double_pendulum",
        1.5,
        30,
        start={"q": [0.0, 0.0]},
        goal={"q": [3e-4, -6e-4], "v": [0.0, 0.0]},
        cost={"effort": factor},
        scheme="se1",
    )
    return mbocp.solve(problem, check=True, callback=callback)


@pytest.mark.parametrize("seed", [4, 6])  # the first step of 0 is wrong by 0.44 rad
def test_an_arm_of_a_millimetre_and_a_gram(seed: int, tmp_path: Path) -> None:
    row = run_task("tiny_arm", seed, tmp_path)
    assert row["cost"] < 1e-10
    assert (row["status"], row["failures"]) == ("converged", [])

"""Limits between nodes: what leaves them is told, and a motion that leaves them far has not converged."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

import mbocp
from mbocp.cli.app import app
from mbocp.problem import Problem
from mbocp.problem.between_nodes import GROSS_EXCESS, largest_excess
from mbocp.solution import Status
from tests.between_nodes.cases import TOLERANCE, row_of, true_excess

pytestmark = pytest.mark.usefixtures("interpreted")

LIMIT = 2.0


def swing(controls: str, steps: int = 20, scheme: str = "gauss2") -> Problem:
    """A double pendulum that has to hurry."""
    return Problem.create(
        mbocp.load_robot("double_pendulum", damping=False),
        1.2,
        steps,
        goal={"q": [1.5, -0.8], "v": 0},
        cost={},
        limits={"velocity": LIMIT},
        scheme=scheme,
        controls=controls,
    )


def is_at_node(ratio: float, qs: np.ndarray, vs: np.ndarray) -> bool:
    """Whether a node leaves a limit as far: solved motions keep them there, and random ones do not."""
    of_speed = (np.abs(vs) - LIMIT).max() / LIMIT
    of_position = (np.maximum([-0.5, -0.9] - qs, qs - [1.6, 0.9]) / [2.1, 1.8]).max()
    return bool(max(of_speed, of_position) >= ratio - 1e-4)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_it_is_the_largest_excess_of_the_cubics(seed: int) -> None:
    rng = np.random.default_rng(seed)
    problem = swing("constant", 3).with_(limits={"position": [[-0.5, 1.6], [-0.9, 0.9]]})
    t = np.cumsum([0.0, *rng.uniform(0.1, 0.5, 3)])
    qs, vs = rng.normal(0.0, 0.4, (4, 2)), rng.normal(0.0, 1.5, (4, 2))
    s = np.linspace(0.0, 1.0, 2001)[:, None]
    ratios = [0.0]
    for n in range(3):
        h = t[n + 1] - t[n]
        m = (qs[n + 1] - qs[n]) / h
        v = (1 - 4 * s + 3 * s**2) * vs[n] + (3 * s**2 - 2 * s) * vs[n + 1] + 6 * s * (1 - s) * m
        q = qs[n] + h * np.vstack([np.zeros(2), np.cumsum((v[1:] + v[:-1]) / 2, axis=0) * (s[1] - s[0])])
        ratios.append(float((np.abs(v) - LIMIT).max() / LIMIT))
        widths = np.array([2.1, 1.8])
        ratios.append(float((np.maximum([-0.5, -0.9] - q, q - [1.6, 0.9]) / widths).max()))
    found = largest_excess(problem, t, qs, vs)
    told = 0.0 if found is None else found.ratio
    assert told <= max(ratios) + 1e-4
    assert told == pytest.approx(max(ratios), abs=1e-4) or is_at_node(max(ratios), qs, vs)


def test_a_motion_that_leaves_its_limits_between_nodes_has_not_converged() -> None:
    s = mbocp.solve(swing("stages"))
    assert s.limit_violation == 0.0
    assert s.status is Status.UNDER_RESOLVED
    assert s.limit_excess > GROSS_EXCESS
    assert s.limit_excess_of.startswith("speed of joint")
    assert f"between nodes the {s.limit_excess_of} is" in s.advice
    assert s.limit_excess == pytest.approx(true_excess(s.load_problem(), s, 1000.0), rel=0.05)


def test_a_small_excess_is_told() -> None:
    s = mbocp.solve(swing("constant"), check=True)
    assert 0.0 < s.limit_excess < GROSS_EXCESS
    assert s.limit_excess == pytest.approx(true_excess(s.load_problem(), s, 1000.0), abs=TOLERANCE)
    finer = mbocp.solve(swing("constant", 80), check=True)
    assert finer.limit_excess < s.limit_excess / 8.0  # of second order


def test_nothing_is_said_of_schemes_of_first_order() -> None:
    assert np.isnan(mbocp.solve(swing("constant", scheme="se1"), check=True).limit_excess)


def test_the_shell_tells_it(tmp_path: Path) -> None:
    result = mbocp.solve(swing("stages")).save(tmp_path / "swing.h5")
    told = json.loads(CliRunner().invoke(app, ["info", str(result), "--json"]).stdout)
    assert told["limit_excess"] > GROSS_EXCESS
    assert told["limit_excess_of"]
    words = CliRunner().invoke(app, ["info", str(result)]).stdout
    assert "leaves its limit by" in words
    assert "all are kept at the nodes" in words


@pytest.mark.slow
@pytest.mark.parametrize("seed", [7, 11, 13])
def test_random_motions_do_not_leave_limits_farther_than_is_told(seed: int) -> None:
    row = row_of(seed)
    assert row["status"] in ("converged", "under_resolved")
    assert not row["is_beyond"], row

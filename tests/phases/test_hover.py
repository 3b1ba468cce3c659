"""A quadrotor flies to a place and waits there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbocp

EXAMPLE = Path(__file__).parents[2] / "examples" / "free_flyer" / "quadrotor.toml"


@pytest.fixture(scope="module")
def solution() -> mbocp.Solution:
    return mbocp.solve(mbocp.load_problem(EXAMPLE), check=True)


def test_it_hovers_where_it_was_told(solution: mbocp.Solution) -> None:
    hovers = solution.t >= solution.phase_times["hover"][0] - 1e-9
    assert np.abs(solution.qs[hovers, :3] - [2, 0, 3]).max() < 0.01 + 1e-6
    assert solution.us.min() > -1e-9
    assert solution.us.max() < 6 + 1e-6


def test_thrusts_give_the_momentum_that_weight_takes(solution: mbocp.Solution) -> None:
    """From rest to rest, vertically; the axis of the body is that in the middle of a step."""
    x, y = ((solution.qs[1:, i] + solution.qs[:-1, i]) / 2 for i in (3, 4))
    upright = 1 - 2 * (x**2 + y**2)
    impulse = np.sum(np.diff(solution.t) * upright * solution.us.sum(axis=1))
    model = solution.load_robot().model
    weight = -sum(inertia.mass for inertia in model.inertias) * model.gravity.linear[2]
    assert impulse == pytest.approx(weight * solution.duration, rel=1e-5)

"""Exciting motions: derivatives of the measure, what the search gains, limits, what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

import mbocp
from mbocp.exceptions import MbocpError
from mbocp.identification import information
from mbocp.identification.exciting import Information, _columns, _log_det, _Search
from mbocp.terms.own import path_constraint

SPEED, EFFORT = 3.0, 25.0


def arm(**changes: Any) -> mbocp.Problem:
    """A double pendulum that hangs, with motors."""
    given: dict[str, Any] = {
        "duration": 3.0,
        "steps": 60,
        "start": {"q": [0.0, 0.0]},
        "goal": {"q": [0.0, 0.0], "v": 0.0},
        "limits": {"velocity": SPEED, "effort": EFFORT, "acceleration": 15.0},
        "scheme": "gauss2",
    }
    return mbocp.Problem.create("double_pendulum", **(given | changes))


def test_the_slope_is_that_of_differences() -> None:
    search, rng = _Search(arm(), [0.05, 0.02], "both", 8), np.random.default_rng(1)
    c, along = search.begin(rng), rng.standard_normal(search.line.shape) * search.free[:, None]

    def value(x: float) -> float:
        return _log_det(search.matrix(search.motion(c + x * along)))

    expected = (value(1e-5) - value(-1e-5)) / 2e-5
    assert np.sum(search.slope(search.motion(c)) * along) == pytest.approx(expected, rel=1e-6)


def test_it_tells_more_than_random_motions_within_the_same_limits() -> None:
    problem = arm()
    solution = mbocp.excite(problem, starts=2, knots=10)
    assert solution.converged
    search, rng = _Search(problem, 0.05, "both", 10), np.random.default_rng(2)
    random = max(_log_det(search.matrix(search.motion(search.begin(rng)))) for _ in range(10))
    told = information(solution)
    assert told.log_det > random + 3.0
    assert told.log_det == pytest.approx(np.log(np.linalg.eigvalsh(told.matrix)).sum(), rel=1e-6)
    between = CubicHermiteSpline(solution.t, solution.qs, solution.vs)(np.linspace(0.0, 3.0, 1201), 1)
    assert np.abs(between).max() < 1.02 * SPEED
    assert np.abs(solution.us).max() <= EFFORT * (1.0 + 1e-6)
    np.testing.assert_allclose(solution.qs[-1], solution.qs[0], atol=1e-8)
    np.testing.assert_allclose(solution.vs[-1], 0.0, atol=1e-8)


def test_standard_deviations_are_those_of_regressions() -> None:
    search, rng = _Search(arm(), 0.05, "both", 8), np.random.default_rng(3)
    motion = search.motion(search.begin(rng))
    Y = _columns(search.dynamics, search.unknowns, search.base, motion).reshape(-1, search.base.rank)
    errors = 0.05 * rng.standard_normal((len(Y), 4000)) / np.sqrt(search.weight)
    found = np.linalg.lstsq(Y, errors, rcond=None)[0].std(axis=1)
    np.testing.assert_allclose(Information(search.base, search.matrix(motion)).sd, found, rtol=0.06)


def test_goals_elsewhere_are_reached() -> None:
    goal = {"q": [0.8, -0.4], "v": 0.0}
    solution = mbocp.excite(arm(goal=goal), starts=1, rounds=3, knots=6)
    assert solution.converged
    np.testing.assert_allclose(solution.qs[-1], goal["q"], atol=1e-8)


def test_path_constraints_of_ones_own_stay() -> None:
    below = path_constraint(lambda at: at.q[0], upper=0.3, name="below")
    solution = mbocp.excite(arm(terms=[below]), starts=1, rounds=10, knots=6)
    assert solution.converged
    assert solution.qs[:, 0].max() == pytest.approx(0.3, abs=1e-5)


@pytest.mark.parametrize(
    ("changes", "options", "says"),
    [
        ({"limits": {}}, {}, "nothing limits how fast"),
        ({"goal": {"v": 0.0}}, {}, "goal.q"),
        ({"start": {"q": [0.0, 0.0], "v": [1.0, 0.0]}}, {}, "rest"),
        ({"duration": {"min": 1.0, "max": 2.0}}, {}, "duration"),
        ({"duration": 0.05, "goal": {"q": [1.0, 0.0], "v": 0.0}}, {}, "longer horizon.duration"),
        ({}, {"torque_noise": 0.0}, "torque_noise"),
        ({}, {"starts": 0}, "starts"),
        ({}, {"friction": "dry"}, "friction"),
    ],
)
def test_what_it_refuses(changes: dict[str, Any], options: dict[str, Any], says: str) -> None:
    with pytest.raises(MbocpError, match=says):
        mbocp.excite(arm(**changes), **options)


def test_loops_are_refused() -> None:
    problem = mbocp.load_problem("examples/loops/four_bar.toml")
    with pytest.raises(MbocpError, match="closed loops"):
        mbocp.excite(problem)

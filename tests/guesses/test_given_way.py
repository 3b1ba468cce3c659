"""A guess through configurations that are given, as a path planner finds them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbocp
from mbocp.formulation import formulate
from mbocp.guesses.make import make_guess
from mbocp.guesses.ways import through
from mbocp.problem import Problem, parse_problem

ANGLES = st.floats(-2.0, 2.0)
PLACES = st.lists(st.tuples(ANGLES, ANGLES), min_size=1, max_size=4).map(np.array)


@pytest.fixture(scope="module")
def arm():
    return mbocp.load_robot("double_pendulum", damping=False)


def problem(robot, **changes) -> Problem:
    rest = {"start": {"q": [0.0, 0.0]}, "goal": {"q": [1.0, 0.5], "v": 0}, "cost": {"effort": 1.0}}
    return Problem.create(
        robot,
        1.0,
        40,
        **{"integrator": {"scheme": "se1"}, **rest, **changes},
    )


@given(PLACES, st.integers(5, 60))
def test_a_way_goes_through_its_corners_at_a_steady_rate(arm, corners, count):
    start = np.zeros(2)
    way = through(arm, list(corners))
    lengths = np.linalg.norm(np.diff(np.vstack([start, corners]), axis=0), axis=1)
    at = np.cumsum(lengths) / max(lengths.sum(), 1e-300)
    np.testing.assert_allclose(way(start, at[:-1]), corners[:-1], atol=1e-9)
    found = way(start, np.linspace(0.0, 1.0, count))
    np.testing.assert_allclose(found[0], start, atol=1e-12)
    if lengths.sum() > 1e-6:
        np.testing.assert_allclose(found[-1], corners[-1], atol=1e-12)
    assert np.linalg.norm(np.diff(found, axis=0), axis=1).max() <= lengths.sum() / (count - 1) + 1e-12


def test_the_guess_goes_through_them(arm):
    asked = problem(arm, guess={"q": [[-1.0, 0.4], {"joint2": -0.7}]})
    assert asked.guess.kind == "way"
    np.testing.assert_array_equal(asked.guess.q, [[-1.0, 0.4], [0.0, -0.7]])
    iterate, words = make_guess("way", formulate(asked))
    assert "guess.q" in words
    qs = formulate(asked).motion_of(iterate).qs
    for corner in asked.guess.q:
        assert np.linalg.norm(qs - corner, axis=1).min() < 0.1
    solution = mbocp.solve(asked)
    assert solution.converged
    again = parse_problem(solution.problem_text)
    np.testing.assert_array_equal(again.guess.q, asked.guess.q)


@pytest.mark.parametrize(
    ("guess", "words"),
    [
        ({"q": []}, "at least one configuration"),
        ({"q": [[0.0, 1.0, 2.0]]}, "guess.q"),
        ({"q": [[0.0, float("nan")]]}, "guess.q"),
        ({"kind": "way"}, "needs the key 'q'"),
        ({"q": [{"no_joint": 1.0}]}, "no_joint"),
    ],
)
def test_what_is_no_way_is_refused(arm, guess, words):
    with pytest.raises(mbocp.MbocpError, match=words):
        problem(arm, guess=guess)


def test_velocities_do_not_swing_after_a_corner(arm):
    asked = problem(arm, integrator={"scheme": "midpoint"}, guess={"q": [[-1.0, 0.4], [0.3, -0.7]]})
    formulation = formulate(asked)
    motion = formulation.motion_of(make_guess("way", formulation)[0])
    rates = np.diff(motion.qs, axis=0) / motion.dts[:, None]
    np.testing.assert_allclose((motion.vs[1:] + motion.vs[:-1]) / 2.0, rates, atol=1e-12)
    bends = np.abs(np.diff(motion.vs, n=2, axis=0))
    assert np.median(bends, axis=0).max() < 0.02 * np.abs(rates).max()  # but for the two corners


@pytest.mark.parametrize("longest", [20.0, 1.5])
def test_a_way_takes_the_time_that_speeds_ask_for(arm, longest):
    asked = Problem.create(
        arm,
        {"min": 0.5, "max": longest, "guess": 1.0},
        40,
        start={"q": [0.0, 0.0]},
        goal={"q": [1.0, 0.5], "v": 0},
        cost={"time": 1.0, "effort": 1.0},
        limits={"velocity": [2.0, 1.0]},
        guess={"q": [[-1.0, 0.4], [0.3, -0.7]]},
        integrator={"scheme": "midpoint"},
    )
    formulation = formulate(asked)
    motion = formulation.motion_of(make_guess("way", formulation)[0])
    fastest = np.abs(motion.vs / [2.0, 1.0]).max()
    if longest > 2.0:
        np.testing.assert_allclose(fastest, 1.0, rtol=1e-9)
        assert 1.0 < motion.dts.sum() < longest
    else:
        assert fastest > 1.0
        np.testing.assert_allclose(motion.dts.sum(), longest)

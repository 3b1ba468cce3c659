"""The straight line, in a time that limits of rates allow."""

from __future__ import annotations

import math

import numpy as np
import pytest

import mbocp
from mbocp.formulation import formulate
from mbocp.guesses.starts import guesses_in_turn
from mbocp.guesses.straight_line import line

UR5 = mbocp.load_robot("ur5")
Q0 = np.array([1.537, 1.434, 2.077, 0.852, 0.964, -1.681])
Q1 = np.array([0.388, 0.386, 2.5, 1.203, 2.042, -2.045])
LIMITS = {"effort": True, "velocity": True, "acceleration": 10.0, "jerk": 100.0}


def fastest(**limits: object) -> mbocp.Problem:
    """From rest to rest; the geometric mean of the bounds is a quarter of what the motion takes."""
    return mbocp.Problem.create(
        UR5,
        {"min": 0.0125, "max": 4.0},
        50,
        start={"q": Q0},
        goal={"q": Q1, "v": 0},
        limits=LIMITS | limits,
        cost={"time": 1.0, "effort": 1e-5},
        integrator={"scheme": "midpoint"},
    )


@pytest.mark.parametrize(
    "limits", [{}, {"jerk": False}, {"jerk": False, "acceleration": False, "velocity": 1.0}]
)
def test_it_is_as_fast_as_limits_of_rates_allow(limits: dict[str, object]) -> None:
    formulation = formulate(fastest(**limits))
    motion = formulation.motion_of(line(formulation))
    most = LIMITS | {"velocity": np.pi} | limits  # what the robot itself allows, where nothing else is said
    rates, shares = motion.vs, []
    for name in ("velocity", "acceleration", "jerk"):
        if most[name]:
            shares.append(np.abs(rates).max() / most[name])
        rates = np.diff(rates, axis=0) / motion.dts[0]
    assert max(shares) == pytest.approx(1.0, rel=0.01)


def test_a_least_time_is_found_from_bounds_far_apart() -> None:
    found = mbocp.solve(fastest(), solver="monolithic")
    assert found.converged
    assert found.duration == pytest.approx(0.7848, abs=1e-4)


def test_it_takes_no_longer_than_it_may() -> None:
    problem = fastest().with_(duration={"min": 0.0125, "max": 0.4})
    formulation = formulate(problem)
    assert formulation.motion_of(line(formulation)).dts.sum() == pytest.approx(0.4)


@pytest.mark.parametrize(("most", "longer"), [(8.0, [1.5, 2.5]), (1.7, [1.5]), (1.05, [])])
def test_after_a_failure_the_line_takes_longer_where_it_may(most: float, longer: list[float]) -> None:
    problem = fastest().with_(duration={"min": 0.5, "max": most, "guess": 1.0})
    formulation = formulate(problem)
    makers = [make for name, make in guesses_in_turn(formulation, None) if "times as long" in name]
    motions = [formulation.motion_of(make(math.inf)[0]) for make in makers]
    assert [motion.dts.sum() for motion in motions] == pytest.approx(longer)
    assert all(motion.qs[-1] == pytest.approx(problem.goal.q) for motion in motions)


def test_a_part_whose_duration_is_given_keeps_it_in_a_longer_line() -> None:
    named = [
        {"name": "fast", "steps": 10, "duration": 0.5},
        {"name": "free", "steps": 10, "duration": {"min": 0.1, "max": 4.0, "guess": 0.5}},
    ]
    problem = mbocp.Problem.create(
        UR5, phase=named, start={"q": Q0}, goal={"q": Q1, "v": 0}, cost={"time": 1.0}
    )
    dts = formulate(problem).motion_of(line(formulate(problem), times=2.0)).dts
    assert dts[:10].sum() == pytest.approx(0.5)
    assert dts[10:].sum() == pytest.approx(1.0)

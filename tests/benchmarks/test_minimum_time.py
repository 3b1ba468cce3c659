"""What the benchmark of minimum time compares: bounds, the straight line, and its table."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent.parent.parent))  # not part of the package

from benchmarks.minimum_time import ARMS, Limits, Row, bound_of, cells, pairs, problem_of
from benchmarks.straight_path import fastest_on_line, slowest_joint_alone


def test_the_slowest_joint_alone_is_a_trapezoid_or_a_triangle() -> None:
    velocity, acceleration = np.array([2.0, 3.0]), np.array([4.0, 9.0])
    # 1 s of cruise between two ramps of 0.5 s; the second joint is never at full speed.
    assert slowest_joint_alone(np.array([3.0, 0.25]), velocity, acceleration) == pytest.approx(2.0)
    assert slowest_joint_alone(np.array([0.0, -0.25]), velocity, acceleration) == pytest.approx(1.0 / 3.0)
    assert slowest_joint_alone(np.array([3.0, -6.0]), velocity, None) == pytest.approx(2.0)


@pytest.mark.parametrize("name", ARMS)
def test_pairs_are_within_the_limits_and_the_same_for_the_same_seed(name: str) -> None:
    first, again, other = (list(pairs(name, 4, seed)) for seed in (3, 3, 4))
    for a, b, c in zip(first, again, other, strict=True):
        limits = a.robot.limits
        for q in (a.q0, a.q1):
            assert (q > limits.position_lower).all()
            assert (q < limits.position_upper).all()
        assert np.array_equal(a.q1, b.q1)
        assert not np.array_equal(a.q1, c.q1)


def test_a_problem_has_the_limits_that_are_asked_for() -> None:
    (pair,) = pairs("panda", 1)
    every = problem_of("panda", pair, Limits(acceleration=True, jerk=True), 20)
    bound = bound_of("panda", pair, Limits(acceleration=True))
    assert every.duration_range == pytest.approx((0.5 * bound, 8.0 * bound))
    np.testing.assert_array_equal(every.limits.a_upper, ARMS["panda"].acceleration)
    np.testing.assert_array_equal(every.limits.j_upper, ARMS["panda"].jerk)
    lowered = 0.5 * pair.robot.limits.effort
    few = problem_of("panda", pair, Limits(), 20, lowered)
    np.testing.assert_array_equal(few.limits.u_upper, lowered)
    assert not few.limits.finite("a").any()
    assert bound_of("panda", pair, Limits()) < bound


def test_a_table_counts_what_is_longer_and_what_no_motion_beats() -> None:
    rows = [
        Row("converged", 1.0, 2.0, 1.0, 0.9, 1.0, 10, 0.1),
        Row("converged", 2.2, 2.0, 1.0, 0.8, 1.0, 20, 0.2),
        Row("infeasible", 9.0, 2.0, 1.0, 0.7, 1.0, 30, 0.3),
    ]
    converged, iterations, _, shorter, kept, bound, torque = cells(rows)
    assert converged == "2 of 3, infeasible 1"
    assert iterations == "20 / 28 / 30"
    assert shorter == "20.000 / 20.000 / -10.000 / 50.000"
    assert (kept, bound) == ("1 of 2", "1 of 2")
    assert torque == "0.900 / 1.000"


@pytest.mark.parametrize("name", ARMS)
def test_toppra_takes_what_the_slowest_joint_takes_where_torques_are_ample(name: str) -> None:
    """With the same acceleration and speed for all joints the straight line is the fastest way."""
    pytest.importorskip("toppra")
    (pair,) = pairs(name, 1, seed=2)
    acceleration = 2.0 * pair.robot.limits.velocity
    largest = np.argmax(np.abs(pair.q1 - pair.q0) / pair.robot.limits.velocity)
    found = fastest_on_line(pair.robot, pair.q0, pair.q1, acceleration, grid=200)
    alone = slowest_joint_alone(
        (pair.q1 - pair.q0)[[largest]], pair.robot.limits.velocity[[largest]], acceleration[[largest]]
    )
    assert found.torque < 1.0
    assert found.duration == pytest.approx(alone, rel=1e-3)
    assert fastest_on_line(pair.robot, pair.q0, pair.q1, None, grid=200).duration < found.duration

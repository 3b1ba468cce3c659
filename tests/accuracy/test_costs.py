"""What costs tell of their errors: the order that is seen, and errors that cancel."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mbocp.accuracy.costs import CostLimit, cost_error, cost_limit

LEVELS = np.array([1.0, 2.0, 4.0, 8.0])
SIZES = st.floats(1e-6, 1e-1)


@given(SIZES, st.sampled_from([1, 2, 4]), st.sampled_from([-1.0, 1.0]), st.booleans())
@settings(max_examples=30)
def test_costs_of_the_expected_order(size: float, order: int, sign: float, is_smooth: bool) -> None:
    costs = 1.0 + sign * size * LEVELS**-order
    error = abs(costs[-1] - 1.0)
    assert cost_error(costs, order, is_smooth=is_smooth) == pytest.approx(error, rel=1e-3)


@given(SIZES, st.floats(1.05, 1.95))
@settings(max_examples=30)
def test_the_order_that_is_seen_counts_where_it_is_lower(size: float, order: float) -> None:
    costs = 1.0 + size * LEVELS**-order
    error = costs[-1] - 1.0
    assert cost_error(costs[1:], 2) == pytest.approx(error, rel=1e-3)
    assert cost_error(costs[2:], 2) < 0.999 * error  # two costs do not tell


@given(SIZES, st.floats(0.6, 0.999))
@settings(max_examples=30)
def test_one_difference_that_vanishes_is_not_believed(size: float, share: float) -> None:
    """Errors of second order and of fourth, of different signs, such that the last costs hardly differ."""
    h = 1.0 / LEVELS[1:]
    costs = 1.0 + size * (h**2 - share * 4.0 / 5.0 / h[-2] ** 2 * h**4)
    assert cost_error(costs, 2) > 0.25 * abs(costs[-1] - 1.0)


def test_a_difference_that_happens_to_be_small_is_no_high_order() -> None:
    """Costs of a Panda with 12, 25 and 50 steps of gauss2, controls at its stages."""
    errors = np.array([3.5e-6, 1.5e-7, 1.9e-7])
    assert cost_error(1.0 + errors[1:], 4) < 3e-9
    assert cost_error(1.0 + errors, 4) > abs(errors[-1])


def test_orders_that_are_not_alike_leave_the_larger_of_the_last_differences() -> None:
    """Costs of a double pendulum in natural coordinates, by the midpoint rule with 40 to 320 steps."""
    errors = np.array([-9.45e-4, -3.07e-3, -2.41e-3, -8.92e-4])
    told = [cost_error(1.0 + errors, 2, is_smooth=is_smooth) for is_smooth in (True, False)]
    assert told[0] >= abs(errors[-1])
    assert told[1] == pytest.approx(np.abs(np.diff(errors))[-2:].max())
    assert told[1] >= abs(errors[-1])


def test_what_is_not_known_and_what_is_round_off() -> None:
    assert cost_error([2.0, 1.0], 2) == pytest.approx(1.0 / 3.0)
    assert cost_error([math.nan, 2.0, 1.0], 2) == 1.0
    assert cost_error([1.0 + 1e-14, 1.0, 1.0], 4) < 1e-11
    assert cost_error([1.0, 1.0, 1.0], 2) == 0.0


@given(SIZES, st.floats(-200.0, 40.0), st.sampled_from([1, 2]))
@settings(max_examples=50)
def test_errors_of_two_orders_do_not_cancel_in_both_differences(
    size: float, share: float, order: int
) -> None:
    """a h^q + b h^2q, of which no order is seen: where one difference vanishes the other is large."""
    h = 1.0 / LEVELS
    costs = 1.0 + size * (h**order + share * h ** (2 * order))
    differences = np.abs(np.diff(costs))
    assume(differences.min() > 0.0)
    seen = np.log2(differences[:-1] / differences[1:])
    assume(seen.min() < 0.8 or seen.max() > order + 1.0)
    told = cost_error(costs, order, is_smooth=False)
    assert told >= 0.85 * abs(costs[-1] - 1.0)
    assert told <= 2.0 * differences[-2:].max()


@given(SIZES, st.sampled_from([1, 2, 4]), st.floats(-0.5, 0.5))
@settings(max_examples=50)
def test_a_limit_is_as_near_as_it_says(size: float, order: int, share: float) -> None:
    """With a part of an order that is higher by two; far nearer than the last cost is."""
    h = 1.0 / LEVELS[1:]
    costs = 1.0 + size * (h**order + share * h ** (order + 2))
    error = cost_error(costs, order)
    limit = cost_limit(costs, order, error)
    assert abs(limit.value - 1.0) <= limit.unsure
    assert limit.unsure < 0.5 * error
    for cost in (1.0 - 2.0 * size, 1.0 + size):
        assert abs(cost - 1.0) <= limit.error_of(cost) <= abs(cost - 1.0) + 2.0 * limit.unsure


def test_limits_that_are_unsure() -> None:
    """Errors of no order, two costs that are all there is, and another limit that is elsewhere."""
    assert cost_limit([1.1, 1.0], 2, 0.5) == CostLimit(1.0, 0.5)
    two = cost_limit([1.0, 0.25], 2, 0.25)
    assert (two.value, two.unsure) == (0.0, 0.25)
    assert math.isfinite(cost_limit([math.nan, 1.0, 0.25], 2, 0.25).unsure)
    sure = CostLimit(1.0, 1e-3)
    assert sure.beside(CostLimit(1.001, 1e-3)) is sure
    assert sure.beside(CostLimit(1.1, 1e-3)) == CostLimit(1.0, pytest.approx(0.1))

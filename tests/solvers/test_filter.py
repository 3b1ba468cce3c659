"""The filter of the line search: what it accepts, what it forbids, and what it forgets."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from mbocp.programme.native_modules import kernel

if TYPE_CHECKING:
    from mbocp.programme.native_modules import Trial

VIOLATION, COST = st.floats(0.0, 1e3), st.floats(-1e3, 1e3)


def trial(violation: float, cost: float) -> Trial:
    return kernel().Trial(objective=cost, violation=violation)


@given(VIOLATION, COST, VIOLATION, COST)
def test_a_trial_is_no_worse_than_a_corner_in_one_of_the_two(
    violation: float, cost: float, tried: float, lower: float
) -> None:
    before, after = trial(violation, cost), trial(tried, lower)
    kept = kernel().Filter.start(1e3, is_limited=False).with_corner(before)
    if kept.accepts(before, after, 0.0, 1.0).is_accepted:
        assert tried < violation or lower < cost


@given(VIOLATION, COST, VIOLATION, COST)
def test_less_violation_is_progress_whatever_the_cost(
    violation: float, cost: float, tried: float, other: float
) -> None:
    assume(tried < 0.999 * violation)
    filter_ = kernel().Filter.start(violation, is_limited=False)
    assert filter_.accepts(trial(violation, cost), trial(tried, other), 0.0, 1.0).is_accepted
    assert filter_.accepts_after_relaxation(trial(violation, cost), trial(tried, other))


@pytest.mark.parametrize(("is_limited", "farthest"), [(False, 1e3), (True, 10.0)])
@given(first=st.floats(0.0, 1e6), violation=VIOLATION, cost=COST)
def test_a_cleared_filter_has_the_bounds_of_the_first_violation(
    is_limited: bool, farthest: float, first: float, violation: float, cost: float
) -> None:
    """What an old objective forbade is gone; the violation may not rise again and again."""
    filter_ = kernel().Filter.start(first, is_limited)
    grown = filter_.with_corner(trial(violation, cost))
    assert (filter_.num_corners, grown.num_corners) == (0, 1)
    cleared = grown.without_corners()
    assert cleared.num_corners == 0
    assert cleared.most_violation == filter_.most_violation == farthest * max(1.0, first)


@given(COST, st.floats(1e-3, 1e3), st.floats(0.0, 1.0))
def test_a_descent_of_a_feasible_motion_has_to_pay(cost: float, slope: float, part: float) -> None:
    """It is accepted for its cost exactly where that falls by a part of what was foreseen."""
    before, filter_ = trial(0.0, cost), kernel().Filter.start(0.0, is_limited=False)
    verdict = filter_.accepts(before, trial(1e-12, cost - part * slope), -slope, 1.0)
    assert verdict.by_cost
    assume(abs(part - 1e-4) * slope > 1e-9)
    assert verdict.is_accepted == (part > 1e-4)

"""Barrier parameters that steps choose: when they are free, and how large they are."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbocp.programme.native import kernel
from mbocp.solvers.newton_method.centring import Centring, aimed_barrier

POSITIVE = st.floats(1e-12, 1e12)


@given(POSITIVE, st.floats(0.0, 1.0), st.floats(0.1, 1e3))
def test_the_parameter_is_a_part_of_the_mean_whatever_the_unit(mean: float, part: float, unit: float) -> None:
    barrier = aimed_barrier(mean, part * mean)
    assert 0.0 <= barrier <= mean
    assert aimed_barrier(unit * mean, unit * part * mean) == pytest.approx(unit * barrier)


@given(POSITIVE, st.floats(1.0, 100.0))
def test_where_a_step_gains_nothing_it_goes_to_the_centre(mean: float, part: float) -> None:
    assert aimed_barrier(mean, part * mean) == pytest.approx(mean)


@given(POSITIVE, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_the_more_a_step_gains_the_smaller_the_parameter(mean: float, one: float, other: float) -> None:
    less, more = sorted((one, other))
    assert aimed_barrier(mean, less * mean) <= aimed_barrier(mean, more * mean)


def gone(residuals: list[float]) -> Centring:
    centring = Centring(first=1.0, bounds=kernel().Filter.start(0.0))
    for residual in residuals:
        centring = centring.update(residual, 1e-3 * residual, is_newtons=False)
    return centring


@given(st.lists(st.floats(1.0, 50.0), min_size=4, max_size=4))
def test_parameters_are_fixed_exactly_where_residuals_do_not_fall(residuals: list[float]) -> None:
    centring = gone(sorted(residuals, reverse=True))
    top = max(centring.residuals)
    assert centring.is_free
    assert centring.update(0.5 * top, 1e-3, is_newtons=False).is_free
    assert not centring.update(top, 1e-3, is_newtons=False).is_free


@given(POSITIVE, st.floats(101.0, 1e6))
def test_parameters_are_fixed_at_once_where_a_residual_leaps(residual: float, leap: float) -> None:
    assert not gone([residual, leap * residual]).is_free


@given(st.lists(POSITIVE, min_size=1, max_size=12), POSITIVE)
def test_a_fixed_parameter_is_none_of_the_small_ones(residuals: list[float], mean: float) -> None:
    centring = gone(residuals)
    fixed = centring.fixed_barrier(mean)
    assert fixed == pytest.approx(max(0.8 * mean, *centring.barriers))


def test_parameters_are_free_once_more_where_newtons_steps_are_better_than_all_before() -> None:
    centring = gone([8.0, 4.0]).fix()
    assert not centring.is_free
    assert not centring.update(1.0, 1e-3, is_newtons=False).is_free
    assert not centring.update(4.0, 1e-3, is_newtons=True).is_free
    again = centring.update(3.9, 1e-3, is_newtons=True)
    assert again.is_free
    assert not again.fix().update(1e-9, 1e-3, is_newtons=True).is_free

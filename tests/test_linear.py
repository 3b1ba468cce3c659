"""Linear algebra that several layers need alike."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mbocp._arrays import align, largest_entry, norm, select_spanning_rows


@pytest.mark.parametrize("scale", [1e-300, 1e-200, 1e-100, 1.0, 1e150, 1e200, 1e300])
def test_the_norm_has_its_digits_where_squares_have_none(scale: float) -> None:
    """Warnings are errors: nothing overflows on the way, either."""
    assert norm(scale * np.array([3.0, -4.0])) == pytest.approx(5.0 * scale, rel=1e-15)


def test_the_norm_of_what_is_not_finite_is_not() -> None:
    assert norm(np.array([np.inf, 1.0])) == math.inf
    assert math.isnan(norm(np.array([np.nan, 1e200])))
    assert norm(np.zeros(0)) == 0.0


def test_of_rows_that_are_nearly_as_long_as_each_other_the_first_is_chosen() -> None:
    rows = np.array([[0.995, 0.0], [1.0, 0.0], [0.0, 0.5]])
    assert select_spanning_rows(rows, 1e-9) == [0, 2]
    assert select_spanning_rows(rows[[1, 0, 2]] * [[1.0], [0.98], [1.0]], 1e-9) == [0, 2]


def test_of_entries_that_are_nearly_as_large_as_each_other_the_first_is_chosen() -> None:
    assert largest_entry(np.array([0.1, -0.995, 1.0])) == 1
    assert largest_entry(np.array([0.1, -0.98, 1.0])) == 2


@pytest.mark.parametrize(("size", "dimension"), [(6, 3), (18, 12), (5, 5), (7, 1), (4, 0)])
def test_a_space_has_one_basis_however_it_was_found(size: int, dimension: int) -> None:
    rng = np.random.default_rng(size)
    basis = np.linalg.qr(rng.normal(size=(size, dimension)))[0]
    turned = basis @ np.linalg.qr(rng.normal(size=(dimension, dimension)))[0]
    found = align(basis)
    assert align(turned) == pytest.approx(found, abs=1e-14)
    assert found.T @ found == pytest.approx(np.eye(dimension), abs=1e-14)
    assert found @ found.T == pytest.approx(basis @ basis.T, abs=1e-14)

"""Polynomials of controls within a step: interpolation, means, slopes, and what each scheme takes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbocp.integrators import (
    CONTROLS,
    PAIRS,
    SCHEMES,
    basis_slopes,
    control_basis,
    control_means,
    control_powers,
    cost_order,
    shares_of,
)

SEVERAL = [name for name, pair in PAIRS.items() if pair.num_stages > 1]
SHARES = [shares_of("stages", scheme) for scheme in SEVERAL] + [shares_of("linear", "gauss2")]
coefficients = st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=3)


@given(st.sampled_from(SHARES), coefficients, st.floats(0.0, 1.0))
def test_polynomials_of_as_many_coefficients_are_reproduced(
    shares: tuple[float, ...], given_terms: list[float], at: float
) -> None:
    polynomial = np.polynomial.Polynomial(given_terms[: len(shares)])
    values = polynomial(np.array(shares))
    size = 1.0 + np.abs(given_terms).max()
    assert control_basis(shares, [at])[0] @ values == pytest.approx(polynomial(at), abs=1e-12 * size)
    assert basis_slopes(shares, at) @ values == pytest.approx(polynomial.deriv()(at), abs=1e-12 * size)
    area = polynomial.integ()(1.0)
    assert control_means(shares) @ values == pytest.approx(area, abs=1e-12 * size)
    powers = control_powers(shares) @ values
    assert powers[: len(polynomial.coef)] == pytest.approx(polynomial.coef, abs=1e-11 * size)


@pytest.mark.parametrize("scheme", SEVERAL)
def test_means_are_the_quadrature_of_the_scheme(scheme: str) -> None:
    """So that `us` is what the effort of a scheme sees in the mean."""
    assert control_means(shares_of("stages", scheme)) == pytest.approx(PAIRS[scheme].b, abs=1e-15)


def test_every_scheme_says_what_it_takes() -> None:
    for name, data in SCHEMES.items():
        assert set(data.controls) <= set(CONTROLS)
        assert "constant" in data.controls
        assert not shares_of("constant", name)
        orders = [cost_order(kind, name) for kind in ("constant", "linear", "stages")]
        assert orders == sorted(orders)
        assert orders[-1] == data.order

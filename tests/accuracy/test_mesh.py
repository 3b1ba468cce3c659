"""Lengths of steps from errors: they fill the duration, and errors become as wanted."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbocp._arrays import Array
from mbocp.accuracy.mesh import ErrorTargets, _Lengths, control_shares, lengths_for

LENGTHS = st.lists(st.floats(0.05, 0.2), min_size=3, max_size=30).map(np.array)
MOST = 20_000


def halve(dts: np.ndarray) -> np.ndarray:
    return _Lengths(dts).halve().dts


@given(LENGTHS, st.integers(0, 2**32 - 1), st.floats(1e-8, 1e-2), st.sampled_from([1, 2, 4, 6]))
@settings(max_examples=25)
def test_steps_fill_the_duration_and_change_little_at_once(
    dts: Array, seed: int, asked: float, order: int
) -> None:
    rng = np.random.default_rng(seed)
    errors, shares = (10.0 ** rng.uniform(-9, -3, dts.size) for _ in range(2))
    wanted = ErrorTargets(asked, order, asked, min(order, 2))
    pairs = lengths_for(dts, errors, shares, wanted, most=MOST)
    assert pairs.min() > 0.0
    assert pairs.sum() == pytest.approx(dts.sum(), rel=1e-12)
    assert 4 <= pairs.size <= MOST // 2
    assert halve(pairs).size == 2 * pairs.size
    np.testing.assert_allclose(halve(pairs).reshape(-1, 2).sum(axis=1), pairs)
    assert pairs.max() / 2 <= 2.0 * dts.max() * (1 + 1e-9)  # no more than twice as long at once
    assert pairs.min() / 2 >= dts.min() / 8 / 2


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2]))
@settings(max_examples=15)
def test_errors_of_the_next_steps_are_as_wanted(seed: int, q: int) -> None:
    """With densities that stay: D h^(q+1) of the cost, C h^(p+1) of single steps."""
    rng, p = np.random.default_rng(seed), 2 * q
    coarse = np.full(400, 0.01)
    t = np.cumsum(coarse) - 0.005
    a, b = rng.uniform(0.5, 2.0, 2)

    def cost_density(at: Array) -> Array:
        return 1.0 + a * np.sin(b * at) ** 2

    def local_density(at: Array) -> Array:
        return 1.0 + b * np.cos(a * at) ** 2

    wanted = ErrorTargets(2e-3 ** (p + 1), p, 0.3 * (cost_density(t) @ coarse ** (q + 1)), q)
    pairs = lengths_for(
        coarse,
        local_density(t) * coarse ** (p + 1),
        cost_density(t) * coarse ** (q + 1),
        wanted,
        most=MOST,
    )
    dts = halve(pairs)
    middles = np.cumsum(dts) - dts / 2
    local = local_density(middles) * dts ** (p + 1)
    assert local.max() <= 1.05 * wanted.step
    assert cost_density(middles) @ dts ** (q + 1) <= 1.05 * wanted.cost


def test_no_fewer_steps_would_do_for_the_cost() -> None:
    """Equal shares: the condition of fewest steps with a given sum."""
    coarse = np.full(100, 0.02)
    t = np.cumsum(coarse) - 0.01
    density = np.exp(-t / 2) ** 3
    pairs = lengths_for(
        coarse,
        np.full(100, 1e-12),
        density * coarse**3,
        ErrorTargets(1.0, 4, 0.1 * (density @ coarse**3), 2),
        most=MOST,
    )
    dts = halve(pairs)
    share = np.exp(-(np.cumsum(dts) - dts / 2) / 2) ** 3 * dts**3
    assert share.max() / share.min() < 1.2


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 2, 4]), st.floats(0.7, 0.95))
@settings(max_examples=15)
def test_steps_that_nobody_halves_are_as_few_as_the_cost_allows(seed: int, q: int, aim: float) -> None:
    """Their shares add up to what is wanted, to what whole numbers leave; equal steps need no fewer."""
    dts = np.full(400, 0.01)
    t = np.cumsum(dts) - 0.005
    density = 1.0 + np.random.default_rng(seed).uniform(0.5, 2.0) * np.sin(t) ** 2
    now = float(density @ dts ** (q + 1))
    wanted = ErrorTargets(1.0, 2 * q, now / aim, q)
    found = lengths_for(dts, np.full(400, 1e-9), density * dts ** (q + 1), wanted, most=MOST, in_pairs=False)
    middles = np.cumsum(found) - found / 2
    came_to = np.interp(middles, t, density) @ found ** (q + 1)
    assert came_to == pytest.approx(wanted.cost, rel=0.05)
    equal = density @ dts * (t[-1] / found.size) ** q
    assert came_to <= 1.05 * equal


@given(LENGTHS, st.floats(-5.0, 5.0), st.floats(0.1, 3.0))
@settings(max_examples=15)
def test_shares_are_what_ramps_differ_from_their_means(dts: Array, rate: float, weight: float) -> None:
    """Half the weighted square of a ramp less its mean, over each step."""
    middles = np.cumsum(dts) - dts / 2.0
    shares = control_shares(rate * middles[:, None], dts, np.array([weight]))
    nodes, weights = np.polynomial.legendre.leggauss(4)
    inside = dts[:, None] / 2.0 * nodes
    expected = 0.5 * weight * ((rate * inside) ** 2 * weights).sum(axis=1) * dts / 2.0
    np.testing.assert_allclose(shares, expected, rtol=1e-9, atol=1e-15)


def test_a_single_step_has_no_ramp() -> None:
    assert control_shares(np.ones((1, 2)), np.ones(1), np.ones(2)).tolist() == [0.0]

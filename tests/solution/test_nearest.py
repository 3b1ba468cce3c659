"""Motions that keep limits from a state in motion: nearest ones, and the programmes that find them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import ruckig
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from mbocp._arrays import Array
from mbocp.solution.curves import Curves
from mbocp.solution.nearest import KINDS, Ends, Nearest
from mbocp.solution.problem_facts import BrakingPlace
from mbocp.solution.quadratic import Chains, Rows

SPEED, ACCELERATION, JERK = 2.0, 8.0, 60.0
BOUNDS = {
    kind: np.array([[-x], [x]]) for kind, x in zip(KINDS, (9.0, SPEED, ACCELERATION, JERK), strict=True)
}


def least_time(v: float, a: float) -> float:
    """Of a stop, by Ruckig [s]."""
    planner, given_, found = ruckig.Ruckig(1), ruckig.InputParameter(1), ruckig.Trajectory(1)
    given_.control_interface = ruckig.ControlInterface.Velocity
    given_.current_velocity, given_.current_acceleration = [v], [a]
    given_.max_acceleration, given_.max_jerk = [ACCELERATION], [JERK]
    planner.calculate(given_, found)
    return float(found.duration)


def stop(v: float, a: float, duration: float, *, is_asked: bool = False, steps: int = 20) -> Nearest:
    """Beside a motion whose speed falls as a parabola; it leaves all limits of jerk and acceleration."""
    t = np.linspace(0.0, duration, steps + 1)[:, None]
    left = 1.0 - t / duration
    motion = Curves(t[:, 0], v * duration * (1.0 - left**3) / 3.0, v * left**2)
    ends = Ends(np.array([a]), np.array([is_asked]), np.array([True]))
    return Nearest(motion, BOUNDS, ((),), ends)


def curves(nearest: Nearest, *factors: float) -> Curves:
    """Of the first factor at which there are some."""
    found = nearest.fastest(factors)
    assert found is not None
    return found[1]


@settings(max_examples=20)
@given(v=st.floats(0.3, 1.6), a=st.floats(-6.0, 4.0))
def test_a_stop_takes_hardly_longer_than_the_least_time(v: float, a: float) -> None:
    """And begins and ends as it should, within all limits, whatever the motion that it is near to."""
    least = least_time(v, a)
    nearest = stop(v, a, 0.97 * least)
    assert nearest.fastest([1.0]) is None
    found = curves(nearest, *np.linspace(1.0, 1.1, 65))
    assert found.accelerations is not None
    assert found.nodes[-1] == pytest.approx(least, rel=0.02)
    assert found.nodes[-1] >= least * (1.0 - 1e-6)
    assert [found.v[0, 0], found.accelerations[0, 0]] == pytest.approx([v, a], abs=1e-9)
    assert [found.v[-1, 0], found.accelerations[-1, 0]] == pytest.approx([0.0, 0.0], abs=1e-9)
    _, (_, *rates) = found.places(20)
    for values, most in zip(
        rates, (max(SPEED, v + a * abs(a) / 2.0 / JERK), ACCELERATION, JERK), strict=True
    ):
        assert np.abs(values).max() <= most * (1.0 + 1e-7)


def test_samples_go_on_from_those_before() -> None:
    """Their third differences, too, at every rate: a mean from rest would leap there."""
    nearest = stop(1.5, -5.0, 0.45)
    found = curves(nearest, 1.05)
    for rate in (125.0, 250.0, 500.0, 1000.0):
        before = np.arange(-3, 0) / rate
        samples = found.at(np.arange(0.0, found.nodes[-1], 1.0 / rate))[0][:, 0]
        all_ = np.concatenate([1.5 * before - 2.5 * before**2, samples])
        assert np.abs(np.diff(all_, 3)).max() * rate**3 <= JERK * (1.0 + 1e-6)
        assert np.abs(np.diff(all_, 2)).max() * rate**2 <= ACCELERATION * (1.0 + 1e-6)


def test_an_end_that_is_asked_for_is_kept() -> None:
    free, asked = stop(1.2, -2.0, 0.4), stop(1.2, -2.0, 0.4, is_asked=True)
    wanted = free.motion.q[-1, 0]
    ends = [curves(one, 1.1).q[-1, 0] for one in (free, asked)]
    assert abs(ends[0] - wanted) > 1e-6
    assert ends[1] == pytest.approx(wanted, abs=1e-9)


def test_speeds_that_fall_towards_a_limit_are_kept_between_nodes() -> None:
    limit, t = 0.302, np.linspace(0.0, 0.5, 21)[:, None]
    motion = Curves(t[:, 0], 1.2 * (t - t**2), 1.2 * (1.0 - 2.0 * t))
    ends = Ends(np.array([-2.4]), np.array([False]), np.array([True]))
    place = BrakingPlace("j", -np.inf, limit, 3.0, 0.1)
    free, held = (Nearest(motion, BOUNDS, (places,), ends) for places in ((), (place,)))
    over = []
    for one in (free, held):
        found = curves(one, 1.1)
        q, speed = (x[:, 0] for x in found.places(20)[1][:2])
        over.append((speed + place.reserve - np.sqrt(2.0 * place.deceleration * (limit - q))).max())
    assert over[0] > 1e-3
    assert over[1] <= 1e-4


def test_there_is_none_where_it_cannot_stop_in_time() -> None:
    assert stop(1.5, 0.0, 0.5 * least_time(1.5, 0.0)).fastest([1.0, 1.05, 1.1]) is None


def chains(seed: int, most: float) -> Chains:
    """Two of three, with a row each and random limits about a motion that keeps them."""
    rng = np.random.default_rng(seed)
    leads = np.triu(rng.uniform(0.2, 1.0, (2, 3, 4)))
    inside = rng.uniform(-0.3, 0.3, (2, 3, 4))
    for n in range(2):
        inside[:, n + 1, :3] = np.einsum("kij,kj->ki", leads, inside[:, n])
    given = np.full((2, 3, 4), np.nan)
    given[:, 0, :2] = inside[:, 0, :2]
    entries = rng.normal(size=(2, 4))
    rows = Rows(np.array([1, 5]), entries, (entries * inside.reshape(-1, 4)[[1, 5]]).sum(axis=1) + most)
    sides = inside + np.array([-1.0, 1.0])[:, None, None, None] * rng.uniform(0.05, 1.0, (2, 2, 3, 4))
    return Chains(leads, rng.uniform(0.1, 2.0, (2, 3, 4)), rng.normal(size=(2, 3, 4)), sides, given, rows)


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000))
def test_programmes_have_the_minimum_of_another_method(seed: int) -> None:
    both = chains(seed, 0.02)
    found, is_found = both.minimise()
    assert is_found.all()
    for k in range(2):
        w, g, (lower, upper) = (
            both.weights[k].ravel(),
            both.linear[k].ravel(),
            both.sides[:, k].reshape(2, -1),
        )
        A, given_ = both.leads[k], both.given[k].ravel()
        row, most = both.rows.entries[k], both.rows.most[k]
        at = slice(4 * (both.rows.at[k] - 3 * k), None)
        is_given = ~np.isnan(given_)

        def cost(x: Array, w: Array = w, g: Array = g) -> float:
            return float(w @ x**2 / 2.0 + g @ x)

        def apart(x: Array, A: Array = A, given_: Array = given_[is_given], k: Array = is_given) -> Array:
            x_n = x.reshape(3, 4)
            return np.concatenate([(x_n[:-1] @ A.T - x_n[1:, :3]).ravel(), x[k] - given_])

        def room(x: Array, row: Array = row, most: float = most, at: slice = at) -> float:
            return float(most - row @ x[at][:4])

        limits = [{"type": "eq", "fun": apart}, {"type": "ineq", "fun": room}]
        bounds = list(zip(lower, upper, strict=True))
        options = {"ftol": 1e-13, "maxiter": 500}
        other = minimize(cost, np.zeros(12), constraints=limits, bounds=bounds, options=options)
        x = found[k].ravel()
        np.testing.assert_allclose(apart(x), 0.0, atol=1e-9)
        assert room(x) >= -1e-9
        assert (x >= lower - 1e-9).all()
        assert (x <= upper + 1e-9).all()
        assert cost(x) == pytest.approx(other.fun, abs=1e-7)


def test_programmes_without_a_solution_have_none() -> None:
    """Beside one that has; a row asks for more than limits of its entries let it."""
    both = chains(0, 0.02)
    least = -np.abs(both.rows.entries[1]) @ np.abs(both.sides).max(axis=0).reshape(-1, 4)[5]
    rows = Rows(both.rows.at, both.rows.entries, np.array([both.rows.most[0], 1.1 * least]))
    assert replace(both, rows=rows).minimise()[1].tolist() == [True, False]

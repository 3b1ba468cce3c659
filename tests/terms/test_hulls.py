"""Smooth distances from hulls against coal, and their derivatives against differences."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbocp.robot.collision.hull import Hull, hull_of
from mbocp.robot.collision.planes import Planes, planes_around
from mbocp.terms.distances import HullCore, hull_measure, plane_slots
from tests.robot.collision.test_hull import clouds, distance

SMOOTHING, REACH = 2e-3, 0.08


def called(function: ca.Function, p: np.ndarray, numbers: np.ndarray) -> list[np.ndarray]:
    """Distance, gradient and curvature."""
    return [x.full() for x in function.call([p, numbers])]


def measured(seed: int, count: int) -> tuple[Hull, Planes, ca.Function, np.ndarray]:
    """A hull, its planes, the function of rows and its numbers."""
    hull = hull_of(clouds(seed, count))
    planes = planes_around(hull, REACH, 0.05 * REACH, 64)
    core = HullCore.of(planes.normals, planes.offsets, planes.slope, SMOOTHING)
    return hull, planes, hull_measure(64), np.concatenate([[core.sharpness], core.fill(64)])


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), count=st.integers(4, 60))
def test_distances_are_those_of_coal(seed: int, count: int) -> None:
    """Larger by the smoothing at most, and too small by the error of the planes."""
    hull, planes, function, numbers = measured(seed, count)
    rng = np.random.default_rng(seed)
    for p in hull.vertices[rng.integers(len(hull.vertices), size=100)] + 0.06 * rng.normal(size=(100, 3)):
        found, true = float(called(function, p - hull.middle, numbers)[0][0, 0]), distance(hull, p)
        assert found <= true + SMOOTHING + 1e-6
        if found < REACH:
            assert found >= true - planes.error - 1e-6


def test_next_to_a_side_it_is_the_distance() -> None:
    cube = hull_of(np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float))
    planes = planes_around(cube, REACH, 0.004, 64)
    core = HullCore.of(planes.normals, planes.offsets, planes.slope, SMOOTHING)
    numbers, function = np.concatenate([[core.sharpness], core.fill(64)]), hull_measure(64)
    for height in (0.05, -0.05, 0.3):
        found = called(function, np.array([0.1, -0.1, 0.5 + height]), numbers)[0]
        assert found[0, 0] == pytest.approx(height, abs=1e-9)


@settings(max_examples=10)
@given(seed=st.integers(0, 10_000), count=st.integers(4, 60))
def test_derivatives_are_those_of_differences(seed: int, count: int) -> None:
    hull, _, function, numbers = measured(seed, count)
    rng, step = np.random.default_rng(seed), 1e-6
    for p in hull.vertices[rng.integers(len(hull.vertices), size=10)] + 0.05 * rng.normal(size=(10, 3)):
        at = p - hull.middle
        _, gradient, curvature = called(function, at, numbers)
        sides = [[called(function, at + s * step * e, numbers) for s in (1, -1)] for e in np.eye(3)]
        ahead = [(a[0] - b[0])[0, 0] / (2 * step) for a, b in sides]
        np.testing.assert_allclose(gradient.ravel(), ahead, atol=1e-6)
        bends = [np.ravel(a[1] - b[1]) / (2 * step) for a, b in sides]
        np.testing.assert_allclose(curvature, bends, atol=1e-3 * max(1.0, np.abs(curvature).max()))
        assert np.linalg.eigvalsh(curvature).min() > -1e-9 * max(1.0, np.abs(curvature).max())  # convex


def test_gradients_are_about_one_long_outside() -> None:
    hull, _, function, numbers = measured(5, 20)
    rng, lengths = np.random.default_rng(5), []
    for p in hull.vertices[rng.integers(len(hull.vertices), size=200)] + 0.1 * rng.normal(size=(200, 3)):
        if distance(hull, p) > 0.01:
            lengths.append(np.linalg.norm(called(function, p - hull.middle, numbers)[1]))
    assert min(lengths) > 0.9
    assert max(lengths) <= 1.0 + 1e-12


def test_far_and_deep_points_are_numbers() -> None:
    hull, _, function, numbers = measured(3, 20)
    for p in (np.zeros(3), np.full(3, 50.0), np.full(3, 1e3)):
        assert all(np.isfinite(x).all() for x in called(function, p, numbers))
    assert hull.volume > 0.0


@pytest.mark.parametrize(("count", "slots"), [(0, 0), (1, 64), (64, 64), (65, 128), (200, 256)])
def test_few_sizes_are_compiled(count: int, slots: int) -> None:
    assert plane_slots(count) == slots

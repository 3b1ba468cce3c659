"""Smooth signed distances against coal, and their derivatives against differences."""

from __future__ import annotations

import casadi as ca
import coal
import numpy as np
import pytest

from mbocp.robot.collision.obstacle import SIZES, Obstacle
from mbocp.terms.distances import core_of, distance_from_core, level_off

LENGTHS = {
    "sphere": [0.2],
    "capsule": [0.1, 0.5],
    "box": [0.3, 0.5, 0.2],
    "cylinder": [0.15, 0.4],
    "halfspace": [],
}
SMOOTHING = 2e-3


def function(shape: str) -> ca.Function:
    p = ca.SX.sym("p", 3)
    core = core_of(shape, LENGTHS[shape], SMOOTHING)
    middle = ca.DM([0.0, 0.0, core.middle])
    d = distance_from_core(p - middle, ca.SX(ca.DM(core.numbers))) - core.radius
    hessian, gradient = ca.hessian(d, p)
    return ca.Function("d", [p], [d, gradient, hessian])


def expected(shape: str, p: np.ndarray) -> float:
    """By coal, which is wrong inside cylinders: there the way to the nearest side."""
    if shape == "cylinder":
        radius, length = LENGTHS[shape]
        inside = max(np.hypot(p[0], p[1]) - radius, abs(p[2]) - length / 2)
        return inside if inside < 0.0 else by_coal(shape, p)
    return by_coal(shape, p)


def by_coal(shape: str, p: np.ndarray) -> float:
    geometry = Obstacle(name="it", shape=shape, sizes=np.array(LENGTHS[shape])).geometry
    there = coal.Transform3s(np.eye(3), p)
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return coal.distance(geometry, coal.Transform3s(), coal.Sphere(1e-6), there, request, result) + 1e-6


def points(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 3))


def test_all_shapes_are_tested():
    assert set(LENGTHS) == set(SIZES)


@pytest.mark.parametrize("shape", SIZES)
def test_distances_are_those_of_coal(shape):
    """Outside and inside, to less than the smoothing."""
    d = function(shape)
    errors, signs = [], set()
    for p in points(400, 1):
        true = expected(shape, p)
        errors.append(float(d(p)[0]) - true)
        signs.add(true > 0.0)
    assert signs == {True, False}
    assert np.abs(errors).max() < SMOOTHING
    assert np.median(np.abs(errors)) < 0.05 * SMOOTHING


@pytest.mark.parametrize("shape", SIZES)
def test_derivatives_are_those_of_differences(shape):
    d, h = function(shape), 1e-6
    for p in points(30, 2):
        value, gradient, hessian = (np.array(x) for x in d(p))
        ahead = [np.array(d(p + h * e)[0]) - np.array(d(p - h * e)[0]) for e in np.eye(3)]
        np.testing.assert_allclose(gradient.ravel(), np.ravel(ahead) / (2 * h), atol=1e-6)
        slopes = [(np.array(d(p + h * e)[1]) - np.array(d(p - h * e)[1])).ravel() for e in np.eye(3)]
        np.testing.assert_allclose(
            hessian, np.array(slopes) / (2 * h), atol=1e-4 * max(1.0, abs(hessian).max())
        )
        assert np.isfinite(value).all()


@pytest.mark.parametrize("shape", SIZES)
def test_gradients_push_out_and_are_about_one_long(shape):
    """Also inside, but for the planes in the middle, where the nearest side changes."""
    d, lengths = function(shape), []
    for p in points(400, 3):
        gradient = np.array(d(p)[1]).ravel()
        lengths.append(np.linalg.norm(gradient))
        further = float(d(p + 0.02 * gradient)[0]) - float(d(p)[0])
        assert further > 0.0
    assert np.quantile(lengths, 0.05) > 0.9
    assert max(lengths) < 1.02


@pytest.mark.parametrize("shape", SIZES)
def test_distances_are_smooth_in_the_middle(shape):
    assert all(np.isfinite(np.array(x)).all() for x in function(shape)(np.zeros(3)))


def leveled(distances: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """What rows are of some distances, shape (n,) [m]."""
    d, least = ca.SX.sym("d"), ca.SX.sym("kept")
    level = ca.Function("level", [d, least], [level_off(least, d, ca.SX(1), ca.SX(0))[0]])
    return np.array(level(distances, kept)).ravel()


def test_large_distances_level_off():
    """They stay as they are up to 10 cm beyond what is kept, and are constant from 18 cm on, smoothly."""
    near, far = np.linspace(-0.5, 0.3, 9), np.linspace(0.38, 5.0, 9)
    np.testing.assert_allclose(leveled(near, np.full(9, 0.2)), near, atol=1e-15)
    np.testing.assert_allclose(leveled(far, np.full(9, 0.2)), 0.34, atol=1e-15)
    np.testing.assert_allclose(leveled(np.array([2.2, 3.0]), np.full(2, 2.0)), [2.2, 2.28], atol=1e-15)
    d = ca.SX.sym("d")
    row = ca.Function("row", [d], [*level_off(ca.SX(0.2), d, ca.SX(1), ca.SX(0))])
    for at in (0.1, 0.3, 0.33, 0.39, 0.5):
        ahead, behind = (np.array(row(at + step)).ravel() for step in (1e-6, -1e-6))
        _, slope, curvature, is_near = np.array(row(at)).ravel()
        np.testing.assert_allclose((ahead - behind)[:2] / 2e-6, [slope, curvature], atol=1e-3)
        assert is_near == (at < 0.38)
        assert is_near or slope == curvature == 0.0


def test_points_that_meet():
    """As two spheres whose centres coincide."""
    p = ca.SX.sym("p", 3)
    d = distance_from_core(p, ca.SX(ca.DM(core_of("sphere", [0.0], 1e-3).numbers)))
    f = ca.Function("d", [p], [d, ca.hessian(d, p)[0]])
    assert float(f([0.3, -0.4, 0.0])[0]) == pytest.approx(0.5, abs=1e-5)
    assert np.isfinite(np.array(f(np.zeros(3))[1])).all()

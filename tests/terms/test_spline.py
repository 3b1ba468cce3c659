"""Curves through points: where they go, how smooth they are, and the nearest point of a motion."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbocp.terms.spline import Curve, curve_through, symbolic_curve

RNG = np.random.default_rng(4)
POINTS = np.cumsum(RNG.standard_normal((7, 3)), axis=0)


def circle(count: int, radius: float = 2.0) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    return radius * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])


@pytest.mark.parametrize("is_closed", [False, True])
@pytest.mark.parametrize("count", [2, 3, 4, 7])
def test_it_goes_through_its_points_with_continuous_curvature(count: int, is_closed: bool) -> None:
    if is_closed and count == 2:
        return
    curve = curve_through(POINTS[:count], is_closed=is_closed)
    points = np.vstack([POINTS[:count], POINTS[:1]]) if is_closed else POINTS[:count]
    assert curve.at(curve.knots) == pytest.approx(points, abs=1e-12)
    inner = curve.knots[1:-1]
    for derivative in range(3):
        left, right = (curve.at(inner + side, derivative) for side in (-1e-12, 1e-12))
        assert left == pytest.approx(right, abs=1e-6)
    if is_closed:
        for derivative in range(3):
            first, last = curve.at(np.array([0.0, 1.0]), derivative)
            assert first == pytest.approx(last, abs=1e-9)


def test_a_circle_is_met_to_fourth_order() -> None:
    errors = []
    for count in (8, 16, 32):
        found = curve_through(circle(count), is_closed=True).at(np.linspace(0, 1, 501))
        errors.append(np.abs(np.linalg.norm(found, axis=1) - 2.0).max())
    slopes = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert slopes == pytest.approx(4.0, abs=0.3)


def test_symbols_say_the_same_as_numbers_and_scipy() -> None:
    from scipy.interpolate import CubicSpline

    curve = curve_through(POINTS, is_closed=False)
    s = ca.SX.sym("s")
    knots, pieces = ca.SX(ca.DM(curve.knots)), ca.SX(ca.DM(curve.pieces.ravel()))
    point, slope = symbolic_curve(s, knots, pieces, 3)
    function = ca.Function("c", [s], [point, slope, ca.jacobian(point, s), ca.jacobian(slope, s)])
    reference = CubicSpline(curve.knots, POINTS)
    for at in (-0.1, 0.0, 0.123, curve.knots[2], 0.77, 1.0, 1.1):
        found = [np.asarray(ca.DM(out)).ravel() for out in function(at)]
        expected = [reference(at), reference(at, 1), reference(at, 1), reference(at, 2)]
        for mine, other in zip(found, expected, strict=True):
            assert mine == pytest.approx(other, abs=1e-9)


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=30), st.booleans())
def test_points_of_the_curve_are_nearest_to_themselves(shares: list[float], is_closed: bool) -> None:
    curve = curve_through(circle(9), is_closed=is_closed)
    s = np.sort(np.append(shares, 0.5))
    found = curve.nearest(curve.at(s))
    assert curve.at(found) == pytest.approx(curve.at(s), abs=1e-7)
    assert (np.diff(found) >= 0.0).all()


def test_where_a_path_crosses_itself_the_order_of_the_motion_tells() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)
    eight = np.column_stack([np.sin(angle), np.sin(2 * angle), 0 * angle])
    curve = curve_through(eight, is_closed=True)
    s = np.linspace(0.0, 1.0, 41)
    assert curve.nearest(curve.at(s)) == pytest.approx(s, abs=1e-7)


def test_beside_the_curve_the_distance_is_least() -> None:
    curve = curve_through(POINTS, is_closed=False)
    positions = curve.at(np.linspace(0.0, 1.0, 23)) + 0.05 * RNG.standard_normal((23, 3))
    found = curve.nearest(positions)
    away, slope = positions - curve.at(found), curve.at(found, 1)
    inner = (found > 0.0) & (found < 1.0) & np.append(True, np.diff(found) > 0.0)
    assert np.abs((away * slope).sum(axis=1)[inner]).max() < 1e-6
    assert inner.sum() > 15


def test_the_points_come_back() -> None:
    """Also where the curvature at the ends is zero, as at the crossing of an eight."""
    eight = np.array([[0, 0, 0], [4, 10, 0], [12, 12, 0], [10, 4, 0]], dtype=float)
    for points in (POINTS, np.vstack([eight, -eight])):
        assert curve_through(points, is_closed=True).is_closed
        assert not curve_through(points, is_closed=False).is_closed
    curve = curve_through(POINTS, is_closed=True)
    assert isinstance(curve, Curve)
    assert curve.points[:-1] == pytest.approx(POINTS, abs=1e-12)

"""What triangles enclose, against bodies with formulas, coal, and samples of the inside."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from mbocp.meshes.mesh_parts import count_open_edges, fill, measure_enclosed_body, scale_mass, weld
from mbocp.robot.collision.hull import hull_of

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)


def box(size: tuple[float, float, float]) -> tuple[np.ndarray, NDArray[np.int64]]:
    hull = hull_of((CUBE - 0.5) * size)
    return np.array(hull.vertices), hull.faces


def ball(rings: int) -> tuple[np.ndarray, NDArray[np.int64]]:
    """Corners of a sphere of radius 1 between its poles, and what is spanned between them."""
    along, around = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), 2 * np.pi * np.arange(2 * rings) / (2 * rings)
    )
    x, y, z = np.sin(along) * np.cos(around), np.sin(along) * np.sin(around), np.cos(along)
    hull = hull_of(np.unique(np.round(np.stack([x, y, z], axis=-1).reshape(-1, 3), 12), axis=0), 10**5)
    return np.array(hull.vertices), hull.faces


def assert_same(body: pin.Inertia, other: pin.Inertia, rtol: float = 1e-12) -> None:
    size = other.mass ** (1 / 3)
    np.testing.assert_allclose(body.mass, other.mass, rtol=rtol)
    np.testing.assert_allclose(body.lever, other.lever, atol=rtol * size)
    np.testing.assert_allclose(body.inertia, other.inertia, atol=rtol * other.mass * size**2)


@pytest.mark.parametrize("far", [0.0, 50.0])
@pytest.mark.parametrize("inwards", [False, True])
def test_a_box_of_triangles_is_a_box(far: float, inwards: bool) -> None:
    size = (0.3, 0.2, 0.7)
    there = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 1.1), np.array([0.4, -0.1, 0.2 + far]))
    vertices, faces = box(size)
    vertices = vertices @ there.rotation.T + there.translation
    expected = there.act(pin.Inertia.FromBox(float(np.prod(size)), *size))
    assert_same(measure_enclosed_body(vertices, faces[:, ::-1] if inwards else faces), expected, 1e-11)


def test_finer_balls_come_near_the_sphere_with_order_two() -> None:
    exact = pin.Inertia.FromSphere(4 / 3 * np.pi, 1.0)
    errors = []
    for rings in (16, 32):
        body = measure_enclosed_body(*ball(rings))
        np.testing.assert_allclose(body.lever, 0, atol=1e-12)
        errors.append([exact.mass - body.mass, *(np.diag(exact.inertia) - np.diag(body.inertia))])
    np.testing.assert_allclose(np.log2(np.divide(*errors)), 2.0, atol=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_coal_and_samples_of_the_inside_agree(seed: int) -> None:
    """Coal integrates over the same triangles by other formulas, samples know none of them."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(30, 3)) * [0.3, 0.1, 0.2] + rng.normal(size=3)
    hull = hull_of(points)
    body = measure_enclosed_body(np.array(hull.vertices), hull.faces)
    moments = hull.shape.computeMomentofInertiaRelatedToCOM()
    assert_same(body, pin.Inertia(hull.shape.computeVolume(), hull.shape.computeCOM(), moments), 1e-10)
    low, high = points.min(axis=0), points.max(axis=0)
    cloud = rng.uniform(low, high, (200_000, 3))
    planes = ConvexHull(points).equations
    inside = cloud[(cloud @ planes[:, :3].T + planes[:, 3] <= 0).all(axis=1)]
    away = inside - inside.mean(axis=0)
    volume = float(np.prod(high - low)) * len(inside) / len(cloud)
    second = volume * away.T @ away / len(inside)
    sampled = pin.Inertia(volume, inside.mean(axis=0), np.trace(second) * np.eye(3) - second)
    assert_same(body, sampled, 0.03)


def test_a_hollow_is_taken_out() -> None:
    outer, faces = box((1.0, 1.0, 1.0))
    inner, holes = box((0.5, 0.5, 0.5))
    body = measure_enclosed_body(np.vstack([outer, inner]), np.vstack([faces, holes[:, ::-1] + len(outer)]))
    expected = (1 - 0.5**5) / 6 * np.eye(3)
    assert_same(body, pin.Inertia(1 - 0.5**3, np.zeros(3), expected))


def test_edges_of_a_surface_with_a_gap_are_counted() -> None:
    vertices, faces = box((1.0, 2.0, 3.0))
    soup, numbers = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
    assert count_open_edges(numbers) == 3 * len(faces)  # as STL files have them
    corners, welded = weld(soup, numbers)
    assert (len(corners), count_open_edges(welded)) == (8, 0)
    assert count_open_edges(welded[1:]) == 3
    turned = np.vstack([welded[1:], welded[:1, ::-1]])
    assert count_open_edges(turned) == 3


@pytest.mark.parametrize(
    ("shape", "volume", "expected"),
    [
        (coal.Sphere(0.3), 4 / 3 * np.pi * 0.3**3, pin.Inertia.FromSphere(2.0, 0.3)),
        (coal.Capsule(0.3, 1.4), np.pi * 0.09 * (1.4 + 0.4), pin.Inertia.FromCapsule(2.0, 0.3, 1.4)),
        (coal.Cylinder(0.3, 1.4), np.pi * 0.09 * 1.4, pin.Inertia.FromCylinder(2.0, 0.3, 1.4)),
        (coal.Box(0.1, 0.2, 0.3), 0.006, pin.Inertia.FromBox(2.0, 0.1, 0.2, 0.3)),
        (coal.Ellipsoid(0.1, 0.2, 0.3), 4 / 3 * np.pi * 0.006, pin.Inertia.FromEllipsoid(2.0, 0.1, 0.2, 0.3)),
    ],
)
def test_shapes_are_filled_evenly(
    shape: coal.CollisionGeometry, volume: float, expected: pin.Inertia
) -> None:
    assert fill(shape).mass == pytest.approx(volume)
    assert_same(scale_mass(fill(shape), 2.0), expected)


def test_a_shape_that_is_too_small_for_a_volume_is_a_point() -> None:
    body = scale_mass(fill(coal.Sphere(1e-120)), 2.0)
    assert body.mass == 2.0
    np.testing.assert_array_equal(body.inertia, 0.0)

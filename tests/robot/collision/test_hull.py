"""Convex hulls of points and files, and planes that tell the distance from them."""

from __future__ import annotations

from pathlib import Path

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from mbocp.exceptions import InvalidValue
from mbocp.robot.collision.hull import MAX_CORNERS, Hull, hull_of
from mbocp.robot.collision.mesh_file import body_of_file
from mbocp.robot.collision.planes import planes_around

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
ONE = np.ones(3)


def clouds(seed: int, count: int) -> np.ndarray:
    """Points that are longer in one direction than in others."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 3)) * rng.uniform(0.03, 0.2, 3) + rng.normal(size=3)


def distance(hull: Hull, p: np.ndarray) -> float:
    """By coal [m]; less the depth within."""
    there, request, result = coal.Transform3s(np.eye(3), p), coal.DistanceRequest(), coal.DistanceResult()
    return coal.distance(hull.shape, coal.Transform3s(), coal.Sphere(1e-6), there, request, result) + 1e-6


def obj(path: Path, hull: Hull, faces: np.ndarray | None = None) -> Path:
    triangles = hull.faces if faces is None else faces
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in hull.vertices.tolist()]
    path.write_text("\n".join([*lines, *(f"f {a} {b} {c}" for a, b, c in (triangles + 1).tolist())]))
    return path


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), count=st.integers(4, 60), room=st.sampled_from([64, 128]))
def test_planes_tell_the_distance_to_the_stated_error(seed: int, count: int, room: int) -> None:
    """Never more than it, outside; exactly the depth, inside; the error is that of the worst point."""
    hull, reach = hull_of(clouds(seed, count)), 0.08
    planes = planes_around(hull, reach, 0.05 * reach, room)
    assert len(planes.normals) <= room
    np.testing.assert_allclose(np.linalg.norm(planes.normals, axis=1), 1.0, atol=1e-12)
    rng = np.random.default_rng(seed + 1)
    errors = []
    for p in hull.vertices[rng.integers(len(hull.vertices), size=200)] + rng.normal(size=(200, 3)) * 0.08:
        found, true = (planes.normals @ (p - hull.middle) - planes.offsets).max(), distance(hull, p)
        assert found <= true + 1e-6
        if found < reach:
            errors.append(true - found)
        assert found >= planes.slope * np.linalg.norm(p - hull.middle) - planes.offsets.max() - 1e-9
    assert max(errors) <= planes.error + 1e-6
    faces = ConvexHull(hull.vertices).equations
    for weights in rng.dirichlet(np.ones(len(hull.vertices)), 50):
        p = weights @ hull.vertices
        depth = (planes.normals @ (p - hull.middle) - planes.offsets).max()
        if len(np.unique(hull.normals.round(9), axis=0)) <= room // 2:
            assert depth == pytest.approx((faces @ [*p, 1.0]).max(), abs=1e-6)


def test_more_planes_have_a_smaller_error() -> None:
    hull = hull_of(CUBE)
    errors = [planes_around(hull, 0.1, 0.0, count).error for count in (6, 32, 64, 128, 256)]
    assert errors == sorted(errors, reverse=True)
    assert errors[0] == pytest.approx(0.1 * (3**0.5 - 1), abs=1e-5)
    assert errors[-1] < 0.003
    assert planes_around(hull, 0.05, 0.0, 6).error == pytest.approx(0.05 * (3**0.5 - 1), abs=1e-5)


def test_very_many_faces_become_few_around_them() -> None:
    """No corner is outside of the planes, and how much they add is told."""
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(2000, 3))
    hull = hull_of(0.2 * ball / np.linalg.norm(ball, axis=1)[:, None])
    assert len(hull.faces) > 3000
    planes = planes_around(hull, 0.05, 0.0025, 128)
    assert ((hull.vertices - hull.middle) @ planes.normals.T - planes.offsets).max() <= 1e-12
    assert 0.0025 < planes.error < 0.015


def test_a_hull_is_that_of_its_corners() -> None:
    hull = hull_of(np.vstack([CUBE, 0.5 * CUBE + 0.2]))
    assert len(hull.vertices) == 8
    assert hull.volume == pytest.approx(1.0)
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    outwards = np.cross(b - a, c - a)
    np.testing.assert_allclose(outwards / np.linalg.norm(outwards, axis=1)[:, None], hull.normals, atol=1e-12)
    again = hull_of(hull.vertices)
    assert again == hull
    assert hash(again) == hash(hull)


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (CUBE[:3], "n of 4 or more"),
        (CUBE[:4], "points of one plane"),
        (np.zeros((9, 3)), "points of one plane"),
        (np.vstack([CUBE, [[np.nan, 0, 0]]]), "not, expected finite"),
        (CUBE * 1e7, "not, expected finite"),
        (CUBE[:, :2], r"shape \(8, 2\)"),
    ],
)
def test_what_is_no_body_is_refused(points: np.ndarray, reason: str) -> None:
    with pytest.raises(InvalidValue, match=reason):
        hull_of(points)


def test_too_many_corners_are_refused() -> None:
    ball = np.random.default_rng(0).normal(size=(MAX_CORNERS + 10, 3))
    with pytest.raises(InvalidValue, match="fewer triangles"):
        hull_of(ball / np.linalg.norm(ball, axis=1)[:, None])


def test_files_are_read_with_their_scale(tmp_path: Path) -> None:
    hull = hull_of(1000 * clouds(1, 30))
    path = obj(tmp_path / "stone.obj", hull)
    found, excess = body_of_file(path, 1e-3 * ONE, takes_hull=False)
    np.testing.assert_allclose(found.vertices, 1e-3 * hull.vertices, atol=1e-9)
    assert abs(excess) < 1e-6
    turned, _ = body_of_file(obj(tmp_path / "turned.obj", hull, hull.faces[:, ::-1]), ONE, takes_hull=False)
    assert turned.volume == pytest.approx(hull.volume)


def test_a_hull_may_stand_for_a_file_that_is_not_convex(tmp_path: Path) -> None:
    """A cube with a pyramid cut out of one side: its hull has a sixth of the cube more, by a fifth."""
    hull = hull_of(CUBE)
    top = np.flatnonzero(hull.normals[:, 2] > 0.5)
    at_top = np.flatnonzero(hull.vertices[:, 2] > 0.5)
    corners = np.vstack([hull.vertices, [[0.5, 0.5, 0.5]]])
    order = np.arctan2(*(hull.vertices[at_top, :2] - 0.5).T[::-1]).argsort()
    ring = at_top[order]
    notch = [[ring[k], ring[(k + 1) % 4], 8] for k in range(4)]
    faces = np.vstack([np.delete(hull.faces, top, axis=0), notch])
    path = obj(tmp_path / "notch.obj", Hull(corners, faces, hull.normals, 1.0))
    found, excess = body_of_file(path, ONE, takes_hull=True)
    assert found.volume == pytest.approx(1.0)
    assert excess == pytest.approx(0.2)


def test_files_that_are_not_closed_are_refused(tmp_path: Path) -> None:
    hull = hull_of(CUBE)
    path = obj(tmp_path / "open.obj", hull, hull.faces[1:])
    with pytest.raises(InvalidValue, match="not closed: 3 edges"):
        body_of_file(path, ONE, takes_hull=False)
    assert np.isnan(body_of_file(path, ONE, takes_hull=True)[1])
    mixed = hull.faces.copy()
    mixed[0] = mixed[0, ::-1]
    with pytest.raises(InvalidValue, match="facing outwards"):
        body_of_file(obj(tmp_path / "mixed.obj", hull, mixed), ONE, takes_hull=False)


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidValue, match=r"none\.stl.*no such file"):
        body_of_file(tmp_path / "none.stl", ONE, takes_hull=False)
    (tmp_path / "broken.stl").write_text("solid nothing")
    with pytest.raises(InvalidValue, match="cannot be read"):
        body_of_file(tmp_path / "broken.stl", ONE, takes_hull=False)
    (tmp_path / "nan.obj").write_text("v nan 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 2 3 4\n")
    with pytest.raises(InvalidValue, match=r"nan\.obj"):
        body_of_file(tmp_path / "nan.obj", ONE, takes_hull=False)

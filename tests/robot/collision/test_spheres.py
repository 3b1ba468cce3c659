"""Collision geometry and the spheres that cover it."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from mbocp.exceptions import RobotFileError, UnknownFrame
from mbocp.robot import Payload, load_parts, load_robot
from mbocp.robot.collision import spheres
from mbocp.robot.collision.solid import Solid
from tests.robot.urdfs import joint, link, robot, write

BOX = '<box size="0.6 0.1 0.05"/>'
CYLINDER = '<cylinder radius="0.06" length="0.5"/>'
CAPSULE = '<capsule radius="0.05" length="0.4"/>'
SPHERE = '<sphere radius="0.07"/>'


def collision(shape: str, xyz: str = "0.1 0.2 0.3", rpy: str = "0.3 -0.2 0.5") -> str:
    origin = f'<origin xyz="{xyz}" rpy="{rpy}"/>'
    return f"<collision>{origin}<geometry>{shape}</geometry></collision>"


def arm(*shapes: str, toml: str | None = None, folder):
    urdf = robot(
        link("base"), link("l1", extra="".join(map(collision, shapes))), joint("j1", "revolute", "base", "l1")
    )
    return load_robot(write(folder, urdf, toml))


def surface_of_box(half, count, rng):
    points = rng.uniform(-1, 1, (count, 3))
    axis = rng.integers(0, 3, count)
    points[np.arange(count), axis] = rng.choice([-1.0, 1.0], count)
    return points * half


def around(radius, half, count, rng):
    angle, height = rng.uniform(0, 2 * np.pi, count), rng.uniform(-half, half, count)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)


@pytest.mark.parametrize(
    ("shape", "points"),
    [
        (BOX, lambda rng: surface_of_box(np.array([0.3, 0.05, 0.025]), 4000, rng)),
        (CYLINDER, lambda rng: around(0.06, 0.25, 4000, rng)),
        (CAPSULE, lambda rng: around(0.05, 0.2, 4000, rng)),
    ],
    ids=["box", "cylinder", "capsule"],
)
def test_fitted_spheres_cover(tmp_path, shape, points):
    """Every point of the surface, chosen at random, is in a sphere, and no sphere is much too large."""
    made = arm(shape, folder=tmp_path)
    (found,) = made.collision_spheres
    placed = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.5), np.array([0.1, 0.2, 0.3]))
    p = points(np.random.default_rng(1)) @ placed.rotation.T + placed.translation
    gaps = (np.linalg.norm(p[:, None] - found.centers, axis=2) - found.radii).min(axis=1)
    assert gaps.max() <= 1e-3  # [m]; the fit has looked at some 10,000 other points
    assert (gaps > 0.0).mean() < 1e-3
    assert found.origin == "fitted"
    assert 2 <= len(found.radii) <= 8
    geometry = made.collision_model.geometryObjects[0]
    away = []
    for center, radius in zip(found.centers, found.radii, strict=True):
        for direction in np.random.default_rng(2).normal(size=(200, 3)):
            at = center + radius * direction / np.linalg.norm(direction)
            at = made.model.frames[found.frame].placement.act(at)
            point = coal.Transform3s(np.eye(3), at)
            here = coal.Transform3s(geometry.placement.rotation, geometry.placement.translation)
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            away.append(coal.distance(geometry.geometry, here, coal.Sphere(1e-9), point, request, result))
    assert max(away) <= found.sticks_out + 0.005
    assert found.sticks_out <= max(away) + 0.02


def test_spheres_are_the_same_every_time(tmp_path):
    one, other = (arm(BOX, CYLINDER, folder=tmp_path).collision_spheres[0] for _ in range(2))
    assert np.array_equal(one.centers, other.centers)
    assert np.array_equal(one.radii, other.radii)


def test_spheres_of_the_urdf_are_taken_as_they_are(tmp_path):
    (found,) = arm(SPHERE, '<sphere radius="0.02"/>', folder=tmp_path).collision_spheres
    assert found.origin == "urdf"
    assert found.radii.tolist() == [0.07, 0.02]
    np.testing.assert_allclose(found.centers, [[0.1, 0.2, 0.3]] * 2)
    assert (found.uncovered, found.gap, found.sticks_out, found.words) == (0.0, 0.0, 0.0, "")


def test_given_spheres_take_the_place_of_shapes(tmp_path):
    toml = 'urdf = "robot.urdf"\n[[collision_sphere]]\nframe = "l1"\ncenter = [0.1, 0.2, 0.3]\nradius = 0.1\n'
    (found,) = arm(CYLINDER, toml=toml, folder=tmp_path).collision_spheres
    assert found.origin == "given"
    assert found.radii.tolist() == [0.1]
    assert 0.3 < found.uncovered < 0.8  # the ends of a cylinder of half a metre
    assert found.words == f"the given spheres leave {100 * found.gap:.2g} cm of {found.link} uncovered"
    assert found.gap == pytest.approx(np.hypot(0.25, 0.06) - 0.1, abs=1e-3)


def test_given_sphere_of_an_unknown_frame(tmp_path):
    toml = 'urdf = "robot.urdf"\n[[collision_sphere]]\nframe = "l2"\nradius = 0.1\n'
    with pytest.raises(UnknownFrame, match=r"collision_sphere\[0\].frame.*l2"):
        arm(CYLINDER, toml=toml, folder=tmp_path)


def obj(vertices, faces) -> str:
    lines = [f"v {x} {y} {z}" for x, y, z in vertices]
    return "\n".join([*lines, *(f"f {' '.join(str(k + 1) for k in face)}" for face in faces)]) + "\n"


def ell() -> str:
    """An L of two cubes of a metre beside each other and one on the first, closed."""
    outline = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    vertices = [(x, y, z) for z in (0, 1) for x, y in outline]
    sides = [(k, (k + 1) % 6, 6 + (k + 1) % 6, 6 + k) for k in range(6)]
    bottom = [(0, 2, 1), (0, 3, 2), (0, 4, 3), (0, 5, 4)]
    return obj(vertices, [*sides, *bottom, *(tuple(6 + k for k in reversed(face)) for face in bottom)])


def test_a_mesh_is_not_filled_beyond_itself(tmp_path):
    """The notch of an L is outside: its spheres do not cover the hull."""
    (tmp_path / "l.obj").write_text(ell())
    made = arm('<mesh filename="l.obj"/>', folder=tmp_path)
    solid = Solid.of(list(made.collision_model.geometryObjects))
    assert solid.filled.sum() * solid.cell**3 == pytest.approx(3.0, rel=0.1)
    placed = made.collision_model.geometryObjects[0].placement
    inside, notch = placed.act(np.array([0.5, 1.5, 0.5])), placed.act(np.array([1.6, 1.6, 0.5]))
    distances = solid.outside(np.array([inside, notch]))
    assert distances[0] == 0.0
    assert distances[1] == pytest.approx(0.6, abs=0.05)
    (found,) = made.collision_spheres
    assert found.uncovered < 1e-3


def test_a_hole_in_a_mesh_does_not_empty_it(tmp_path):
    """Rays along other axes do not see a missing face."""
    (tmp_path / "l.obj").write_text("\n".join(ell().splitlines()[:-1]) + "\n")
    made = arm('<mesh filename="l.obj"/>', folder=tmp_path)
    solid = Solid.of(list(made.collision_model.geometryObjects))
    assert solid.filled.sum() * solid.cell**3 > 2.0


@pytest.mark.parametrize(
    ("content", "reason"),
    [(None, "missing"), ("v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"), ("v 0 0 0\n", "no faces")],
)
def test_broken_meshes_are_refused(tmp_path, content, reason):
    if content is not None:
        (tmp_path / "l.obj").write_text(content)
    made = arm('<mesh filename="l.obj"/>', folder=tmp_path)
    with pytest.raises(RobotFileError, match=reason):
        _ = made.collision_spheres


def test_a_shape_without_size_is_refused(tmp_path):
    with pytest.raises(RobotFileError, match="collision 0 of link 'l1': a length of 0 m"):
        _ = arm('<box size="1 0 1"/>', folder=tmp_path).collision_model


def test_spheres_follow_their_link_through_locks_payloads_and_worlds(tmp_path):
    """Where a sphere is depends on the pose, not on how the robot was put together."""
    urdf = robot(
        link("base"),
        link("l1"),
        link("l2", extra=collision(SPHERE)),
        joint("j1", "revolute", "base", "l1"),
        joint("j2", "revolute", "l1", "l2"),
    )
    path = write(tmp_path, urdf)

    def place(made, q):
        (found,) = [s for s in made.collision_spheres if s.link.endswith("l2")]
        return made.frame_placement(found.link, q).act(np.array(found.centers[0]))

    plain = load_robot(path)
    expected = place(plain, [0.3, 0.7])
    locked = load_robot(path, lock={"j2": 0.7})
    np.testing.assert_allclose(place(locked, [0.3]), expected, atol=1e-12)
    parts = [{"robot": str(path), "name": "a"}, {"robot": str(path), "name": "b", "position": [1, 0, 0]}]
    world = load_parts(parts)
    assert [s.link for s in world.collision_spheres] == ["a/l2", "b/l2"]
    b = world.collision_spheres[1]
    there = world.frame_placement("b/l2", [0.0, 0.0, 0.3, 0.7]).act(np.array(b.centers[0]))
    np.testing.assert_allclose(there, expected + np.array([1.0, 0.0, 0.0]), atol=1e-12)
    carrying = plain.with_payload(Payload(frame="l2", mass=1.0, sphere=0.2, name="ball"))
    radii = [(s.link, s.radii.tolist()) for s in carrying.collision_spheres]
    assert radii == [("l2", [0.07]), ("ball", [0.2])]


def test_nothing_collides_without_shapes(tmp_path):
    assert arm(folder=tmp_path).collision_spheres == ()


def test_fits_are_kept_for_other_processes(tmp_path, monkeypatch):
    """The same shapes are not fitted again, whatever robot has them; damaged files are not believed."""
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "cache"))
    calls = []
    fit = spheres._fit
    monkeypatch.setattr(spheres, "_fit", lambda *given: calls.append(1) or fit(*given))
    (first,) = arm(BOX, folder=tmp_path).collision_spheres
    (again,) = arm(BOX, folder=tmp_path).collision_spheres
    assert len(calls) == 1
    for name in ("centers", "radii", "origin", "sticks_out", "uncovered", "gap"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    arm(BOX.replace("0.05", "0.06"), folder=tmp_path).collision_spheres  # noqa: B018
    assert len(calls) == 2
    files = sorted((tmp_path / "cache" / "stages").glob("*.fit"))
    assert len(files) == 2
    for file in files:
        file.write_bytes(file.read_bytes()[:-1] + b"x")
    (third,) = arm(BOX, folder=tmp_path).collision_spheres
    assert len(calls) == 3
    np.testing.assert_array_equal(first.radii, third.radii)


def test_fits_need_no_folder(tmp_path, monkeypatch):
    (tmp_path / "cache").write_text("not a folder")
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "cache"))
    with pytest.warns(RuntimeWarning, match="is not used"):
        (found,) = arm(CAPSULE, folder=tmp_path).collision_spheres
    assert found.origin == "fitted"

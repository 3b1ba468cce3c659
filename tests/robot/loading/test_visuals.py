"""What is shown: shapes, colours, meshes that are there, and a word about those that are not."""

from __future__ import annotations

import warnings
from pathlib import Path

import coal
import numpy as np
import pytest

from mbocp.exceptions import RobotFileError
from mbocp.robot import MissingMeshWarning, load_robot
from tests.robot import urdfs


def visual(shape: str, extra: str = "") -> str:
    return f'<visual><origin xyz="0 0 0.5" rpy="0 0 1"/><geometry>{shape}</geometry>{extra}</visual>'


def urdf(*visuals: str, material: str = "") -> str:
    return urdfs.robot(
        material,
        urdfs.link("base"),
        urdfs.link("tip", extra="".join(visuals)),
        urdfs.joint("j", "revolute", "base", "tip"),
    )


def test_shapes(tmp_path: Path) -> None:
    red = '<material name="red"><color rgba="1 0 0 0.5"/></material>'
    shapes = [
        visual('<box size="1 2 3"/>', '<material name="red"/>'),
        visual('<sphere radius="0.5"/>', '<material name=""><color rgba="0 1 0 1"/></material>'),
        visual('<cylinder radius="0.1" length="2"/>'),
        visual('<capsule radius="0.1" length="2"/>'),
        "<visual><geometry/></visual>",
    ]
    found = load_robot(urdfs.write(tmp_path, urdf(*shapes, material=red))).visual_model.geometryObjects
    assert [type(g.geometry) for g in found] == [coal.Box, coal.Sphere, coal.Cylinder, coal.Capsule]
    assert [g.name for g in found] == ["tip_0", "tip_1", "tip_2", "tip_3"]
    assert all(g.parentJoint == 1 and g.meshPath == "" for g in found)
    np.testing.assert_allclose(found[0].placement.translation, [0, 0, 0.5])
    np.testing.assert_allclose(found[0].geometry.halfSide, [0.5, 1, 1.5])
    np.testing.assert_allclose(found[0].meshColor, [1, 0, 0, 0.5])
    np.testing.assert_allclose(found[1].meshColor, [0, 1, 0, 1])
    assert [bool(g.overrideMaterial) for g in found] == [True, True, False, False]


def test_meshes_by_every_kind_of_address(tmp_path: Path) -> None:
    package = tmp_path / "ws" / "my_robot"
    mesh = package / "meshes" / "tip.stl"
    mesh.parent.mkdir(parents=True)
    mesh.write_bytes(b"not read when the robot is loaded")
    addresses = [f"{scheme}my_robot/meshes/tip.stl" for scheme in ("package://", "model://")]
    addresses += [f"file://{mesh}", str(mesh), "../meshes/tip.stl"]
    shapes = [visual(f'<mesh filename="{a}" scale="0.1 0.1 0.2"/>') for a in addresses]
    found = load_robot(urdfs.write(package / "urdf", urdf(*shapes))).visual_model.geometryObjects
    assert [Path(g.meshPath).resolve() for g in found] == [mesh] * 5
    np.testing.assert_array_equal(found[0].meshScale, [0.1, 0.1, 0.2])


def test_package_dirs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mesh = tmp_path / "elsewhere" / "parts" / "tip.dae"
    mesh.parent.mkdir(parents=True)
    mesh.touch()
    shape = visual('<mesh filename="package://parts/tip.dae"/>')
    path = urdfs.write(tmp_path / "robot", urdf(shape))
    with pytest.warns(
        MissingMeshWarning, match=r"link 'tip': package://parts/tip.dae: no package folder 'parts'"
    ):
        assert not load_robot(path).visual_model.geometryObjects
    assert load_robot(path, package_dirs=[tmp_path / "elsewhere"]).visual_model.geometryObjects[
        0
    ].meshPath == str(mesh)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path / 'elsewhere'}")
    assert len(load_robot(path).visual_model.geometryObjects) == 1
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    urdfs.write(tmp_path / "robot", urdf(shape), 'package_dirs = ["../elsewhere"]')
    assert len(load_robot(tmp_path / "robot").visual_model.geometryObjects) == 1


def test_missing_meshes_are_named_once_and_left_out(tmp_path: Path) -> None:
    shapes = [visual(f'<mesh filename="m{i}.stl"/>') for i in range(7)] + [visual('<sphere radius="1"/>')]
    path = urdfs.write(tmp_path, urdf(*shapes))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        robot = load_robot(path)
    (warning,) = caught
    assert issubclass(warning.category, MissingMeshWarning)
    assert "shown without its missing meshes" in str(warning.message)
    assert f"link 'tip': {tmp_path / 'm0.stl'} does not exist" in str(warning.message)
    assert str(warning.message).endswith("m0.stl does not exist, and 6 more)")
    assert "m1.stl" not in str(warning.message)
    assert [g.name for g in robot.visual_model.geometryObjects] == ["tip_7"]
    assert robot.nv == 1


def test_a_missing_package_is_named_once(tmp_path: Path) -> None:
    shapes = [visual(f'<mesh filename="package://parts/m{i}.stl"/>') for i in range(3)]
    path = urdfs.write(tmp_path, urdf(*shapes, visual('<mesh filename="m3.stl"/>')))
    with pytest.warns(MissingMeshWarning) as caught:
        load_robot(path)
    (said,) = (str(warning.message) for warning in caught)
    assert said.count("no package folder 'parts' found") == 1
    assert (
        "m0.stl: no package folder 'parts' found, name its parent in package_dirs or --package-dir, and 2"
        in said
    )
    assert said.endswith("m3.stl does not exist)")


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ('<torus radius="1"/>', "unknown shape <torus>"),
        ('<box size="1 2"/>', "box size is '1 2', expected 3 finite numbers|cannot read"),
        ('<box size="1 2 x"/>', "box size is '1 2 x', expected 3 finite numbers|cannot read"),
        ('<sphere radius="1e9"/>', "visual 0 of link 'tip': sphere radius is '1e9', expected 0 to 1e"),
        ('<cylinder radius="-1" length="1"/>', "cylinder radius is '-1', expected 0 to|cannot read"),
        (
            '<mesh filename="a.stl" scale="nan 1 1"/>',
            "mesh scale is 'nan 1 1', expected 3 finite|cannot read",
        ),
        (
            '<mesh filename="a.stl" scale="0 1 1"/>',
            r"mesh scale is \[0\.0, 1\.0, 1\.0\], expected 1e-09 to 1e",
        ),
    ],
)
def test_wrong_shapes(tmp_path: Path, shape: str, message: str) -> None:
    (tmp_path / "a.stl").touch()
    with pytest.raises(RobotFileError, match=message):
        load_robot(urdfs.write(tmp_path, urdf(visual(shape))))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            'xyz="0 0 0.5"',
            'xyz="0 0 up"',
            "visual 0 of link 'tip': origin xyz is '0 0 up', expected 3 finite",
        ),
        ('xyz="0 0 0.5"', 'xyz="0 1e400 0"', "origin xyz is '0 1e400 0', expected 3 finite numbers"),
        ('rpy="0 0 1"', 'rpy="0 0"', "origin rpy is '0 0', expected 3 finite numbers"),
        ("1 0 0 0.5", "1 0 0", "visual 0 of link 'tip': color rgba is '1 0 0', expected 4 finite numbers"),
        ("1 0 0 0.5", "abc", "color rgba is 'abc', expected 4 finite numbers"),
    ],
)
def test_wrong_places_and_colours(tmp_path: Path, old: str, new: str, message: str) -> None:
    red = '<material name="red"><color rgba="1 0 0 0.5"/></material>'
    text = urdf(visual('<sphere radius="1"/>', red)).replace(old, new)
    with pytest.raises(RobotFileError, match=f"{message}|cannot read"):
        load_robot(urdfs.write(tmp_path, text))


@pytest.mark.parametrize("name", ["x" * 5000 + ".stl", "package://" + "y" * 5000 + "/a.stl", ""])
def test_names_that_no_mesh_can_have(tmp_path: Path, name: str) -> None:
    path = urdfs.write(tmp_path, urdf(visual(f'<mesh filename="{name}"/>')))
    with pytest.warns(MissingMeshWarning) as told:
        assert not load_robot(path).visual_model.geometryObjects
    assert len(str(told[0].message)) < 1000


def test_shapes_of_locked_links_stay(tmp_path: Path) -> None:
    two = urdfs.robot(
        urdfs.link("base"),
        urdfs.link("l1"),
        urdfs.link("l2", extra=visual('<sphere radius="1"/>')),
        urdfs.joint("j1", "revolute", "base", "l1"),
        urdfs.joint("j2", "revolute", "l1", "l2"),
    )
    path = urdfs.write(tmp_path, two)
    whole, locked = load_robot(path), load_robot(path, lock={"j2": 0.4})
    (shape,) = locked.visual_model.geometryObjects
    assert shape.parentJoint == 1
    (loose,) = whole.visual_model.geometryObjects
    assert loose.parentJoint == 2

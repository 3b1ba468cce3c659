"""A format that the package does not know: a reader and an entry of `FORMATS` are all that it takes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

from mbocp.exceptions import RobotFileError
from mbocp.robot import gather, load_parts, load_robot, load_stored
from mbocp.robot.collision.geometry import LinkShape, ShapeSource
from mbocp.robot.loading.description import ROOT_JOINT, Description, Oddity, ReadOptions
from mbocp.robot.loading.robot_formats import FORMATS, Format, format_of
from mbocp.robot.robot_facts import find_oddities

FILE = "swing 2.0\n"  # name and mass [kg] of a ball on a hinge


class Toy:
    """Reader of files with one line."""

    def read(self, path: Path, name: str, how: ReadOptions) -> Description:
        try:
            joint, mass = path.read_text().split()
        except ValueError as error:
            raise RobotFileError(path, "expected a name and a mass") from error
        model, at = pin.Model(), pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0]))
        root, ball = 0, pin.Inertia.FromSphere(float(mass), 0.1)
        if how.free_flyer:
            root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), ROOT_JOINT)
            model.appendBodyToJoint(root, ball, pin.SE3.Identity())
        hinge = model.addJoint(root, pin.JointModelRY(), pin.SE3.Identity(), joint)
        model.appendBodyToJoint(hinge, ball, at)
        model.addBodyFrame("ball", hinge, at, 0)
        return Description(
            name=name,
            file=path,
            model=model,
            visuals=pin.GeometryModel(),
            q0=pin.neutral(model),
            source=path,
            shapes=(ShapeSource(path, self._solid),),
        )

    def _solid(self) -> Iterator[LinkShape]:
        yield LinkShape("ball", 0, "the ball", coal.Sphere(0.1), "", np.ones(3), pin.SE3.Identity())

    def companions(self, path: Path) -> tuple[Path, ...]:
        return (path.with_suffix(".notes"),)

    def addresses(self, path: Path) -> tuple[str, ...]:
        return ()

    def oddities(self, path: Path) -> Iterator[Oddity]:
        yield Oddity(f"{path.name} is a toy")


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setitem(FORMATS, "toy", Format("toy", "toy", (".toy",), lambda _folders: Toy()))
    path = tmp_path / "bob.toy"
    path.write_text(FILE)
    path.with_suffix(".notes").write_text("none")
    return path


def test_it_is_read_by_its_ending(file: Path) -> None:
    assert format_of(file).kind == "toy"
    robot = load_robot(file)
    assert (robot.name, robot.joint_names, robot.nu, robot.source) == ("bob", ("swing",), 1, file)
    np.testing.assert_allclose(robot.mass_matrix(robot.q0), [[2.0 * (1.0 + 0.4 * 0.1**2)]])
    assert robot.collision_spheres[0].radii == [0.1]
    assert find_oddities(robot) == ("bob.toy is a toy",)
    file.write_text("swing")
    with pytest.raises(RobotFileError, match=r"bob\.toy: expected a name and a mass"):
        load_robot(file)


def test_a_folder_holds_one(file: Path) -> None:
    assert load_robot(file.parent).name == "bob"
    assert load_robot(file.parent, gravity=[0, 0, -1]).model.gravity.linear[2] == -1


def test_a_robot_toml_adds_to_it(file: Path) -> None:
    toml = file.with_name("robot.toml")
    toml.write_text('name = "bell"\nurdf = "bob.toy"\nfree_flyer = true\n[initial]\nq.swing = 0.5\n')
    robot = load_robot(toml)
    assert (robot.name, robot.joint_names) == ("bell", (ROOT_JOINT, "swing"))
    assert robot.q0[-1] == 0.5


def test_it_is_a_part_of_a_world_and_of_a_result(file: Path) -> None:
    whole = load_parts(
        [{"robot": str(file), "name": "a"}, {"robot": str(file), "name": "b", "position": [1, 0, 0]}]
    )
    assert whole.joint_names == ("a/swing", "b/swing")
    files = gather(whole.spec)
    assert {Path(stored.path).name for stored in files.files} == {"bob.toy", "bob.notes"}
    assert load_stored(files).fingerprint == whole.fingerprint

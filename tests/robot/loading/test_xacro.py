"""xacro files: arguments, packages, and what a result keeps of them."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from mbocp.exceptions import RobotError, RobotFileError
from mbocp.problem.file.load import load_problem
from mbocp.robot import gather, load_parts, load_robot, load_stored
from mbocp.robot.robot_facts import find_oddities

pytest.importorskip("xacro")

LINKS = """<?xml version="1.0"?>
<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="rod" params="name mass length">
    <link name="${name}">
      <inertial>
        <origin xyz="0 0 ${-length / 2}"/><mass value="${mass}"/>
        <inertia ixx="${mass * length**2 / 12}" ixy="0" ixz="0" iyy="${mass * length**2 / 12}" iyz="0"
                 izz="1e-3"/>
      </inertial>
    </link>
  </xacro:macro>
</robot>
"""
ARM = """<?xml version="1.0"?>
<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="tool" default="false"/>
  <xacro:include filename="$(find arm_parts)/urdf/links.xacro"/>
  <xacro:property name="lengths" value="${xacro.load_yaml('lengths.yaml')}"/>
  <link name="base"/>
  <xacro:rod name="upper" mass="$(arg mass)" length="${lengths['upper']}"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="9" velocity="2"/>
  </joint>
  <xacro:if value="$(arg tool)">
    <xacro:rod name="tool" mass="0.5" length="0.2"/>
    <joint name="wrist" type="revolute">
      <origin xyz="0 0 ${-lengths['upper']}"/><parent link="upper"/><child link="tool"/><axis xyz="1 0 0"/>
      <limit lower="-1" upper="1" effort="3" velocity="2"/>
    </joint>
  </xacro:if>
</robot>
"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """Return a workspace of two packages; the folder of one has another name than the package."""
    parts, own = tmp_path / "ws" / "parts_repository", tmp_path / "ws" / "arm"
    (parts / "urdf").mkdir(parents=True)
    own.mkdir()
    (parts / "package.xml").write_text("<package><name>arm_parts</name></package>")
    (parts / "urdf" / "links.xacro").write_text(LINKS)
    (own / "lengths.yaml").write_text("upper: 0.8\n")
    path = own / "arm.urdf.xacro"
    path.write_text(ARM)
    return path


def load(path: Path, **arguments: Any) -> Any:
    folders = [path.parents[1] / "parts_repository"]
    return load_robot(path, arguments=arguments, package_dirs=folders)


def test_numbers_are_those_of_the_expanded_urdf(arm: Path) -> None:
    import xacro

    robot = load(arm, mass=2.0, tool=True)
    assert (robot.name, robot.joint_names) == ("arm", ("shoulder", "wrist"))
    # The same file with the package's path written out, expanded by xacro itself.
    plain = arm.with_name("plain.xacro")
    plain.write_text(ARM.replace("$(find arm_parts)", str(arm.parents[1] / "parts_repository")))
    text = xacro.process_file(str(plain), mappings={"mass": "2.0", "tool": "true"}).toxml()
    model = pin.buildModelFromXML(text)
    data, q, v, a = model.createData(), np.array([0.3, -0.4]), np.array([1.0, 2.0]), np.array([0.5, -1.0])
    np.testing.assert_allclose(robot.mass_matrix(q), pin.crba(model, data, q), atol=1e-15)
    np.testing.assert_allclose(
        pin.rnea(robot.model, robot.model.createData(), q, v, a), pin.rnea(model, data, q, v, a), atol=1e-15
    )
    np.testing.assert_allclose(robot.limits.effort, [9.0, 3.0])


@pytest.mark.parametrize("variable", ["ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"])
def test_packages_are_found_in_workspaces(arm: Path, variable: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RobotFileError, match=r"no package folder 'arm_parts' found, name its parent"):
        load_robot(arm, arguments={"mass": 1.0})
    share = arm.parents[2] / "install" / "share"
    share.mkdir(parents=True)
    (arm.parents[1] / "parts_repository").rename(share / "arm_parts")
    monkeypatch.setenv(variable, str(share if variable.startswith("ROS") else share.parent))
    assert load_robot(arm, arguments={"mass": 1.0}).joint_names == ("shoulder",)


def test_a_package_is_known_by_its_manifest(arm: Path) -> None:
    moved = arm.parents[1] / "parts_repository" / "urdf" / "arm.urdf.xacro"
    moved.write_text(ARM)
    moved.with_name("lengths.yaml").write_text("upper: 0.8\n")
    assert load_robot(moved, arguments={"mass": 1.0}).nv == 1


def test_a_result_reads_it_again_without_source_and_package(
    arm: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = load(arm, mass=2.0, tool=True)
    files = gather(robot.spec)
    assert files.changed == ()
    names = {Path(file.path).name for file in files.files}
    assert {"arm.urdf.xacro", "links.xacro", "lengths.yaml", "arm.urdf.xacro.urdf"} <= names
    arm.write_text(ARM.replace("upper", "lower"))
    assert files.changed == (str(arm),)
    arm.unlink()
    _without_xacro(monkeypatch)
    again = load_stored(files)
    assert again.fingerprint == robot.fingerprint
    np.testing.assert_array_equal(again.mass_matrix(robot.q0), robot.mass_matrix(robot.q0))


def test_it_stands_in_a_robot_toml_and_in_parts(arm: Path) -> None:
    toml = arm.with_name("robot.toml")
    toml.write_text(
        'urdf = "arm.urdf.xacro"\npackage_dirs = ["../parts_repository"]\n'
        "arguments = {mass = 2, tool = true}\n"
    )
    robot = load_robot(toml)
    assert robot.joint_names == ("shoulder", "wrist")
    assert load_robot(toml, arguments={"tool": False}).joint_names == ("shoulder",)
    assert load_stored(gather(robot.spec)).fingerprint == robot.fingerprint
    part = {"robot": str(arm), "name": "a", "package_dirs": [str(arm.parents[1] / "parts_repository")]}
    whole = load_parts([{**part, "arguments": {"mass": 1.5}}])
    assert whole.joint_names == ("a/shoulder",)
    assert load_stored(gather(whole.spec)).fingerprint == whole.fingerprint


def test_oddities_are_those_of_the_urdf(arm: Path) -> None:
    arm.write_text(ARM.replace('velocity="2"', 'velocity="0"'))
    assert find_oddities(load(arm, mass=1.0)) == (
        "joint 'shoulder': zero velocity in <limit>: limits.velocity = true does not bound it",
    )


def test_what_is_wrong_is_told_by_name(arm: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(RobotFileError, match=r"argument 'mass' has no value: give it in robot\.arguments"):
        load(arm)
    with pytest.raises(
        RobotFileError, match=r"arguments: has no argument 'masss': did you mean 'mass'\?"
    ) as caught:
        load(arm, mass=1.0, masss=2.0)
    assert caught.value.key == "arguments"
    arm.with_name("lengths.yaml").write_text("lower: 1\n")
    with pytest.raises(RobotFileError, match=r"cannot expand it: .*lengths\['upper'\]"):
        load(arm, mass=1.0)
    plain = arm.with_name("plain.urdf")
    plain.write_text('<robot name="plain"><link name="a"/></robot>')
    with pytest.raises(RobotFileError, match=r"arguments: got {'a': 1}, but only xacro files take arguments"):
        load(plain, a=1)
    with pytest.raises(RobotError, match=r"arguments: robot 'chain_2' takes none; only xacro files do"):
        load_robot("chain_2", arguments={"a": 1})
    _without_xacro(monkeypatch)
    with pytest.raises(RobotFileError, match=r"pip install 'mbocp\[xacro\]'"):
        load(arm, mass=1.0)


def _without_xacro(monkeypatch: pytest.MonkeyPatch) -> None:
    plain_import = builtins.__import__

    def refuse(name: str, *rest: Any) -> Any:
        if name == "xacro":
            raise ImportError(name)
        return plain_import(name, *rest)

    monkeypatch.setattr(builtins, "__import__", refuse)


def test_the_command_line_gives_arguments(arm: Path) -> None:
    problem = arm.with_name("problem.toml")
    problem.write_text(
        '[robot]\nname = "arm.urdf.xacro"\npackage_dirs = ["../parts_repository"]\narguments = {mass = 1}\n'
        "[horizon]\nduration = 1.0\nsteps = 5\n[goal]\nv = 0\n[cost]\neffort = 1.0\n"
    )
    found = load_problem(problem, ["robot.arguments.tool=true", "robot.arguments.mass=2.5"])
    assert found.robot.joint_names == ("shoulder", "wrist")
    assert found.robot.model.inertias[1].mass == 2.5

"""Each URDF that cannot be right is refused with the name of what is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from mbocp.exceptions import MbocpError, RobotFileError, UnsupportedRobot
from mbocp.robot import load_robot
from tests.robot import urdfs
from tests.robot.urdfs import joint, link, robot


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(RobotFileError, match=r"nothing\.urdf: no such file or folder"):
        load_robot(tmp_path / "nothing.urdf")


def test_folder_without_a_robot(tmp_path: Path) -> None:
    with pytest.raises(
        RobotFileError,
        match=r"has no robot\.toml or robot\.yaml, and not exactly one URDF, xacro, MJCF or SDF",
    ):
        load_robot(tmp_path)


BROKEN = {
    "malformed XML: .*line 1": "<robot name='r'><link></robot>",
    r"not a URDF: it is an SDF file": "<sdf version='1.6'/>",
    r"expected the root element <robot>": "<machine/>",
    r"xacro macros in it: let its name end in": (
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="a"/></robot>'
    ),
    r"has no link": robot(),
    r"a <link> has no name": robot("<link/>"),
    r"link 'a' is defined more than once": robot(link("a"), link("a")),
    r"joint 'j' is defined more than once": robot(
        link("a"), link("b"), link("c"), joint("j", "revolute", "a", "b"), joint("j", "revolute", "b", "c")
    ),
    r"joint 'j': its child link 'z' is not defined": robot(link("a"), joint("j", "revolute", "a", "z")),
    r"joint 'j': its parent link None is not defined": robot(link("a"), '<joint name="j" type="fixed"/>'),
    r"link 'b' is the child of two joints, 'j' and 'k': a URDF is a tree; close loops": robot(
        link("a"), link("b"), link("c"), joint("j", "revolute", "a", "b"), joint("k", "revolute", "c", "b")
    ),
    r"must have exactly one root link .* has 'a', 'b'": robot(link("a"), link("b")),
    r"exactly one root link .* has none": robot(
        link("a"), link("b"), joint("j", "revolute", "a", "b"), joint("k", "revolute", "b", "a")
    ),
    r"links that do not hang on the root link 'a': 'c', 'd', 'e'; their joints \('l', 'k', 'm'\)": robot(
        *(link(n) for n in "abcde"),
        joint("j", "revolute", "a", "b"),
        joint("k", "revolute", "c", "d"),
        joint("l", "revolute", "d", "c"),
        joint("m", "revolute", "d", "e"),
    ),
    r"joint 'j' is revolute, and has no <limit>; zeros in it mean no limits": robot(
        link("a"), link("b"), joint("j", "revolute", "a", "b", extra="")
    ),
    r"joint 'k' joins link 'c' to itself": robot(
        *(link(n) for n in "abc"), joint("j", "revolute", "a", "b"), joint("k", "revolute", "c", "c")
    ),
    r"joint 'j': axis xyz is '0 0 0', expected a direction": robot(
        link("a"), link("b"), joint("j", "revolute", "a", "b", axis="0 0 0")
    ),
    r"joint 'j': axis xyz is '0 0 1e300', expected 3 finite numbers up to 1e\+15": robot(
        link("a"), link("b"), joint("j", "revolute", "a", "b", axis="0 0 1e300")
    ),
    r"joint 'j': axis xyz is '0 0 1e-300', expected a direction": robot(
        link("a"), link("b"), joint("j", "revolute", "a", "b", axis="0 0 1e-300")
    ),
    r"joint 'j': axis xyz is '0 1', expected 3 finite numbers": robot(
        link("a"), link("b"), joint("j", "revolute", "a", "b", axis="0 1")
    ),
    r"joint 'j': origin xyz is 'nan 0 0.1', expected 3 finite numbers": robot(
        link("a"), link("b"), joint("j", "revolute", "a", "b").replace('xyz="0.3', 'xyz="nan')
    ),
    r"link 'b': inertial origin xyz is 'x 0.02 0.2', expected 3 finite numbers": robot(
        link("a"), link("b").replace('"0.1 0.02', '"x 0.02'), joint("j", "revolute", "a", "b")
    ),
    r"link 'x{90}.*x': its name has 300 characters, expected at most 255": robot(link("x" * 300)),
    r"joint 'j.x85n': its name has 3 characters, .* no control characters among them": robot(
        link("a"), link("b"), joint("j&#133;n", "revolute", "a", "b")
    ),
    r"its name 'a..n' has control characters": robot(link("a"), name="a&#10;n"),
    r"XML elements are nested more than 100 deep": robot("<a>" * 200, "</a>" * 200),
    r"joint 'j2' mimics 'nobody', which is not defined": robot(
        link("a"), link("b"), joint("j2", "revolute", "a", "b", extra=urdfs.mimic("nobody"))
    ),
    r"joint 'j1' mimics 'j2', which moves with it: exchange.*or load .* mimic = false": robot(
        *(link(n) for n in "abc"),
        joint("j1", "revolute", "a", "b", extra=urdfs.mimic("j2")),
        joint("j2", "revolute", "b", "c"),
    ),
    r"joints beyond 'j\d' and 'j\d' mimic each other's: make one the leader of all": robot(
        *(link(n) for n in "abcde"),
        joint("j1", "revolute", "a", "b"),
        joint("j2", "revolute", "b", "c", extra=urdfs.mimic("j3")),
        joint("j3", "revolute", "a", "d"),
        joint("j4", "revolute", "d", "e", extra=urdfs.mimic("j1")),
    ),
    r"Pinocchio cannot read this URDF: .*j": robot(
        link("a"), link("b"), joint("j", "revolute", "a", "b", extra="<limit/>")
    ),
    r"joint 'j1': friction is 'rough', expected a finite number": robot(
        *(link(n) for n in "ab"),
        joint("j1", "prismatic", "a", "b", extra=urdfs.LIMIT + urdfs.losses(0, "rough")),
    ),
}


@pytest.mark.parametrize("message", BROKEN)
def test_broken_files(tmp_path: Path, message: str, capfd: pytest.CaptureFixture[str]) -> None:
    path = urdfs.write(tmp_path, BROKEN[message])
    with pytest.raises(RobotFileError, match=message) as refused:
        load_robot(path)
    assert refused.value.path == path
    assert capfd.readouterr().err == ""


UNSUPPORTED = {
    r"joint 'j2' mimics itself, by way of 'j2', 'j3'; mend it, or load": robot(
        *(link(n) for n in "abcd"),
        joint("j1", "revolute", "a", "b"),
        joint("j2", "revolute", "b", "c", extra=urdfs.mimic("j3")),
        joint("j3", "revolute", "c", "d", extra=urdfs.mimic("j2")),
    ),
    r"joint 'j2' mimics 'j1' with the multiplier 0.5: the angle of a continuous joint is known up": robot(
        *(link(n) for n in "abc"),
        joint("j1", "continuous", "a", "b"),
        joint("j2", "continuous", "b", "c", extra=urdfs.mimic("j1", 0.5)),
    ),
    r"joint 'j1': damping is -0.1; it takes energy out, and cannot be negative": robot(
        *(link(n) for n in "ab"), joint("j1", "revolute", "a", "b", extra=urdfs.LIMIT + urdfs.losses(-0.1))
    ),
    r"joint 'j2' mimics 'j1': a revolute joint cannot follow a continuous one": robot(
        *(link(n) for n in "abc"),
        joint("j1", "continuous", "a", "b"),
        joint("j2", "revolute", "b", "c", extra=urdfs.mimic("j1")),
    ),
    r"joint 'j2' mimics 'j1': a revolute joint cannot follow a planar one": robot(
        *(link(n) for n in "abc"),
        joint("j1", "planar", "a", "b"),
        joint("j2", "revolute", "b", "c", extra=urdfs.mimic("j1")),
    ),
    r"joint 'j' is of type 'spherical'; supported: revolute, continuous": robot(
        link("a"), link("b"), joint("j", "spherical", "a", "b")
    ),
    r"link 'b': mass is -2 kg; a mass must be positive": robot(
        link("a"), link("b", mass=-2.0), joint("j", "revolute", "a", "b")
    ),
    r"link 'b': mass is 'nan', expected a finite number": robot(
        link("a"), link("b", mass="nan"), joint("j", "revolute", "a", "b")
    ),
    r"link 'b': mass is '1e308', expected a finite number up to 1e": robot(
        link("a"), link("b", mass="1e308"), joint("j", "revolute", "a", "b")
    ),
    r"link 'b': mass is 'heavy', expected a finite number": robot(
        link("a"), link("b", mass="heavy"), joint("j", "revolute", "a", "b")
    ),
    r"link 'b': iyy is -0.03 kg m\^2; a moment of inertia cannot be negative": robot(
        link("a"), link("b").replace('iyy="0.03"', 'iyy="-0.03"'), joint("j", "revolute", "a", "b")
    ),
    r"link 'b': mass is '1_0', expected a finite number": robot(
        link("a"), link("b", mass="1_0"), joint("j", "revolute", "a", "b")
    ),
    r"link 'b': ixz is None, expected a finite number": robot(
        link("a"), link("b").replace('ixz="0"', ""), joint("j", "revolute", "a", "b")
    ),
    r"mass matrix is singular .* moves with any joint\. Give its links masses and inertias": robot(
        link("a"), link("b", mass=None), joint("j", "revolute", "a", "b")
    ),
    r"moves with 'k'\. .* lock it: lock = \[\"k\"\]": robot(
        link("a"), link("b"), link("c", mass=0), joint("j", "revolute", "a", "b"),
        joint("k", "prismatic", "b", "c"),
    ),
    r"robot 'test': has no joint that moves": robot(link("a"), link("b"), joint("j", "fixed", "a", "b")),
}  # fmt: skip


@pytest.mark.parametrize("message", UNSUPPORTED)
def test_unsupported_robots(tmp_path: Path, message: str) -> None:
    with pytest.raises(UnsupportedRobot, match=message):
        load_robot(urdfs.write(tmp_path, UNSUPPORTED[message]))


def test_a_composite_joint_is_refused_by_name() -> None:
    import pinocchio as pin

    from mbocp.robot.joints import check_joints

    model = pin.Model()
    composite = pin.JointModelComposite(pin.JointModelRX())
    composite.addJoint(pin.JointModelRY())
    model.addJoint(0, composite, pin.SE3.Identity(), "wrist")
    with pytest.raises(
        UnsupportedRobot, match=r"robot 'r': joint 'wrist' is of type Composite, which mbocp does not"
    ):
        check_joints(model, "r")


def test_every_refusal_is_an_mbocp_error() -> None:
    assert issubclass(RobotFileError, MbocpError)
    assert issubclass(UnsupportedRobot, MbocpError)


def test_massless_links_in_a_chain_are_fine(tmp_path: Path) -> None:
    parts = [link("a", None), link("b", None), link("c", None), link("d")]
    slides = [joint(n, "prismatic", p, c, axis=a) for n, p, c, a in
              (("x", "a", "b", "1 0 0"), ("y", "b", "c", "0 1 0"), ("z", "c", "d", "0 0 1"))]  # fmt: skip
    assert load_robot(urdfs.write(tmp_path, robot(*parts, *slides))).nv == 3

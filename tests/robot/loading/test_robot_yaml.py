"""A robot.yaml beside a URDF, as public collections of parallel robots have it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbocp.exceptions import LoopNotClosed, RobotFileError, UnknownFrame, UnknownJoint
from mbocp.robot import (
    IgnoredKeysWarning,
    PointOnPoint,
    Robot,
    Weld,
    list_robots,
    load_robot,
    robot_from_spec,
)
from tests.robot import urdfs
from tests.robot.loops import builders as loops

LOOP = "closed_loop: [['loop1_A', 'loop1_B']]\n"
URDF = (  # an arm of two hinges and another, and a rod that hangs on it
    '<robot name="legs"><link name="base"/>'
    + loops.link("a1", 0.3)
    + loops.link("a2", 0.5)
    + loops.link("b1", 0.3)
    + loops.link("b2", 0.5)
    + loops.joint("mot_a", "base", "a1", rpy="0 -0.9 0")
    + loops.joint("knee", "a1", "a2", "0.3 0 0", rpy="0 1.2 0")
    + loops.joint("mot_b", "base", "b1", "0.4 0 0", rpy="0 -2.2 0")
    + loops.joint("free", "b1", "b2", "0.3 0 0", rpy="0 -1.2 0")
    + loops.tip("loop1_A", "a2", 0.5)
    + loops.tip("loop1_B", "b2", 0.5)
    + "</robot>"
)


def load(folder: Path, text: str, urdf: str = URDF, **options: object) -> Robot:
    folder.mkdir(exist_ok=True)
    (folder / "robot.urdf").write_text(urdf)
    (folder / "robot.yaml").write_text(text)
    return load_robot(folder, **options)  # type: ignore[arg-type]


def test_a_point_and_motors(tmp_path: Path) -> None:
    robot = load(tmp_path, LOOP + "type: ['3d']\nname_mot: ['mot_b', 'mot_a']\n")
    (loop,) = robot.constraints
    assert isinstance(loop, PointOnPoint)
    assert (loop.name, loop.frames, robot.nc) == ("loop1", ("loop1_A", "loop1_B"), 2)
    assert [label.name for label in robot.u_labels] == ["mot_b", "mot_a"]
    np.testing.assert_allclose(robot.closure_residual(robot.q0), 0.0, atol=1e-13)
    assert robot_from_spec(robot.spec).fingerprint == robot.fingerprint


@pytest.mark.parametrize("kind", ["", "type: ['6d']\n", "type: ['6D']\n"])
def test_a_weld_is_the_default(tmp_path: Path, kind: str) -> None:
    """The loop has one hinge less than with a point."""
    robot = load(tmp_path, LOOP + kind + "name_mot: ['mot_a']\n")
    assert isinstance(robot.constraints[0], Weld)
    assert robot.nv - robot.nc == 1


def test_other_types_of_joints(tmp_path: Path) -> None:
    """A ball and a universal joint leave the rod free to turn about itself."""
    text = LOOP + "type: ['3d']\nname_mot: ['mot_a', 'mot_b']\n"
    text += "joint_name: ['knee', 'free']\njoint_type: ['SPHERICAL', 'UJOINT_YZ']\n"
    robot = load(tmp_path, text)
    assert robot.joint_names == ("mot_a", "knee", "mot_b", "free_Y", "free_Z")
    assert (robot.nv, robot.nc) == (7, 3)
    fixed = load(tmp_path, LOOP + "type: ['3d']\njoint_name: ['knee']\njoint_type: ['FIXED']\n")
    assert fixed.joint_names == ("mot_a", "mot_b", "free")


def test_names_under_the_robot_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    load(tmp_path / "my_legs", LOOP + "type: ['3d']\n")
    monkeypatch.setenv("MBOCP_ROBOT_PATH", str(tmp_path))
    assert load_robot("my_legs").name == "my_legs"
    (entry,) = [entry for entry in list_robots() if entry.name == "my_legs"]
    assert entry.description == "closed loops of robot.yaml"
    (tmp_path / "my_legs" / "robot.toml").write_text('description = "open"\n')
    assert load_robot("my_legs").nc == 0


def test_mimic_joints_are_joints_of_their_own(tmp_path: Path) -> None:
    """The collections load their URDFs so, and have motors on them."""
    urdf = URDF.replace('<child link="a2"/>', '<child link="a2"/><mimic joint="mot_a"/>', 1)
    text = LOOP + "type: ['3d']\nname_mot: ['mot_a', 'knee']\n"
    assert load(tmp_path, text, urdf).joint_names == ("mot_a", "knee", "mot_b", "free")
    assert load(tmp_path, LOOP + "type: ['3d']\n", urdf, mimic=True).nv == 3


def test_options_win(tmp_path: Path) -> None:
    robot = load(tmp_path, LOOP + "type: ['3d']\nname_mot: ['mot_a']\n", free_flyer=True, actuated=["mot_b"])
    assert robot.joint_names[0] == "root_joint"
    assert [label.name for label in robot.u_labels] == ["mot_b"]


def test_unknown_keys_are_told(tmp_path: Path) -> None:
    with pytest.warns(
        IgnoredKeysWarning, match=r"what 'rotor_inertia', 'mass' says is left out \(known keys"
    ):
        load(tmp_path, LOOP + "type: ['3d']\nrotor_inertia: [1.0]\nmass: 3\n")


WRONG = {
    r"robot\.yaml: closed_loop: Field required": "type: ['3d']",
    r"closed_loop\[0\]\[1\]: .*Field required": "closed_loop: [['loop1_A']]",
    r"type\[0\]: got '5d': .*'3d'": LOOP + "type: ['5d']",
    r"type: has 2 entries for 1 pairs of closed_loop": LOOP + "type: ['3d', '6d']",
    r"name_mot: got 'mot': Input should be a valid list": LOOP + "name_mot: mot",
    r"joint_type: has 0 entries for 1 of joint_name": LOOP + "joint_name: ['knee']",
    r"joint_name: the URDF has no joint 'kne': did you mean 'knee'": (
        LOOP + "joint_name: ['kne']\njoint_type: ['FIXED']"
    ),
    r"joint_type: unknown type 'CARDAN' of joint 'knee'": LOOP
    + "joint_name: ['knee']\njoint_type: ['CARDAN']",
    r"closed_loop: .*two different frames, got 'loop1_A' twice": "closed_loop: [['loop1_A', 'loop1_A']]",
    r"malformed YAML: .*line \d": "closed_loop: [",
    r"expected keys and values: closed_loop": "- 1",
    r"malformed YAML: stands for more than 20000 entries": "a: &a0 [x, x, x, x, x, x, x, x, x]\n"
    + "".join(f"b{k}: &a{k + 1} [{', '.join([f'*a{k}'] * 9)}]\n" for k in range(9))
    + "closed_loop: *a9\n",
    r"malformed YAML: lists or tables are nested more than 20 deep": "closed_loop: " + "[" * 500,
    r"malformed YAML: \*a stands within itself": "closed_loop: &a [[*a, b]]",
    r"type\[0\]: got '2020-13-45'": LOOP + "type: [2020-13-45]",
    r"type\[0\]: got '12'": LOOP + "type: [!!int 12]",
    r"closed_loop\[0\]\[0\]: got \['a', 'a', .{1,150}": "closed_loop: [[[" + "a, " * 9000 + "a], b]]",
    r"malformed YAML: .*unacceptable character": LOOP + "x: '\x00'",
    r"has 0\.5 MB, expected a robot\.yaml of at most 0\.25 MB": LOOP + "#" * 2**19,
}


@pytest.mark.parametrize("message", WRONG)
def test_wrong_files_are_refused(tmp_path: Path, message: str) -> None:
    with pytest.raises(RobotFileError, match=message) as refused:
        load(tmp_path, WRONG[message])
    assert len(str(refused.value)) < 1000


def test_every_scalar_is_a_name(tmp_path: Path) -> None:
    """Frames may be called 1 and on, or like a date, without quotes."""
    urdf = URDF.replace("loop1_A", "2020-13-45").replace("loop1_B", "0b_")
    robot = load(tmp_path, "closed_loop: [[2020-13-45, 0b_]]\ntype: [3d]\n", urdf)
    assert robot.constraints[0].frames == ("2020-13-45", "0b_")


def test_names_that_there_are_not(tmp_path: Path) -> None:
    with pytest.raises(UnknownFrame, match="no frame 'loop1_C'"):
        load(tmp_path, LOOP.replace("loop1_B", "loop1_C"))
    with pytest.raises(UnknownJoint, match="no joint 'mot_c'"):
        load(tmp_path, LOOP + "name_mot: ['mot_c']\n")
    with pytest.raises(LoopNotClosed, match="violates 'loop1"):
        load(tmp_path, LOOP, URDF.replace('xyz="0.4 0 0"', 'xyz="4 0 0"'))
    (tmp_path / "two").mkdir()
    for name in ("a", "b"):
        (tmp_path / "two" / f"{name}.urdf").write_text(urdfs.chain("revolute"))
    (tmp_path / "two" / "robot.yaml").write_text(LOOP)
    with pytest.raises(RobotFileError, match=r"no such file"):
        load_robot(tmp_path / "two")

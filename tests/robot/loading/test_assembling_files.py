"""Files that assemble robots and objects from parts, and what they cannot say."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbocp.exceptions import (
    DimensionMismatch,
    RobotError,
    RobotFileError,
)
from mbocp.robot import load_parts, load_robot, robot_from_spec
from tests.robot.loading.test_joined import GRIPS, joined


def write(folder: Path, text: str) -> Path:
    """A folder with a robot.toml."""
    folder.mkdir(exist_ok=True)
    (folder / "robot.toml").write_text(text)
    return folder


CELL = """
name = "cell"
description = "Two chains and a box"
trace = ["box/body"]

[[part]]
name = "left"
robot = "chain_3"
position = [-0.3, 0, 1]

[[part]]
name = "right"
robot = "chain_3"
position = [0.3, 0, 1]

[[part]]
name = "box"
box = [0.2, 0.1, 0.05]
mass = 1.5

[actuation]
joints = ["left/joint_1", "right/joint_1"]

[[payload]]
name = "can"
frame = "box/body"
mass = 0.2
com = [0, 0, 0.05]

[[constraint]]
type = "hinge"
name = "grip_left"
frames = ["left/tip", "box/body"]
axis = [0, 1, 0]
position_b = [-0.1, 0, 0]

[[constraint]]
type = "hinge"
name = "grip_right"
frames = ["right/tip", "box/body"]
axis = [0, 1, 0]
position_b = [0.1, 0, 0]

[initial.q]
box = [0, 0, 0.45, 0, 0, 0, 1]
"""


def test_a_file_assembles_parts(tmp_path: Path) -> None:
    """The same world as by `load_parts`, but for motors and a payload of its own."""
    robot = load_robot(write(tmp_path / "cell", CELL))
    assert robot.name == "cell"
    assert robot.trace_frames == ("box/body",)
    assert [label.name for label in robot.u_labels] == ["left/joint_1", "right/joint_1"]
    assert [payload.name for payload in robot.payloads] == ["can"]
    np.testing.assert_allclose(robot.q0, joined().q0, atol=1e-9)
    assert robot.redundant_rows == joined().redundant_rows
    again = robot_from_spec(robot.spec)
    assert again.fingerprint == robot.fingerprint


def test_a_file_that_assembles_is_a_part_of_others(tmp_path: Path) -> None:
    cell = write(tmp_path / "cell", CELL)
    parts = [
        {"name": "a", "robot": str(cell)},
        {"name": "b", "robot": str(cell), "position": [0.3, 2.0, 0.2]},
        {"name": "far", "robot": "ur5", "parent": "b/left/universe"},
    ]
    tie = {"type": "rod", "name": "tie", "frames": ["a/box/body", "b/box/body"]}
    robot = load_parts(parts, constraint=[tie])
    one = load_robot(cell)
    inner = [f"{cell}/{part}" for cell in "ab" for part in ("left", "right", "box")]
    assert [part.name for part in robot.parts] == [*inner, "far"]
    assert robot.nv == 2 * one.nv + 6
    assert robot.nc == 2 * one.nc + 1
    assert [payload.name for payload in robot.payloads] == ["a/can", "b/can"]
    assert robot.constraints[0].name == "a/grip_left"
    np.testing.assert_allclose(robot.constraints[-1].length, np.linalg.norm([0.3, 2.0, 0.2]), atol=1e-9)
    placed = robot.frame_placement("b/box/body").translation - robot.frame_placement("a/box/body").translation
    np.testing.assert_allclose(placed, [0.3, 2.0, 0.2], atol=1e-9)
    again = robot_from_spec(robot.spec)
    assert again.fingerprint == robot.fingerprint


def test_files_that_assemble_each_other_are_refused(tmp_path: Path) -> None:
    text = '[[part]]\nname = "{}"\nrobot = "../{}"\n'
    write(tmp_path / "one", text.format("x", "two"))
    write(tmp_path / "two", text.format("y", "one"))
    with pytest.raises(RobotFileError, match=r"assembles itself: .*one.* -> .*two.* -> .*one"):
        load_robot(tmp_path / "one")
    write(tmp_path / "self", text.format("z", "self"))
    with pytest.raises(RobotFileError, match=r"part 'z': .*assembles itself"):
        load_robot(tmp_path / "self")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('urdf = "a.urdf"\n', "urdf: does not go with part; write it into each part"),
        ("damping = false\n", "damping: does not go with part"),
        ('[[part]]\nname = "b"\n', r"part\[1\]: robot is missing"),
        ('[[part]]\nname = "b"\nmas = 2.0\n', r"part\[1\]\.mas: unknown key; .*did you mean 'mass'"),
        ('[[part]]\nname = "box"\nrobot = "ur5"\n', "the name 'box' is given twice"),
        ('[[constraint]]\ntype = "weld"\nframes = ["box/body", "box/top"]\n', "no frame 'box/top'"),
        ("[initial.q]\nbox = [1, 2]\n", r"initial\.q\.box"),
        ("[initial.q]\nbax = [1, 2]\n", "no joint 'bax'"),
        ('[actuation]\njoints = ["box/hinge"]\n', "no joint 'box/hinge'"),
    ],
)
def test_what_a_file_that_assembles_cannot_say(tmp_path: Path, text: str, words: str) -> None:
    part = '[[part]]\nname = "box"\nbox = [1, 1, 1]\nmass = 1\n'
    whole = text + part if text.startswith(("urdf", "damping")) else part + text
    with pytest.raises((RobotError, DimensionMismatch), match=words):
        load_robot(write(tmp_path / "bad", whole))


def test_options_of_a_single_robot_are_refused_beside_parts(tmp_path: Path) -> None:
    cell = write(tmp_path / "cell", CELL)
    with pytest.raises(RobotError, match=r"free_flyer: robot 'cell' is assembled of parts; write"):
        load_robot(cell, free_flyer=True)
    with pytest.raises(RobotError, match=r"part 'a': .*damping: robot 'cell' is assembled"):
        load_parts([{"name": "a", "robot": str(cell), "damping": False}])
    for key, value in (("constraint", GRIPS), ("initial", {"q": [0.0]})):
        with pytest.raises(RobotError, match=rf"robot\.{key}: goes with robot\.part"):
            robot_from_spec({"name": "ur5", key: value})

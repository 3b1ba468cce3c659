"""<constraint> of a URDF closes loops, as a [[constraint]] of a robot.toml does."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from mbocp.exceptions import MbocpError
from mbocp.robot import Robot, gather, load_robot, load_stored
from mbocp.robot.warnings import NotModelledWarning

BAR = """<link name="{0}"><inertial><origin xyz="0.5 0 0"/><mass value="1"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
PIN = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>
  <origin xyz="{3} 0 0" rpy="0 {4} 0"/><axis xyz="0 1 0"/>
  <limit lower="-3" upper="3" effort="9" velocity="9"/></joint>"""
BARS = "".join(BAR.format(name) for name in ("crank", "coupler", "rocker"))
TREE = (
    '<robot name="four_bar"><link name="base"/>'
    + BARS
    + PIN.format("a", "base", "crank", 0, -math.pi / 2)
    + PIN.format("b", "crank", "coupler", 1, math.pi / 2)
    + PIN.format("c", "base", "rocker", 1, -math.pi / 2)
)
# The rocker's frame is turned against the coupler's.
PROPOSED = f"""<constraint name="pin" type="{{kind}}">
  <parent link="coupler"/><parent_origin xyz="1 0 0" rpy="0 {-math.pi / 2} 0"/>{{axes}}
  <child link="rocker"/><child_origin xyz="1 0 0"/></constraint>"""
AXIS = '<parent_axis xyz="0 2 0"/>'
MIT = """<constraint name="pin" type="position">
  <predecessor link="coupler"><origin xyz="1 0 0"/></predecessor>
  <successor link="rocker"><origin xyz="1 0 0"/></successor></constraint>"""


def robot(folder: Path, *inner: str, toml: str = "") -> Robot:
    file = folder / "robot.urdf"
    file.write_text(TREE + "".join(inner) + "</robot>", encoding="utf-8")
    if toml:
        file = folder / "robot.toml"
        file.write_text(toml, encoding="utf-8")
    return load_robot(file)


@pytest.mark.parametrize(
    ("element", "kind", "rows"),
    [
        (PROPOSED.format(kind="revolute", axes=AXIS), "hinge", 5),
        (PROPOSED.format(kind="spherical", axes=""), "point", 3),
        (MIT, "point", 3),
    ],
)
def test_loops_are_those_of_a_robot_toml(tmp_path: Path, element: str, kind: str, rows: int) -> None:
    found = robot(tmp_path, element)
    toml = f"""
[[constraint]]
type = "{kind}"
name = "pin"
frames = ["coupler", "rocker"]
position = [1, 0, 0]
position_b = [1, 0, 0]
{"axis = [0, 1, 0]" if kind == "hinge" else ""}
"""
    (tmp_path / "toml").mkdir()
    other = robot(tmp_path / "toml", toml=toml)
    assert (len(found.closure_labels), found.nc, found.nv) == (rows, 2, 3)
    q = np.array([0.3, 0.2, -0.1])
    np.testing.assert_allclose(found.assemble(q), other.assemble(q), atol=1e-9)
    assert not np.allclose(found.closure_residual(q), 0.0)
    assert load_stored(gather(found.spec)).fingerprint == found.fingerprint


def test_a_cut_link_is_welded(tmp_path: Path) -> None:
    """The rocker is cut in two: the coupler carries the other half."""
    half = BAR.format("half") + PIN.format("d", "coupler", "half", 1, -math.pi / 2)
    cut = """<constraint name="cut" type="link"><parent link="half"/><child link="rocker"/>
      <child_origin xyz="1 0 0"/></constraint>"""
    found = robot(tmp_path, half, cut)
    assert (len(found.closure_labels), found.nc, found.nv) == (6, 3, 4)


def test_a_robot_toml_stands_beside_them(tmp_path: Path) -> None:
    found = robot(tmp_path, MIT, toml='[actuation]\njoints = ["a"]\n')
    assert (found.nu, found.nc) == (1, 2)


@pytest.mark.parametrize(
    ("element", "words"),
    [
        (
            PROPOSED.format(kind="universal", axes=AXIS),
            r"constraint 'pin' is of type 'universal'; supported: link",
        ),
        (
            PROPOSED.format(kind="revolute", axes=""),
            "constraint 'pin': a revolute one needs <parent_axis xyz>",
        ),
        (
            PROPOSED.format(kind="revolute", axes=AXIS + '<child_axis xyz="1 0 0"/>'),
            r"constraint 'pin': <child_axis> is \[1\.0, 0\.0, 0\.0\], expected none",
        ),
        (
            PROPOSED.format(kind="revolute", axes='<parent_axis xyz="0 y 0"/>'),
            "xyz of <parent_axis> is '0 y 0'",
        ),
        (MIT.replace("rocker", "rockr"), "constraint 'pin': <successor link='rockr'>, expected a link"),
        (MIT.replace(' name="pin"', ""), "a <constraint> has no name"),
    ],
)
def test_what_is_not_defined_is_refused(tmp_path: Path, element: str, words: str) -> None:
    with pytest.raises(MbocpError, match=words):
        robot(tmp_path, element)


@pytest.mark.parametrize("tag", ["loop", "coupling"])
def test_other_proposals_are_told(tmp_path: Path, tag: str) -> None:
    with pytest.warns(NotModelledWarning, match=f"the loop that <{tag}> 'l' closes"):
        robot(tmp_path, f'<{tag} name="l" type="revolute"/>')

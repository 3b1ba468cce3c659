"""SDF: the same numbers as Pinocchio has for the URDF of the same robot; loops are closed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from mbocp._arrays import Array
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.robot import Robot, gather, load_robot, load_stored
from mbocp.robot.loading.readers import sdf
from mbocp.robot.loading.readers.sdf_xml import parse_sdf
from mbocp.robot.robot_facts import find_oddities
from mbocp.robot.warnings import ImpossibleInertiaWarning, MissingMeshWarning, NotModelledWarning

INERTIAL = """<inertial><pose>0.01 0.02 0.1 0.1 0.2 0.3</pose><mass>{mass}</mass>
  <inertia><ixx>0.02</ixx><iyy>0.03</iyy><izz>0.025</izz><ixy>0.001</ixy><ixz>0.002</ixz><iyz>-0.003</iyz>
  </inertia></inertial>"""
ARM = f"""<?xml version="1.0"?>
<sdf version="1.9">
  <world name="w">
    <gravity>0 0 -9.7</gravity>
    <model name="floor"><static>true</static><link name="floor"/></model>
    <model name="arm">
      <pose>0.5 0 0 0 0 0.7</pose>
      <link name="base">{INERTIAL.format(mass=4)}</link>
      <link name="upper"><pose relative_to="shoulder">0 0 0.05 0.1 0 0</pose>{INERTIAL.format(mass=2)}
        <visual name="v"><geometry><box><size>0.1 0.1 0.4</size></box></geometry>
          <material><diffuse>1 0 0</diffuse></material></visual>
        <collision name="c"><geometry><sphere><radius>0.2</radius></sphere></geometry></collision>
      </link>
      <link name="lower"><pose degrees="true" relative_to="upper">0.1 0 0.4 0 30 0</pose>
        {INERTIAL.format(mass=1)}</link>
      <frame name="tool" attached_to="lower"><pose>0 0 0.2 0 0 0</pose></frame>
      <frame name="mark"><pose>0 0 0.3 0 0 0</pose></frame>
      <joint name="mount" type="fixed"><parent>world</parent><child>base</child></joint>
      <joint name="shoulder" type="revolute"><pose relative_to="mark"/>
        <parent>base</parent><child>upper</child>
        <axis><xyz expressed_in="__model__">0 1 1</xyz>
          <limit><lower>-1</lower><upper>2</upper><effort>30</effort><velocity>3</velocity></limit>
          <dynamics><damping>0.4</damping></dynamics></axis>
      </joint>
      <joint name="slide" type="prismatic"><pose>0.02 0 0 0 0 0</pose>
        <parent>upper</parent><child>tool</child>
        <axis><xyz>0 0 1</xyz><limit><lower>-inf</lower><upper>1e16</upper><effort>-1</effort></limit></axis>
      </joint>
    </model>
  </world>
</sdf>
"""
BAR = """<link name="{name}"><pose>{at} 0 0 0</pose>
  <inertial><pose>{half} 0 0 0</pose><mass>1</mass>
    <inertia><ixx>0.1</ixx><iyy>0.1</iyy><izz>0.1</izz></inertia></inertial></link>"""
PIN = """<joint name="{name}" type="{kind}"><pose>{at} 0 0 0</pose>
  <parent>{parent}</parent><child>{child}</child><axis><xyz>0 1 0</xyz></axis></joint>"""
FOUR_BAR = f"""<sdf version="1.7"><model name="four_bar">
  {BAR.format(name="crank", at="0 0 0", half="0 0 0.5")}
  {BAR.format(name="coupler", at="0 0 1", half="0.5 0 0")}
  {BAR.format(name="rocker", at="1 0 0", half="0 0 0.5")}
  {PIN.format(name="a", kind="revolute", at="0 0 0", parent="world", child="crank")}
  {PIN.format(name="b", kind="revolute", at="0 0 0", parent="crank", child="coupler")}
  {PIN.format(name="c", kind="revolute", at="0 0 0", parent="world", child="rocker")}
  {PIN.format(name="d", kind="KIND", at="0 0 1", parent="coupler", child="rocker")}
</model></sdf>"""


def load(tmp_path: Path, text: str, **options: Any) -> Robot:
    path = tmp_path / "robot.sdf"
    path.write_text(text)
    return load_robot(path, **options)


def test_numbers_are_those_of_the_urdf_of_the_same_robot(tmp_path: Path) -> None:
    robot = load(tmp_path, ARM)
    assert (robot.name, robot.joint_names) == ("arm", ("shoulder", "slide"))
    model = pin.buildModelFromXML(_urdf())
    model.gravity.linear = np.array([0.0, 0.0, -9.7])
    q, v, a = np.array([0.4, 0.1]), np.array([1.0, -0.5]), np.array([0.3, 2.0])
    ours, data = robot.model.createData(), model.createData()
    np.testing.assert_allclose(_mass(robot.model, q), _mass(model, q), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(
        pin.rnea(robot.model, ours, q, v, a), pin.rnea(model, data, q, v, a), rtol=1e-12, atol=1e-13
    )
    pin.framesForwardKinematics(robot.model, ours, q)
    pin.framesForwardKinematics(model, data, q)
    for frame in ("base", "upper", "lower", "tool"):
        there = data.oMf[model.getFrameId(frame, pin.BODY)]
        np.testing.assert_allclose(ours.oMf[robot.frame_id(frame)].homogeneous, there.homogeneous, atol=1e-13)
    np.testing.assert_allclose(robot.limits.position_upper, [2.0, np.inf])
    np.testing.assert_allclose(robot.limits.effort, [30.0, np.inf])
    np.testing.assert_allclose(robot.limits.velocity, [3.0, np.inf])
    np.testing.assert_allclose(robot.model.damping, [0.4, 0.0])
    np.testing.assert_allclose(robot.visual_model.geometryObjects[0].meshColor, [1, 0, 0, 1])
    assert robot.collision_spheres[0].radii == [0.2]


def test_a_file_is_parsed_once_to_be_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, parsed = load(tmp_path, ARM), list[Path]()
    monkeypatch.setattr(
        sdf, "parse_sdf", lambda path, folders: parsed.append(path) or parse_sdf(path, folders)
    )
    gather(robot.spec)
    assert parsed == [tmp_path / "robot.sdf"]


def test_a_model_without_a_joint_to_the_world_floats(tmp_path: Path) -> None:
    text = "\n".join(line for line in ARM.splitlines() if 'name="mount"' not in line)
    robot = load(tmp_path, text)
    assert robot.joint_names == ("root_joint", "shoulder", "slide")
    turn = [0.0, 0.0, np.sin(0.35), np.cos(0.35)]
    np.testing.assert_allclose(robot.q0, [0.5, 0.0, 0.0, *turn, 0.0, 0.0])
    assert load(tmp_path, text, free_flyer=False).joint_names == ("shoulder", "slide")


@pytest.mark.parametrize(
    ("kind", "closes"),
    [("revolute", ("d", "hinge")), ("ball", ("d", "point")), ("continuous", ("d", "hinge"))],
)
def test_loops_are_closed(tmp_path: Path, kind: str, closes: tuple[str, str]) -> None:
    robot = load(tmp_path, FOUR_BAR.replace("KIND", kind))
    assert robot.joint_names == ("a", "b", "c")
    assert [(c.name, c.kind) for c in robot.constraints] == [closes]
    assert robot.nv - robot.nc == 1
    for angle in (0.3, -0.5):  # a parallelogram: the coupler does not turn
        q = np.array([angle, -angle, angle])
        np.testing.assert_allclose(robot.constraint_residual(q), 0.0, atol=1e-12)
    assert np.abs(robot.constraint_residual(np.array([0.3, -0.2, 0.3]))).max() > 0.05
    assert load_stored(gather(robot.spec)).fingerprint == robot.fingerprint


def test_a_ball_joint_is_cut_and_a_joint_may_lead_to_its_parent(tmp_path: Path) -> None:
    swapped = FOUR_BAR.replace("KIND", "revolute").replace('name="b" type="revolute"', 'name="b" type="ball"')
    robot = load(tmp_path, swapped)
    assert robot.joint_names == ("a", "c", "d")
    assert (robot.constraints[0].name, robot.constraints[0].kind) == ("b", "point")
    np.testing.assert_allclose(robot.constraint_residual(np.array([0.3, 0.3, 0.3])), 0.0, atol=1e-12)


def test_what_closes_no_loop_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UnsupportedRobot, match=r"joint 'd' closes a loop and is prismatic; those that close"):
        load(tmp_path, FOUR_BAR.replace("KIND", "prismatic"))


def test_universal_ball_and_mimic_joints(tmp_path: Path) -> None:
    cardan = ARM.replace('name="slide" type="prismatic"', 'name="slide" type="universal"').replace(
        "</axis>\n      </joint>\n    </model>",
        "</axis><axis2><xyz>1 0 0</xyz></axis2>\n      </joint>\n    </model>",
    )
    robot = load(tmp_path, cardan)
    assert robot.joint_names == ("shoulder", "slide_1", "slide_2")
    assert load(tmp_path, ARM.replace('type="prismatic"', 'type="ball"')).nq == 5
    mimic = ARM.replace(
        "<axis><xyz>0 0 1</xyz>",
        '<axis><mimic joint="shoulder"><multiplier>0.5</multiplier><offset>0.1</offset>'
        "<reference>0.2</reference></mimic><xyz>0 0 1</xyz>",
    )
    coupling = load(tmp_path, mimic).constraints[0]
    assert (coupling.kind, coupling.facts["ratio"], coupling.facts["offset"]) == ("coupling", 0.5, 0.0)
    assert load(tmp_path, mimic, mimic=False).constraints == ()


def test_what_is_left_out_and_odd_is_told(tmp_path: Path) -> None:
    text = ARM.replace("<damping>0.4", "<spring_stiffness>2</spring_stiffness><damping>0.4")
    text = text.replace('<link name="upper">', '<link name="upper"><gravity>false</gravity>')
    with pytest.warns(NotModelledWarning, match=r"turned off for the links 'upper'; springs of joints 'sh"):
        load(tmp_path, text)
    mesh = "<mesh><uri>model://none/a.stl</uri></mesh>"
    text = ARM.replace("<box><size>0.1 0.1 0.4</size></box>", mesh).replace("<ixx>0.02", "<ixx>9")
    with pytest.warns(MissingMeshWarning, match="no package folder"), pytest.warns(ImpossibleInertiaWarning):
        load(tmp_path, text)
    odd = ARM.replace(INERTIAL.format(mass=4), "").replace("<lower>-1<", "<lower>3<")
    assert find_oddities(load(tmp_path, odd)) == (
        "link 'base': no <inertial>: it has 1 kg and 1 kg m^2 about each axis",
        "joint 'shoulder': its limits 3 ... 2 leave it no range",
    )


def test_a_shape_may_be_placed_in_another_frame(tmp_path: Path) -> None:
    shape = '<visual name="v"><pose relative_to="tool">0 0 0.1 0 0 0</pose>'
    robot = load(tmp_path, ARM.replace('<visual name="v">', shape))
    (shown,) = robot.visual_model.geometryObjects
    link = robot.model.frames[robot.frame_id("upper")].placement
    there = robot.frame_placement("tool", np.zeros(2), "upper") * pin.SE3(np.eye(3), np.array([0, 0, 0.1]))
    np.testing.assert_allclose((link * there).homogeneous, shown.placement.homogeneous, atol=1e-12)


def test_a_choice_within_a_mesh_is_told(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    mesh = "<mesh><uri>a.obj</uri><submesh><name>b</name></submesh></mesh>"
    text = ARM.replace("<box><size>0.1 0.1 0.4</size></box>", mesh)
    with pytest.warns(
        NotModelledWarning, match="<submesh>, in whose place stands the whole mesh, of 'upper'"
    ):
        load(tmp_path, text)


def test_shapes_that_are_not_modelled_are_told(tmp_path: Path) -> None:
    cone = '<collision name="c"><geometry><cone><radius>1</radius></cone></geometry></collision></link>'
    with pytest.warns(NotModelledWarning, match="shapes <cone>, neither drawn nor solid, of 'base'"):
        load(tmp_path, ARM.replace("</link>", cone, 1))


LOWER = '<pose degrees="true" relative_to="upper">0.1 0 0.4 0 30 0</pose>'
HAND = f"""
  <link name="lower"><pose>0 0 0.1 0 0 0.2</pose>{INERTIAL.format(mass=1)}
    <visual name="v"><geometry><mesh><uri>lower.obj</uri></mesh></geometry></visual></link>
  <link name="finger"><pose>0 0.1 0.3 0 0 0</pose>{INERTIAL.format(mass=0.5)}</link>
  <frame name="tool" attached_to="lower"><pose>0 0 0.2 0 0 0</pose></frame>
  <joint name="grip" type="revolute"><parent>lower</parent><child>finger</child>
    <axis><xyz expressed_in="__model__">0 1 1</xyz></axis></joint>"""


def _in_parts(tmp_path: Path, hand: str, inner: str, words: str = "", *, of: str = "") -> Robot:
    """The arm with a hand in a file of its own, in place of its lower link and the frame on it."""
    head, _, rest = ARM.partition('<link name="lower">')
    tail = rest[rest.index('<frame name="mark">') :].replace("<child>tool", f"<child>{of}tool")
    for name, text in (("robot.sdf", f"{head}{inner}{tail}"), ("models/hand/model.sdf", hand)):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text.replace("WORDS", words))
    (tmp_path / "models/hand/lower.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    return load_robot(tmp_path / "robot.sdf", package_dirs=[tmp_path / "models"])


@pytest.mark.parametrize("version", ["1.9", "1.4"])
@pytest.mark.parametrize("words", ['merge="true"', ""])
def test_models_within_a_model_are_parts_of_it(tmp_path: Path, words: str, version: str) -> None:
    inside = f'<frame name="hand">{LOWER}</frame>{HAND}'.replace("<pose>0 0", '<pose relative_to="hand">0 0')
    inside = inside.replace("<pose>0 0.1", '<pose relative_to="hand">0 0.1').replace("__model__", "hand")
    inside = inside.replace('<pose relative_to="hand">0 0 0.2 ', "<pose>0 0 0.2 ").replace(
        "lower.obj", "models/hand/lower.obj"
    )
    inside = inside.replace(
        INERTIAL.format(mass=1), INERTIAL.format(mass=1).replace(' relative_to="hand"', "")
    )
    whole = _in_parts(tmp_path / "whole", "", inside)
    hand = f'<sdf version="{version}"><model name="hand"><pose>9 9 9 0 0 0</pose>{HAND}</model></sdf>'
    hand = hand.replace(' expressed_in="__model__"', "") if version == "1.4" else hand
    include = f"<include WORDS><uri>hand</uri>{LOWER}</include>"
    of = "" if words else "hand::"
    robot = _in_parts(tmp_path / "parts", hand, include, words, of=of)
    assert robot.joint_names == ("shoulder", "slide", f"{of}grip")
    q, v = np.array([0.4, 0.1, 0.7]), np.array([1.0, -0.5, 0.3])
    np.testing.assert_allclose(_mass(robot.model, q), _mass(whole.model, q), rtol=1e-12, atol=1e-14)
    data = [each.model.createData() for each in (robot, whole)]
    forces = [pin.rnea(each.model, d, q, v, v) for each, d in zip((robot, whole), data, strict=True)]
    np.testing.assert_allclose(*forces, rtol=1e-12, atol=1e-13)
    for frame in ("tool", "finger"):
        ours, theirs = robot.frame_placement(f"{of}{frame}", q), whole.frame_placement(frame, q)
        np.testing.assert_allclose(ours.homogeneous, theirs.homogeneous, atol=1e-13)
    assert len(robot.visual_model.geometryObjects) == 2
    assert load_stored(gather(robot.spec)).fingerprint == robot.fingerprint


def test_included_models_are_found_where_gazebo_finds_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = '<sdf version="1.9"><include><uri>model://hand</uri></include></sdf>'
    monkeypatch.setenv("GZ_SIM_RESOURCE_PATH", str(tmp_path / "models"))
    (tmp_path / "models/hand").mkdir(parents=True)
    hand = HAND.replace("lower.obj", "model://hand/lower.obj")
    (tmp_path / "models/hand/model.sdf").write_text(
        f'<sdf version="1.9"><model name="h">{hand}</model></sdf>'
    )
    (tmp_path / "models/hand/lower.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (tmp_path / "other").mkdir()
    assert load(tmp_path / "other", text, free_flyer=False).joint_names == ("grip",)


def test_a_file_may_include_its_only_model(tmp_path: Path) -> None:
    load(tmp_path, ARM.replace('<model name="floor"><static>true</static><link name="floor"/></model>', ""))
    path = tmp_path / "other" / "robot.sdf"
    path.parent.mkdir()
    path.write_text('<sdf version="1.9"><include><uri>../robot.sdf</uri></include></sdf>')
    with pytest.raises(RobotFileError, match=r"there is no <model> in .*robot.sdf"):
        load_robot(path)  # that one has a world
    (tmp_path / "robot.sdf").write_text(
        f'<sdf version="1.9">{ARM[ARM.rindex("<model") : ARM.index("</world")]}</sdf>'
    )
    robot = load_robot(path)
    assert robot.joint_names == ("shoulder", "slide")
    np.testing.assert_allclose(robot.frame_placement("base", robot.q0).translation, [0.5, 0.0, 0.0])


ROTOR = """<link name="r{n}"><pose>{at} 0.05 0 0 0</pose><inertial><mass>0.02</mass>
  <inertia><ixx>1e-5</ixx><iyy>1e-5</iyy><izz>2e-5</izz></inertia></inertial></link>
<joint name="j{n}" type="revolute"><parent>body</parent><child>r{n}</child>
  <axis><xyz>0 0 1</xyz></axis></joint>
<plugin filename="gz-sim-multicopter-motor-model-system" name="m"><jointName>j{n}</jointName>
  <linkName>r{n}</linkName><turningDirection>{turn}</turningDirection><motorConstant>1e-5</motorConstant>
  <momentConstant>0.02</momentConstant><maxRotVelocity>1000</maxRotVelocity></plugin>"""
COPTER = """<link name="body"><inertial><mass>1.5</mass>
  <inertia><ixx>0.02</ixx><iyy>0.02</iyy><izz>0.03</izz></inertia></inertial></link>""" + "".join(
    ROTOR.format(n=n, at=at, turn=turn)
    for n, (at, turn) in enumerate(
        [("0.2 0.2", "ccw"), ("-0.2 -0.2", "ccw"), ("0.2 -0.2", "cw"), ("-0.2 0.2", "cw")]
    )
)


@pytest.mark.parametrize("of", ["", "c::"])
def test_rotors_of_multicopters_are_thrusters(tmp_path: Path, of: str) -> None:
    """They lift it, and turn it against those that turn faster."""
    inside = f'<model name="c">{COPTER}</model>' if of else COPTER
    robot = load(tmp_path, f'<sdf version="1.9"><model name="copter">{inside}</model></sdf>')
    assert robot.joint_names == ("root_joint",)
    np.testing.assert_allclose(robot.limits.effort, 10.0)
    np.testing.assert_allclose(robot.limits.effort_lower, 0.0)
    pushes = robot.actuation_matrix(robot.q0)  # force and moment on the body, in its axes
    np.testing.assert_allclose(pushes @ np.ones(4), [0.0, 0.0, 4.0, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(pushes @ [1.0, 1.0, -1.0, -1.0], [0.0] * 5 + [-4 * 0.02], atol=1e-12)


def test_up_to_1_6_joints_may_have_names_of_links(tmp_path: Path) -> None:
    """They are called as Gazebo calls them then, also where a plugin names them."""
    text = '<sdf version="1.6"><model name="copter">{}</model></sdf>'
    arm = BAR.format(name="arm", at="0 0 0", half="0 0 0.1") + PIN.format(
        name="arm", kind="revolute", at="0 0 0", parent="body", child="arm"
    )
    robot = load(tmp_path, text.format(COPTER.replace("j0", "r0") + arm))
    assert robot.joint_names == ("root_joint", "arm_joint")
    assert robot.nu == 5
    with pytest.raises(RobotFileError, match="the name 'arm' is given to more than one"):
        load(tmp_path, text.format(COPTER + arm).replace("1.6", "1.7"))


def test_forces_of_other_plugins_are_told(tmp_path: Path) -> None:
    text = ARM.replace(
        '<frame name="mark">', '<plugin filename="gz-sim-lift-drag-system"/><frame name="mark">'
    )
    with pytest.warns(NotModelledWarning, match="forces of plugins 'gz-sim-lift-drag-system'"):
        load(tmp_path, text)


def test_prefixes_need_no_declaration(tmp_path: Path) -> None:
    text = ARM.replace("<collision", '<drake:proximity a:b="1"/><collision')
    assert load(tmp_path, text).fingerprint == load(tmp_path / "..", ARM).fingerprint
    with pytest.raises(RobotFileError, match="malformed XML: mismatched tag"):
        load(tmp_path, text.replace("</world>", "</word>"))


BROKEN = {
    r"joint 'slide' is of type 'screw'; supported: revolute": ('type="prismatic"', 'type="screw"'),
    r"there is no link or frame 'tol': did you mean 'tool'": ("<child>tool", "<child>tol"),
    r"there is no link, joint or frame 'mrk'": ('relative_to="mark"', 'relative_to="mrk"'),
    r"the name 'upper' is given to more than one": ('<link name="lower"', '<link name="upper"'),
    r"joint 'shoulder' joins link 'upper' to itself": ("<parent>base", "<parent>upper"),
    r"joint 'shoulder': axis xyz is zero": ("0 1 1", "0 0 0"),
    r"link 'upper': pose is '0 0 0.05', expected 6 finite": ("0 0 0.05 0.1 0 0", "0 0 0.05"),
    r"placed in a circle: 'upper', 'shoulder', 'mark'": (
        "<pose>0 0 0.3",
        '<pose relative_to="shoulder">0 0 0.3',
    ),
    r"<include> 'model://hand': model://hand/model.sdf: no package folder 'hand' found": (
        "<frame",
        "<include><uri>model://hand</uri></include><frame",
    ),
    r"rotor 'j': its joint, its link 'upper' or its turning direction 'cw' is unknown": (
        "<frame",
        '<plugin filename="gz-sim-multicopter-motor-model-system"><jointName>j</jointName>'
        "<linkName>upper</linkName></plugin><frame",
    ),
    r"<include> 'https://a.org/hand' is in the network; download it": (
        "<frame",
        "<include><uri>https://a.org/hand</uri></include><frame",
    ),
    r"model 'hand' is within a model and has a placement_frame": (
        "<frame",
        '<model name="hand" placement_frame="a"><link name="a"/></model><frame',
    ),
    r"<include> has no <uri>: name there the model": ("<frame", "<include/><frame"),
    r"<include> 'robot.sdf' includes itself": ("<frame", "<include><uri>robot.sdf</uri></include><frame"),
    r"expected one model that is not static, got 'floor', 'arm'": ("<static>true</static>", ""),
    r"model 'arm': its pose is relative to 'table'": ("<pose>0.5", '<pose relative_to="table">0.5'),
    r"its version is 'new'": ('version="1.9"', 'version="new"'),
    r"its version is '1.99": ('version="1.9"', f'version="1.{"9" * 5000}"'),
    r"mass -4 kg": ("<mass>4", "<mass>-4"),
}


@pytest.mark.parametrize("message", BROKEN)
def test_what_is_wrong_is_told_by_name(tmp_path: Path, message: str) -> None:
    text = ARM.replace(*BROKEN[message], 1)
    with pytest.raises((RobotFileError, UnsupportedRobot), match=message):
        load(tmp_path, text)


def _mass(model: pin.Model, q: Array) -> Array:
    upper = np.triu(pin.crba(model, model.createData(), q))
    return upper + np.triu(upper, 1).T


def _urdf() -> str:
    """Return the arm as a URDF: links of its joints, and those of the SDF fixed to them."""

    def numbers(place: pin.SE3) -> str:
        xyz, rpy = (
            " ".join(map(repr, v.tolist())) for v in (place.translation, pin.rpy.matrixToRpy(place.rotation))
        )
        return f'<origin xyz="{xyz}" rpy="{rpy}"/>'

    def turn(r: float, p: float, y: float, at: tuple[float, float, float] = (0, 0, 0)) -> pin.SE3:
        return pin.SE3(pin.rpy.rpyToMatrix(r, p, y), np.array(at, dtype=float))

    def link(name: str, mass: float) -> str:
        place = numbers(turn(0.1, 0.2, 0.3, (0.01, 0.02, 0.1)))
        return (
            f'<link name="{name}"><inertial>{place}<mass value="{mass}"/><inertia ixx="0.02" iyy="0.03" '
            'izz="0.025" ixy="0.001" ixz="0.002" iyz="-0.003"/></inertial></link>'
        )

    def joint(name: str, kind: str, parent: str, child: str, at: pin.SE3, axis: str = "0 0 1") -> str:
        limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>'
        ends = f'<parent link="{parent}"/><child link="{child}"/>'
        return f'<joint name="{name}" type="{kind}">{ends}{numbers(at)}<axis xyz="{axis}"/>{limit}</joint>'

    empty = "".join(f'<link name="{name}"/>' for name in ("world", "at_shoulder", "at_slide", "tool"))
    upper, lower = turn(0.1, 0, 0, (0, 0, 0.05)), turn(0, np.radians(30), 0, (0.1, 0, 0.4))
    tool = turn(0, 0, 0, (0, 0, 0.2))
    at_slide = turn(0, 0, 0, (0.02, 0, 0))  # in the child, which is the frame tool
    return (
        f'<robot name="arm">{empty}{link("base", 4)}{link("upper", 2)}{link("lower", 1)}'
        + joint("mount", "fixed", "world", "base", turn(0, 0, 0.7, (0.5, 0, 0)))
        + joint("shoulder", "revolute", "base", "at_shoulder", turn(0, 0, 0, (0, 0, 0.3)), "0 1 1")
        + joint("fix_upper", "fixed", "at_shoulder", "upper", upper)
        + joint("slide", "prismatic", "upper", "at_slide", lower * tool * at_slide)
        + joint("fix_lower", "fixed", "at_slide", "lower", (tool * at_slide).inverse())
        + joint("fix_tool", "fixed", "lower", "tool", tool)
        + "</robot>"
    )

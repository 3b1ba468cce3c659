"""MJCF: the same numbers as Pinocchio's own reader and MuJoCo; what is left out is told by name."""

from __future__ import annotations

import struct
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from mbocp._arrays import Array
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.robot import Robot, gather, load_robot, load_stored
from mbocp.robot.loading.robot_formats import format_of
from mbocp.robot.robot_facts import find_oddities
from mbocp.robot.warnings import ImpossibleInertiaWarning, MissingMeshWarning, NotModelledWarning
from mbocp.view.meshcat.visuals import MeshLibrary

ARM = """<?xml version="1.0"?>
<!-- an arm -->
<mujoco model="arm">
  <compiler angle="degree" autolimits="true" eulerseq="XYZ"/>
  <option gravity="0 0 -9.8"/>
  <default>
    <joint damping="0.1" armature="0.01" axis="0 1 0"/>
    <geom density="500"/>
    <motor gear="2" ctrlrange="-3 3"/>
    <default class="wrist"><joint axis="1 1 0" damping="0.5"/></default>
  </default>
  <worldbody>
    <geom type="plane" size="1 1 1"/>
    <body name="base" pos="0 0 0.5" euler="0 0 30">
      <geom type="cylinder" size="0.1 0.05"/>
      <body name="upper" pos="0.1 0 0.2" axisangle="0 0 1 45">
        <joint name="shoulder" range="-90 90" pos="0 0.01 0.02"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.4" size="0.04"/>
        <geom type="box" size="0.02 0.03 0.04" pos="0.1 0 0.1" euler="10 20 30" mass="0.3"/>
        <body name="lower" pos="0 0 0.4" quat="1 0.2 0 0" childclass="wrist">
          <joint name="elbow" type="slide" axis="0 0 1" range="0 0.3"/>
          <joint name="wrist" ref="20"/>
          <joint name="twist" class="main" pos="0 0 0.1" axis="0 0 1"/>
          <inertial mass="1.2" pos="0.01 0.02 0.1" fullinertia="0.02 0.03 0.025 0.001 0.002 -0.003"/>
          <site name="tool" pos="0 0 0.3" zaxis="1 0 0"/>
          <geom type="sphere" size="0.05" contype="0" conaffinity="0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m" joint="shoulder"/>
    <position joint="elbow" kp="100" forcerange="-40 40"/>
    <motor joint="twist" gear="-0.5" ctrllimited="false"/>
  </actuator>
  <keyframe><key name="home" qpos="0.3 0.1 0.4 -0.2"/></keyframe>
</mujoco>
"""
BALL = """<mujoco model="ball">
  <worldbody>
    <body name="hull" pos="0 0 1" quat="0 0 0 1">
      <freejoint name="root"/>
      <geom type="sphere" size="0.2"/>
      <body name="pod" pos="0 0 -0.3">
        <joint name="ball" type="ball" damping="0.2" range="0 1"/>
        <geom type="sphere" size="0.1" pos="0 0 -0.2"/>
      </body>
    </body>
  </worldbody>
  <contact><exclude body1="hull" body2="pod"/></contact>
</mujoco>
"""
FOUR_BAR = """<mujoco model="four_bar">
  <compiler angle="radian"/>
  <worldbody>
    <body name="crank"><joint name="a" axis="0 -1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 1" size="0.02"/>
      <body name="coupler" pos="0 0 1"><joint name="b" axis="0 -1 0"/>
        <geom type="capsule" fromto="0 0 0 1 0 0" size="0.02"/>
      </body>
    </body>
    <body name="rocker" pos="1 0 0"><joint name="c" axis="0 -1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 1" size="0.02"/>
      <body name="wheel" pos="0.2 0 0"><joint name="d" axis="0 -1 0" ref="0.5"/>
        <geom type="sphere" size="0.1"/><site name="rim" pos="0.1 0 0"/>
      </body>
    </body>
  </worldbody>
  <equality>
    <connect name="pin" body1="coupler" body2="rocker" anchor="1 0 0"/>
    <joint name="gear" joint1="d" joint2="c" polycoef="0 -2 0 0 0"/>
  </equality>
  <actuator><motor joint="a" ctrlrange="0 5"/></actuator>
</mujoco>
"""


WELD = '<weld name="pin" body1="wheel" body2="rocker"/>'


FINGER = """<mujoco model="finger">
  <compiler angle="radian"/>
  <default><tendon armature="0.2"/><joint axis="0 1 0"/><geom size="0.04"/></default>
  <worldbody>
    <body name="proximal" pos="0 0 0.1">
      <joint name="mcp"/><geom type="capsule" fromto="0 0 0 0 0 0.4"/>
      <body name="distal" pos="0 0 0.4">
        <joint name="pip"/><geom type="capsule" fromto="0 0 0 0 0 0.3"/>
        <body name="tip" pos="0 0 0.3">
          <joint name="slide" type="slide" axis="0 0 1"/><geom type="sphere"/>
        </body>
      </body>
    </body>
  </worldbody>
  <tendon>
    <fixed name="flexor"><joint joint="mcp" coef="0.5"/><joint joint="pip" coef="-2"/></fixed>
    <fixed name="mixed" range="-1 1" stiffness="3">
      <joint joint="mcp" coef="0.1"/><joint joint="slide" coef="1"/>
    </fixed>
  </tendon>
  <actuator>
    <motor tendon="flexor" gear="-2" ctrlrange="-3 5"/>
    <position tendon="mixed" kp="10" forcerange="-2 4"/>
  </actuator>
</mujoco>"""


def load(tmp_path: Path, text: str, **options: Any) -> Robot:
    path = tmp_path / "robot.xml"
    path.write_text(text)
    return load_robot(path, **options)


def test_numbers_are_those_of_pinocchios_own_reader(tmp_path: Path) -> None:
    # Without what Pinocchio reads otherwise than MuJoCo: the placement of a fixed base, fromto, euler.
    text = ARM.replace('eulerseq="XYZ"', "").replace('euler="10 20 30"', "").replace("fromto", "pos_")
    text = text.replace('pos="0 0 0.5" euler="0 0 30"', "")
    text = text.replace('pos_="0 0 0 0 0 0.4" size="0.04"', 'pos="0 0 0.2" size="0.04 0.2"')
    for joint in ("wrist", "twist"):
        text = "\n".join(line for line in text.splitlines() if f'<joint name="{joint}"' not in line)
    text = "\n".join(line for line in text.splitlines() if "twist" not in line and "key name" not in line)
    robot = load(tmp_path, text)
    model = pin.buildModelFromMJCF(str(tmp_path / "robot.xml"))
    assert list(model.names) == list(robot.model.names)
    model.gravity.linear = robot.model.gravity.linear
    q, v, a = np.array([0.4, 0.1]), np.array([1.0, -0.5]), np.array([0.3, 2.0])
    ours, data = robot.model.createData(), model.createData()
    np.testing.assert_allclose(_mass(robot.model, q), _mass(model, q), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(
        pin.rnea(robot.model, ours, q, v, a), pin.rnea(model, data, q, v, a), rtol=1e-12, atol=1e-13
    )
    pin.framesForwardKinematics(robot.model, ours, q)
    pin.framesForwardKinematics(model, data, q)
    for frame in ("base", "upper", "lower", "tool"):
        there = data.oMf[model.getFrameId(frame)]
        np.testing.assert_allclose(ours.oMf[robot.frame_id(frame)].homogeneous, there.homogeneous, atol=1e-13)
    np.testing.assert_allclose(robot.model.armature, model.armature)


@pytest.mark.parametrize("text", [ARM, BALL, FOUR_BAR])
def test_numbers_are_those_of_mujoco(tmp_path: Path, text: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotModelledWarning)
        model = load(tmp_path, text).model
    theirs = mujoco.MjModel.from_xml_string(text)
    data, ours = mujoco.MjData(theirs), model.createData()
    rng = np.random.default_rng(3)
    mujoco.mj_integratePos(theirs, data.qpos, rng.normal(size=theirs.nv), 0.3)
    mujoco.mj_forward(theirs, data)
    full = np.zeros((theirs.nv, theirs.nv))
    mujoco.mj_fullM(theirs, data, full)
    q, turn = data.qpos.copy(), np.eye(theirs.nv)  # turn: v = turn @ qvel
    for j in range(1, model.njoints):
        at, count = model.joints[j].idx_q, model.joints[j].nq
        if count in (4, 7):
            q[at + count - 4 : at + count] = np.roll(q[at + count - 4 : at + count], -1)
        if count == 7:
            turn[:3, :3] = pin.Quaternion(q[3:7]).matrix().T
    np.testing.assert_allclose(turn.T @ _mass(model, q) @ turn, full, rtol=1e-9, atol=1e-12)
    still = np.zeros(model.nv)
    np.testing.assert_allclose(
        turn.T @ pin.rnea(model, ours, q, still, still), data.qfrc_bias, rtol=1e-9, atol=1e-10
    )
    for number in range(1, theirs.nbody):
        frame = ours.oMf[model.getFrameId(theirs.body(number).name, pin.BODY)]
        pin.framesForwardKinematics(model, ours, q)
        np.testing.assert_allclose(frame.translation, data.xpos[number], atol=1e-12)


@pytest.mark.parametrize("geoms", ['<geom type="sphere" size="0.1" group="4"/>', ""])
def test_bodies_without_geoms_that_count_have_what_inertial_says(tmp_path: Path, geoms: str) -> None:
    compiler = '<compiler inertiafromgeom="true" inertiagrouprange="0 2"/>'
    inertial = '<inertial pos="0 0 0.2" mass="0.7" diaginertia="0.1 0.2 0.25"/>'
    body = f'<body name="b"><joint name="j"/>{inertial}{geoms}</body>'
    text = f"<mujoco>{compiler}<worldbody>{body}</worldbody></mujoco>"
    inertia = load(tmp_path, text).model.inertias[1]
    assert inertia.mass == 0.7
    np.testing.assert_allclose(inertia.inertia, np.diag([0.1, 0.2, 0.25]))


def test_joints_motors_and_a_pose(tmp_path: Path) -> None:
    robot = load(tmp_path, ARM)
    assert format_of(tmp_path / "robot.xml").kind == "mjcf"
    assert robot.name == "arm"
    assert robot.joint_names == ("shoulder", "elbow", "wrist", "twist")
    assert [label.name for label in robot.u_labels] == ["shoulder", "elbow", "twist"]
    np.testing.assert_allclose(robot.limits.effort, [6.0, 80.0, np.inf])  # all actuators share defaults
    np.testing.assert_allclose(robot.limits.position_upper, [np.pi / 2, 0.3, np.inf, np.inf])
    np.testing.assert_allclose(robot.q0, [0.3, 0.1, 0.4, -0.2])
    np.testing.assert_allclose(robot.model.damping, [0.1, 0.5, 0.5, 0.1])
    np.testing.assert_allclose(robot.model.gravity.linear, [0.0, 0.0, -9.8])
    # A sphere of 500 kg/m^3, by hand: the mass of the base's cylinder is left at the world.
    assert robot.model.inertias[1].mass == pytest.approx(500 * np.pi * 0.04**2 * (0.4 + 4 / 3 * 0.04) + 0.3)
    # Where a joint is at its reference, the body is as it is written.
    robot = load(tmp_path, ARM.replace("<keyframe>", "<!--").replace("</keyframe>", "-->"))
    np.testing.assert_allclose(robot.q0, [0.0, 0.0, np.radians(20.0), 0.0])
    assert load(tmp_path, ARM, free_flyer=True).joint_names[0] == "root_joint"


def test_free_and_ball_joints(tmp_path: Path) -> None:
    with pytest.warns(NotModelledWarning, match="limits of the ball joints 'ball'"):
        robot = load(tmp_path, BALL)
    assert robot.joint_names == ("root_joint", "ball")
    np.testing.assert_allclose(robot.q0, [0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 1])
    assert robot.nu == 0
    with pytest.warns(NotModelledWarning):
        fixed = load(tmp_path, BALL, free_flyer=False)
    assert fixed.joint_names == ("ball",)
    assert frozenset(("hull", "pod")) in robot.shapes[0].disabled()
    with pytest.raises(UnsupportedRobot, match=r"body 'pod' has a free joint, but it hangs on 'hull'"):
        load(
            tmp_path,
            BALL.replace('<joint name="ball" type="ball" damping="0.2" range="0 1"/>', "<freejoint/>"),
        )


def test_equalities_close_loops_and_couple_joints(tmp_path: Path) -> None:
    robot = load(tmp_path, FOUR_BAR)
    assert [(c.name, c.kind) for c in robot.constraints] == [("pin", "point"), ("gear", "coupling")]
    assert (robot.nv, robot.nu) == (4, 1)
    gear = robot.constraints[1]
    assert (gear.facts["ratio"], gear.facts["offset"]) == (-2.0, 0.5)
    assert np.abs(robot.constraint_residual(robot.q0)).max() < 1e-9
    weld = FOUR_BAR.replace('<connect name="pin" body1="coupler" body2="rocker" anchor="1 0 0"/>', WELD)
    held = load(tmp_path, weld).constraints[0]
    assert held.kind == "weld"
    np.testing.assert_allclose(robot.q0, load(tmp_path, weld).q0, atol=1e-9)
    text = FOUR_BAR.replace('joint2="c" polycoef="0 -2 0 0 0"', 'polycoef="0.1 0 0 0 0"')
    held = load(tmp_path, text)
    assert held.joint_names == ("a", "b", "c")  # rigid at 0.6 rad, 0.1 beyond the wheel as it is written
    at, data = held.frame_id("rim"), held.model.createData()
    pin.framesForwardKinematics(held.model, data, np.zeros(3))
    turned = np.array([1.2, 0.0, 0.0]) + 0.1 * np.array([np.cos(0.1), 0.0, np.sin(0.1)])
    np.testing.assert_allclose(data.oMf[at].translation, turned, atol=1e-12)
    with pytest.warns(NotModelledWarning, match="equality of joints that is not linear 'gear'"):
        assert len(load(tmp_path, FOUR_BAR.replace("0 -2 0 0 0", "0 -2 1 0 0")).constraints) == 1
    with pytest.raises(RobotFileError, match=r"<connect> 'pin': there is no body 'rockr': did you mean"):
        load(tmp_path, FOUR_BAR.replace('body2="rocker"', 'body2="rockr"'))


def test_what_is_left_out_is_told_by_name(tmp_path: Path) -> None:
    text = ARM.replace('name="shoulder"', 'name="shoulder" stiffness="3"').replace(
        "</actuator>",
        '<motor name="pull" tendon="t"/></actuator>'
        '<tendon><spatial name="t"><site site="tip"/></spatial></tendon>',
    )
    with pytest.warns(NotModelledWarning) as caught:
        load(tmp_path, text)
    told = str(caught[0].message)
    for words in (
        r"springs (stiffness) of joints 'shoulder'",
        "actuators 'pull (on tendon t)'",
        "tendons 't'",
    ):
        assert words in told


def test_a_motor_pulls_at_several_joints_by_a_fixed_tendon(tmp_path: Path) -> None:
    warnings.simplefilter("ignore", NotModelledWarning)
    with pytest.warns(NotModelledWarning) as caught:
        robot = load(tmp_path, FINGER)
    assert str(caught[0].message).partition("left out: ")[2] == (
        "armature of fixed tendons 'flexor', 'mixed'; range of fixed tendons 'mixed'; "
        "stiffness of fixed tendons 'mixed'"
    )
    assert [(label.name, label.unit) for label in robot.u_labels] == [("flexor", "N m"), ("mixed", "N")]
    # MuJoCo 4.0's qfrc_actuator at ctrl = (1, -2) and at both ends of its controls: gear -2, kp 10.
    B = robot.actuation_matrix(robot.q0)
    np.testing.assert_allclose(B @ [-2.0, -2.0], [-1.2, 4.0, -2.0], atol=1e-15)
    np.testing.assert_allclose(B @ [robot.limits.effort[0], robot.limits.effort_lower[1]], [2.8, -12.0, -2.0])
    np.testing.assert_allclose(B @ [robot.limits.effort_lower[0], robot.limits.effort[1]], [-4.6, 20.0, 4.0])
    locked = load_robot(tmp_path / "robot.xml", lock=["mcp"])
    np.testing.assert_allclose(locked.actuation_matrix(locked.q0), [[-2.0, 0.0], [0.0, 1.0]])
    assert [label.name for label in load(tmp_path, FINGER.replace("mixed", "pip")).u_labels] == [
        *("flexor", "pip_tendon")
    ]
    with pytest.raises(RobotFileError, match=r"<joint>: there is no joint 'mpc': did you mean 'mcp'"):
        load(tmp_path, FINGER.replace('joint="mcp" coef="0.5"', 'joint="mpc" coef="0.5"'))


def test_thrusters_stand_on_sites(tmp_path: Path) -> None:
    text = BALL.replace(' range="0 1"', "").replace(
        "</mujoco>",
        '<actuator><motor name="up" site="nose" gear="0 0 2 0 0 0.1" ctrlrange="0 3"/></actuator></mujoco>',
    )
    text = text.replace('<freejoint name="root"/>', '<freejoint/><site name="nose" pos="0.1 0 0"/>')
    robot = load(tmp_path, text)
    assert [label.name for label in robot.u_labels] == ["up"]
    np.testing.assert_allclose(robot.limits.effort, [6.0])
    np.testing.assert_allclose(robot.limits.effort_lower, [0.0])  # it pushes, and never pulls
    wrench = robot.actuation_matrix(robot.q0)[:6, 0]
    np.testing.assert_allclose(wrench, [0, 0, 1, 0, -0.1, 0.05], atol=1e-15)


def test_meshes_have_masses_and_go_into_results(tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "cube.stl").write_bytes(_cube(0.5))
    (tmp_path / "arm.xml").write_text(
        '<mujoco model="block"><compiler meshdir="meshes"/><asset>'
        '<mesh file="cube.stl" scale="2 1 1"/></asset>'
        '<worldbody><include file="body.xml"/></worldbody></mujoco>'
    )
    (tmp_path / "body.xml").write_text(
        '<mujocoinclude><body name="block"><joint name="hinge" axis="1 0 0"/>'
        '<geom type="mesh" mesh="cube" pos="0 0 1"/></body></mujocoinclude>'
    )
    robot = load_robot(tmp_path / "arm.xml")
    mass = 1000 * 2.0 * 1.0 * 1.0
    assert robot.model.inertias[1].mass == pytest.approx(mass)
    np.testing.assert_allclose(robot.mass_matrix(robot.q0), [[mass * (2.0 / 12.0 + 1.0)]])
    files = gather(robot.spec)
    assert {Path(file.path).name for file in files.files} == {"arm.xml", "body.xml", "cube.stl"}
    again = load_stored(files)
    assert again.fingerprint == robot.fingerprint
    assert Path(again.visual_model.geometryObjects[0].meshPath).name == "cube.stl"
    (tmp_path / "meshes" / "cube.stl").unlink()
    with pytest.raises(
        RobotFileError, match=r"no <inertial>, and the mesh that its mass follows from cannot"
    ):
        load_robot(tmp_path / "arm.xml")
    (tmp_path / "body.xml").write_text(
        '<mujocoinclude><body name="block"><joint name="hinge" axis="1 0 0"/><geom type="mesh" mesh="cube"/>'
        '<inertial mass="1" diaginertia="1 1 3"/></body></mujocoinclude>'
    )
    with pytest.warns(MissingMeshWarning), pytest.warns(ImpossibleInertiaWarning, match="'hinge' moves"):
        load_robot(tmp_path / "arm.xml")


BROKEN = {
    r"<joint> 'shoulder': axis is zero": ('name="shoulder"', 'name="shoulder" axis="0 0 0"'),
    r"<joint> 'shoulder': range is '1', expected at least 2 finite": ('range="-90 90"', 'range="1"'),
    r"<joint> 'shoulder': unknown type 'screw'": ('name="shoulder"', 'name="shoulder" type="screw"'),
    r"<joint>: there is no class 'wrst'": ('name="shoulder"', 'name="shoulder" class="wrst"'),
    r"<geom>: size is '0.1', expected 2 positive": ('size="0.1 0.05"', 'size="0.1"'),
    r"<geom>: unknown type 'cone'": ('type="sphere" size="0.05"', 'type="cone"'),
    r"<key> 'home': qpos has 3 numbers, but the joints have 4": ("0.3 0.1 0.4 -0.2", "0.3 0.1 0.4"),
    r"body 'base' is defined more than once": ('name="upper"', 'name="base"'),
    r"<replicate> 'r' is not supported": ('<site name="tool"', '<replicate name="r"/><site name="tool"'),
    r"global coordinates are not supported": ("<compiler", '<compiler coordinate="global"'),
    r"mass is -1 kg": ('mass="1.2"', 'mass="-1"'),
    r"eulerseq is 'abc'": ('eulerseq="XYZ"', 'eulerseq="abc"'),
    r"other\.xml: no such file": ("<worldbody>", '<include file="other.xml"/><worldbody>'),
    r"robot\.xml: includes itself": ("<worldbody>", '<include file="robot.xml"/><worldbody>'),
    r"has no body": ("<mujoco", "<mujoco><worldbody/></mujoco><!--"),
}


@pytest.mark.parametrize("message", BROKEN)
def test_what_is_wrong_is_told_by_name(tmp_path: Path, message: str) -> None:
    text = ARM.replace(*BROKEN[message], 1) if "no body" not in message else "<mujoco><worldbody/></mujoco>"
    with pytest.raises((RobotFileError, UnsupportedRobot), match=message):
        load(tmp_path, text)


def test_oddities_are_told(tmp_path: Path) -> None:
    robot = load(tmp_path, ARM.replace('range="-90 90"', 'range="90 -90"'))
    assert find_oddities(robot) == ("joint 'shoulder': its limits 1.5708 ... -1.5708 leave it no range",)


def _mass(model: pin.Model, q: Array) -> Array:
    upper = np.triu(pin.crba(model, model.createData(), q))
    return upper + np.triu(upper, 1).T


def _cube(half: float) -> bytes:
    """Return a binary STL of a cube."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    rows = b"".join(struct.pack("<12fH", 0, 0, 0, *signs[list(face)].ravel().tolist(), 0) for face in faces)
    return b"\0" * 80 + struct.pack("<I", len(faces)) + rows


def test_ellipsoids_have_a_mass_and_are_told(tmp_path: Path) -> None:
    text = BALL.replace(' range="0 1"', "").replace(
        'type="sphere" size="0.1"', 'type="ellipsoid" size="1 2 3"'
    )
    with pytest.warns(NotModelledWarning, match="ellipsoids, neither drawn nor solid, of 'pod'"):
        robot = load(tmp_path, text)
    assert robot.model.inertias[2].mass == pytest.approx(1000 * 4 / 3 * np.pi * 6)


def test_a_missing_mesh_that_may_collide_is_no_hole(tmp_path: Path) -> None:
    text = BALL.replace(' range="0 1"', "").replace(
        "<worldbody>", '<asset><mesh file="a.stl"/></asset><worldbody>'
    )
    solid = text.replace("<site", "").replace("</body>", '<geom type="mesh" mesh="a" mass="0"/></body>', 1)
    with pytest.warns(MissingMeshWarning):
        robot = load(tmp_path, solid)
    with pytest.raises(RobotFileError, match=r"body 'pod': its mesh is missing: .*a\.stl does not exist"):
        list(robot.shapes[0].solid())


def test_a_robot_toml_adds_to_it(tmp_path: Path) -> None:
    (tmp_path / "robot.xml").write_text(FOUR_BAR)
    (tmp_path / "robot.toml").write_text(
        'urdf = "robot.xml"\n[[constraint]]\nname = "more"\ntype = "point"\nframes = ["crank", "world"]\n'
    )
    with pytest.raises(UnsupportedRobot, match="more"):  # it holds nothing that moves
        load_robot(tmp_path / "robot.toml")
    (tmp_path / "robot.toml").write_text('urdf = "robot.xml"\nname = "bar"\n[actuation]\njoints = ["c"]\n')
    robot = load_robot(tmp_path / "robot.toml")
    assert [c.name for c in robot.constraints] == ["pin", "gear"]
    assert [label.name for label in robot.u_labels] == ["c"]


def test_a_site_with_the_name_of_a_body_is_another_frame(tmp_path: Path) -> None:
    text = ARM.replace('<site name="tool"', '<site name="upper"')
    robot = load(tmp_path, text)
    assert robot.model.frames[robot.frame_id("upper")].type == pin.FrameType.BODY
    assert robot.model.frames[robot.frame_id("upper_site")].type == pin.FrameType.OP_FRAME


ONE = """<mujoco>
  <compiler COMPILER/>
  <default><joint range="0 10"/></default>
  <asset MESH/>
  <worldbody><body name="link"><joint name="j" JOINT/>GEOM</body></worldbody>
  <equality>EQUALITY</equality>
  <actuator>MOTORS</actuator>
</mujoco>
"""


def one(**parts: str) -> str:
    usual = {
        "COMPILER": "",
        "MESH": "",
        "JOINT": "",
        "GEOM": '<geom size="0.1"/>',
        "EQUALITY": "",
        "MOTORS": "",
    }
    text = ONE
    for word, part in (usual | parts).items():
        text = text.replace(word, part if word != "MESH" or not part else f"><mesh {part}/></asset><asset")
    return text


@pytest.mark.parametrize(
    ("message", "parts"),
    [
        (
            "<compiler>: settotalmass is 5, but no body has a mass",
            {"COMPILER": 'settotalmass="5"', "GEOM": ""},
        ),
        ("<joint>: there is no joint ''", {"EQUALITY": '<joint joint2="j"/>'}),
        ("<mesh>: refpos and refquat are not supported", {"MESH": 'file="a.stl" refpos="1 0 0"'}),
        (
            "frame 's' is defined more than once",
            {"GEOM": '<geom size="0.1"/><site name="s"/><site name="s" pos="0 0 1"/>'},
        ),
    ],
)
def test_what_cannot_be_is_refused_by_name(tmp_path: Path, message: str, parts: dict[str, str]) -> None:
    with pytest.raises(RobotFileError, match=message):
        load(tmp_path, one(**parts))


@pytest.mark.parametrize(
    ("message", "parts"),
    [
        (
            "equality of joints that is not linear 'e'",
            {"JOINT": 'type="ball" limited="false"', "EQUALITY": '<joint name="e" joint1="j"/>'},
        ),
        (r"actuators 'm \(on joint j\)'", {"MOTORS": '<motor name="m" joint="j" gear="0"/>'}),
        (r"actuators 'm \(on joint j\)'", {"MOTORS": '<damper name="m" joint="j" kv="1" ctrlrange="0 1"/>'}),
    ],
)
def test_what_says_nothing_of_a_joint_is_told(tmp_path: Path, message: str, parts: dict[str, str]) -> None:
    with pytest.warns(NotModelledWarning, match=message):
        assert load(tmp_path, one(**parts)).joint_names == ("j",)


def test_the_limit_of_a_joint_bounds_its_motors_together(tmp_path: Path) -> None:
    motors = '<motor joint="j" ctrlrange="-20 20"/><motor joint="j" gear="2" ctrlrange="-10 10"/>'
    assert load(tmp_path, one(MOTORS=motors)).limits.effort == [40.0]
    bounded = load(tmp_path, one(MOTORS=motors, JOINT='actuatorfrcrange="-5 30"')).limits
    assert (bounded.effort_lower, bounded.effort) == ([-5.0], [30.0])


@pytest.mark.parametrize(
    ("motor", "lower", "upper"),
    [
        ('<motor joint="j" ctrlrange="0 20"/>', 0.0, 20.0),
        ('<motor joint="j" gear="-2" ctrlrange="-1 20"/>', -40.0, 2.0),
        ('<motor joint="j" ctrlrange="-5 20" forcerange="-8 10"/>', -5.0, 10.0),
        ('<general joint="j" gainprm="-3" ctrlrange="0 2"/>', -6.0, 0.0),
        ('<position joint="j" kp="9" ctrlrange="0 1" forcerange="-7 7"/>', -7.0, 7.0),
        ('<motor joint="j"/>', -np.inf, np.inf),
    ],
)
def test_motors_that_push_more_than_they_pull(tmp_path: Path, motor: str, lower: float, upper: float) -> None:
    limits = load(tmp_path, one(MOTORS=motor)).limits
    assert (limits.effort_lower, limits.effort) == ([lower], [upper])


def test_a_free_joint_has_no_limits_that_could_be_left_out(tmp_path: Path) -> None:
    assert load(tmp_path, one(JOINT='type="free"')).joint_names == ("root_joint",)


def test_a_box_between_two_points_is_turned_as_mujoco_turns_it(tmp_path: Path) -> None:
    robot = load(tmp_path, one(GEOM='<geom type="box" size="0.1" fromto="0 0 0 0.3 0.4 0.5"/>'))
    place = robot.visual_model.geometryObjects[0].placement
    theirs = pin.Quaternion(0.38268343236509, 0.73910363246021, -0.55432772434516, 0.0)  # of MuJoCo 3.3.7
    np.testing.assert_allclose(place.rotation, theirs.matrix(), atol=1e-7)
    np.testing.assert_allclose(place.translation, [0.15, 0.2, 0.25])


def test_an_open_mesh_has_the_inertia_that_mujoco_gives_it(tmp_path: Path) -> None:
    mujoco = pytest.importorskip("mujoco")
    (tmp_path / "open.stl").write_bytes(_without_a_face(_cube(0.5)))
    text = one(MESH='file="open.stl" scale="2 1 0.5"', GEOM='<geom type="mesh" mesh="open"/>')
    ours = load(tmp_path, text).model.inertias[1]
    theirs = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, theirs.body_iquat[1])
    turn = turn.reshape(3, 3)
    assert ours.mass == pytest.approx(theirs.body_mass[1], rel=1e-6)
    np.testing.assert_allclose(ours.lever, theirs.body_ipos[1], atol=1e-6)
    np.testing.assert_allclose(
        ours.inertia, turn @ np.diag(theirs.body_inertia[1]) @ turn.T, rtol=1e-5, atol=1e-4
    )


@pytest.mark.parametrize("ends", ['body1="link" body2="hand"', 'site1="s" site2="at hand"'])
def test_what_holds_on_to_a_mocap_body_is_left_out(tmp_path: Path, ends: str) -> None:
    hand = '<body name="hand" mocap="true"><site name="at hand"/></body><body name="link"'
    parts = {"GEOM": '<geom size="0.1"/><site name="s"/>', "EQUALITY": f'<weld name="drag" {ends}/>'}
    with pytest.warns(NotModelledWarning, match="what holds on to mocap bodies, which others move 'drag'"):
        robot = load(tmp_path, one(**parts).replace('<body name="link"', hand))
    assert robot.nc == 0


def test_a_joint_that_its_damping_holds_is_rigid(tmp_path: Path) -> None:
    text = one().replace(
        '<geom size="0.1"/>', '<geom size="0.1"/><joint name="s" type="slide" damping="1e7"/>'
    )
    with pytest.warns(NotModelledWarning, match=r"motion against a damping of 1e\+06 or more of joints 's'"):
        assert load(tmp_path, text).joint_names == ("j",)


@pytest.mark.parametrize("face", ["", ' face="0 2 1 0 1 3 1 2 3 0 3 2"'])
def test_a_mesh_may_be_written_in_the_file(tmp_path: Path, face: str) -> None:
    """A corner of a box: of the moments about its middle, of the drawing, and of what a result has of it."""
    written = f'name="wedge" scale="2 1 1" vertex="0 0 0  1 0 0  0 1 0  0 0 1"{face}'
    robot = load(tmp_path, one(MESH=written, GEOM='<geom type="mesh" mesh="wedge" pos="0 0 1"/>'))
    body = robot.model.inertias[1]
    assert body.mass == pytest.approx(1000.0 * 2.0 / 6.0)
    np.testing.assert_allclose(body.lever, [0.5, 0.25, 1.25], atol=1e-12)
    np.testing.assert_allclose(np.diag(body.inertia), body.mass * 3.0 / 80.0 * np.array([2.0, 5.0, 5.0]))
    (drawn,) = robot.visual_model.geometryObjects
    assert "geometries" in MeshLibrary(robot).draw(drawn)
    np.testing.assert_allclose(MeshLibrary(robot).corners(drawn).max(axis=0), [2.0, 1.0, 2.0])
    files = gather(robot.spec)
    assert len(files.files) == 1
    assert load_stored(files).fingerprint == robot.fingerprint
    wrong = one(MESH=written.replace("0 0 1", "0 0"), GEOM="")
    with pytest.raises(RobotFileError, match="<mesh> 'wedge': vertex has three numbers for each corner"):
        load(tmp_path, wrong)


def _without_a_face(stl: bytes) -> bytes:
    """Return an STL without its last triangle."""
    (count,) = struct.unpack("<I", stl[80:84])
    return stl[:80] + struct.pack("<I", count - 1) + stl[84:-50]

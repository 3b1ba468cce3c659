"""robot.toml: what it says, and each way of saying it wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbocp._text import MAX_MESSAGE
from mbocp.exceptions import (
    DimensionMismatch,
    InvalidValue,
    RobotFileError,
    UnknownFrame,
    UnknownJoint,
    UnsupportedRobot,
)
from mbocp.problem import Problem
from mbocp.robot import QuarticSpring, Robot, Rod, load_robot, robot_from_spec
from tests.robot import urdfs

EXAMPLES = Path(__file__).parents[3] / "examples"
URDF = urdfs.chain("revolute", "revolute", "revolute", name="from_urdf")
DRONE = urdfs.robot(
    urdfs.link("body"),
    urdfs.link("rotor"),
    urdfs.joint("mount", "fixed", "body", "rotor"),
    urdfs.link("arm"),
    urdfs.joint("shoulder", "revolute", "body", "arm"),
)


def load(folder: Path, toml: str, urdf: str = URDF, **options: object) -> Robot:
    return load_robot(urdfs.write(folder, urdf, toml), **options)  # type: ignore[arg-type]


def test_an_empty_file_is_the_urdf_alone(tmp_path: Path) -> None:
    robot = load(tmp_path / "folder_name", "")
    assert robot.name == "folder_name"
    assert (robot.nv, robot.nu, robot.nc, robot.forces, robot.connectors) == (3, 3, 0, (), ())
    assert robot.trace_frames == ("l3",)
    assert load_robot(tmp_path / "folder_name" / "robot.urdf").name == "from_urdf"


def test_the_urdf_of_a_robot_by_name(tmp_path: Path) -> None:
    """With its meshes, or a warning were an error; base and pose are those of this file."""
    (tmp_path / "robot.toml").write_text('name = "pendulum"\nurdf = "double_pendulum"\n')
    robot, by_name = load_robot(tmp_path), load_robot("double_pendulum")
    assert robot.joint_names == by_name.joint_names
    assert robot.source == by_name.source
    assert [g.meshPath for g in robot.visual_model.geometryObjects] == [
        g.meshPath for g in by_name.visual_model.geometryObjects
    ]
    (tmp_path / "robot.toml").write_text('urdf = "talos_legs"\n')
    with pytest.raises(UnsupportedRobot, match="built by code of example-robot-data"):
        load_robot(tmp_path)


def test_rotors_push_where_they_are_and_twist_the_body_against_their_turn() -> None:
    """Places and senses of rotation as the URDF of the Iris and the names of its propellers have them."""
    robot = load_robot(EXAMPLES / "free_flyer/robots/quadrotor")
    x, y, turns = (0.13, -0.13, 0.13, -0.13), (-0.22, 0.2, 0.22, -0.2), (1, 1, -1, -1)
    columns = [
        [0, 0, 1, yi, -xi, -0.016 * turn] for xi, yi, turn in zip(x, y, turns, strict=True)
    ]  # at the origin of the body
    np.testing.assert_allclose(robot.actuation.selection, np.transpose(columns), atol=1e-15)
    shapes = [Path(g.meshPath).stem for g in robot.visual_model.geometryObjects if "rotor" in g.name]
    assert shapes == ["iris_prop_ccw" if turn > 0 else "iris_prop_cw" for turn in turns]


def test_what_it_says(tmp_path: Path) -> None:
    robot = load(
        tmp_path,
        """
        name = "walker"
        description = "A test."
        free_flyer = true
        gravity = [0, 0, -1.62]
        lock = { j3 = 0.3 }
        trace = ["l2", "base"]
        [actuation]
        joints = ["j2"]
        [initial]
        q = { root_joint = [0, 0, 1, 0, 0, 0, 1], j1 = 0.2 }
        """,
    )
    assert (robot.name, robot.description) == ("walker", "A test.")
    assert (robot.nv, robot.nu) == (8, 1)
    assert robot.model.gravity.linear[2] == -1.62
    assert robot.trace_frames == ("l2", "base")
    np.testing.assert_array_equal(robot.q0, [0, 0, 1, 0, 0, 0, 1, 0.2, 0])


def test_options_win_over_the_file(tmp_path: Path) -> None:
    toml = (
        'name = "a"\nfree_flyer = true\ngravity = [0, 0, -1]\nlock = ["j1"]\n[actuation]\njoints = ["j2"]\n'
    )
    toml += "[initial]\nq = [0, 0, 1, 0, 0, 0, 1, 0.1, 0.2, 0.3]\n"
    robot = load(tmp_path, toml, free_flyer=False, gravity=(0, 0, -2), lock=["j3"], actuated=["j1"], name="b")
    assert robot.name == "b"
    assert robot.joint_names == ("j1", "j2")
    assert robot.model.gravity.linear[2] == -2
    assert [u.name for u in robot.u_labels] == ["j1"]
    np.testing.assert_array_equal(robot.q0, [0.1, 0.2])
    np.testing.assert_array_equal(load_robot(tmp_path, lock=[]).q0, [0, 0, 1, 0, 0, 0, 1, 0.1, 0.2, 0.3])


def test_an_added_free_flyer_starts_at_the_origin(tmp_path: Path) -> None:
    robot = load(tmp_path, "[initial]\nq = [0.1, 0.2, 0.3]\n", free_flyer=True)
    np.testing.assert_array_equal(robot.q0, [0, 0, 0, 0, 0, 0, 1, 0.1, 0.2, 0.3])


def test_locked_joints_lose_their_motor(tmp_path: Path) -> None:
    robot = load(tmp_path, '[actuation]\njoints = ["j1", "j2"]\n', lock=["j1"])
    assert [u.name for u in robot.u_labels] == ["j2"]


def test_actuators(tmp_path: Path) -> None:
    robot = load(
        tmp_path,
        """
        free_flyer = true
        [[actuator]]
        type = "joint"
        joint = "shoulder"
        effort = 7.5
        [[actuator]]
        type = "thruster"
        name = "front"
        frame = "rotor"
        axis = [0, 0, 2]
        torque_ratio = -0.02
        effort = [0.0, "9 N"]
        [[actuator]]
        type = "wrench"
        frame = "arm"
        components = ["mz", "fx"]
        effort = [1.0, 2.0]
        """,
        DRONE,
    )
    assert [str(u) for u in robot.u_labels] == ["shoulder [N m]", "front [N]", "arm.mz [N m]", "arm.fx [N]"]
    np.testing.assert_array_equal(robot.limits.effort, [7.5, 9.0, 1.0, 2.0])
    np.testing.assert_array_equal(robot.limits.effort_lower, [-7.5, 0.0, -1.0, -2.0])
    bounds = Problem.create(robot, 1.0, 5, goal={"v": 0}, limits={"effort": True}).limits
    np.testing.assert_array_equal(bounds.u_lower, robot.limits.effort_lower)
    np.testing.assert_array_equal(bounds.u_upper, robot.limits.effort)
    # The rotor sits on the free-flyer's own body: a constant column. The arm turns against it.
    assert robot.actuation.selection.shape == (7, 2)
    assert [a.name for a in robot.actuation.frame_actuators] == ["arm.mz", "arm.fx"]
    placement = robot.model.frames[robot.frame_id("rotor")].placement
    thrust = placement.rotation[:, 2]
    moment = np.cross(placement.translation, thrust) - 0.02 * thrust
    np.testing.assert_allclose(robot.actuation.selection[:, 1], [*thrust, *moment, 0], atol=1e-15)
    q = robot.integrate(robot.q0, np.arange(7.0))
    np.testing.assert_allclose(robot.actuation_matrix(q)[:, :2], robot.actuation.selection)


def test_a_force_on_what_only_slides_is_constant(tmp_path: Path) -> None:
    toml = (
        '[actuation]\njoints = []\n[[actuator]]\ntype = "wrench"\nframe = "l2"\ncomponents = ["fx", "my"]\n'
    )
    robot = load(tmp_path, toml, urdfs.chain("prismatic", "prismatic"))
    assert robot.actuation.is_constant
    assert [str(u) for u in robot.u_labels] == ["l2.fx [N]", "l2.my [N m]"]
    np.testing.assert_array_equal(robot.actuation.selection[:, 1], [0, 0])
    assert np.isinf(robot.limits.effort).all()


def test_a_thruster_at_a_position(tmp_path: Path) -> None:
    toml = 'free_flyer = true\n[[actuator]]\ntype = "thruster"\nframe = "body"\nposition = [0.2, 0, 0]\n'
    robot = load(tmp_path, toml, DRONE, lock=["shoulder"])
    np.testing.assert_allclose(robot.actuation.selection, np.array([[0, 0, 1, 0, -0.2, 0]]).T)


TENDON = """
[actuation]
joints = ["j3"]
[[actuator]]
type = "tendon"
name = "pull"
joints = ["j1", "j2"]
ratios = [1.0, -0.5]
effort = [-2.0, 3.0]
"""


def test_a_tendon_is_one_control_of_several_joints(tmp_path: Path) -> None:
    robot = load(tmp_path, TENDON)
    assert [str(u) for u in robot.u_labels] == ["j3 [N m]", "pull [N m]"]
    np.testing.assert_array_equal(robot.actuation.selection, [[0, 1], [0, -0.5], [1, 0]])
    np.testing.assert_array_equal((robot.limits.effort_lower[1], robot.limits.effort[1]), (-2, 3))
    assert [u.name for u in load_robot(tmp_path, lock=["j1", "j2"]).u_labels] == ["j3"]
    np.testing.assert_array_equal(load_robot(tmp_path, lock=["j1"]).actuation.selection, [[0, -0.5], [1, 0]])
    part = robot_from_spec({"part": [{"name": "a", "robot": str(tmp_path)}]})
    np.testing.assert_array_equal(part.actuation.selection, robot.actuation.selection)
    assert [u.name for u in part.u_labels] == ["a/j3", "a/pull"]
    elastic = load(tmp_path, TENDON + '[[elastic]]\njoint = "j2"\nstiffness = 9.0\nmotor_inertia = 1.0\n')
    np.testing.assert_array_equal(elastic.actuation.selection, [[0, 1], [0, 0], [1, 0], [0, -0.5]])


def test_lengths_default_to_the_initial_pose(tmp_path: Path) -> None:
    pair = 'frames = ["l3", "base"]\n'
    toml = f'[[constraint]]\ntype = "rod"\n{pair}[[spring]]\nstiffness = 0.6\n{pair}'
    toml += f"[[spring_damper]]\nstiffness = 1\n{pair}"
    robot = load(tmp_path, toml)
    (rod,), (quartic, linear) = robot.constraints, robot.forces
    assert isinstance(quartic, QuarticSpring)
    assert rod.length == pytest.approx(quartic.length) == pytest.approx(linear.length)
    assert quartic.coefficient == pytest.approx(0.6 / (2 * rod.length**2))
    assert (rod.name, quartic.name, linear.name) == ("rod_0", "spring_0", "spring_damper_0")
    np.testing.assert_allclose(robot.constraint_residual(robot.q0), [0], atol=1e-15)
    np.testing.assert_allclose(robot.force_elements(robot.q0, np.ones(3)), np.zeros(3), atol=1e-12)


def test_ends_of_a_spring_that_meet_push_nowhere(tmp_path: Path) -> None:
    toml = '[[spring_damper]]\nstiffness = 3\ndamping = 2\nlength = 0.3\nframes = ["l1", "base"]\n'
    robot = load(tmp_path, toml, urdfs.chain("prismatic").replace('xyz="0.3 0 0.1"', 'xyz="0 0 0"'))
    np.testing.assert_array_equal(robot.force_elements(robot.q0, np.ones(1)), [0.0])


def test_connectors(tmp_path: Path) -> None:
    toml = """
    [[constraint]]
    type = "rod"
    frames = ["l3", "base"]
    [[spring_damper]]
    frames = ["l3", "l1"]
    stiffness = 1.0
    [[visual]]
    type = "none"
    frames = ["base", "l3"]
    [[visual]]
    type = "line"
    frames = ["l1", "world"]
    radius = 0.3
    color = [1, 0, 0]
    """
    robot = load(tmp_path, toml)
    assert [(c.kind, c.radius) for c in robot.connectors] == [("spring", 0.06), ("line", 0.3)]
    assert robot.connectors[1].color == (1, 0, 0, 1)
    assert robot.connectors[1].frame_b == 0


WRONG = {
    r"malformed TOML: .*line 2": "gravity = [0]\nname = nobody",
    r"malformed TOML: lists or tables are nested more than 64 deep": "x = " + "[" * 5000 + "]" * 5000,
    r"malformed TOML: an integer that does not fit into 64 bits": "gravity = [0, 0, " + "9" * 5000 + "]",
    r"malformed TOML: gravity\[2\]: got an integer of about 401": "gravity = [0, 0, 1" + "0" * 400 + "]",
    r"free_flyer: got \[\[0, 0, 0, 0, 0, .{1,100}": f"free_flyer = [{[0] * 10000}]",
    r"has 5\.0 MB, expected a robot\.toml of at most 4 MB": "#" * (5 * 2**20),
    r"urdf: .*name too long|urdf: .*does not exist": f'urdf = "{"x" * 5000}"',
    r"urdf: .*does not exist": 'urdf = "a\\u0000b.urdf"',
    r"name: must not have control characters": 'name = "\\u001b[2J"',
    r"urdff: unknown key; did you mean 'urdf'\?": 'urdff = "a.urdf"',
    r"gravity\[2\]: this number is missing": "gravity = [0, 0]",
    r"gravity\[2\]: got nan: Input should be a finite number": "gravity = [0, 0, nan]",
    r"free_flyer: got 'perhaps'": 'free_flyer = "perhaps"',
    r"actuation\.motors: unknown key; valid names: joints": "[actuation]\nmotors = []",
    r"constraint\[0\]: type is required: type": '[[constraint]]\nframes = ["l1", "l2"]',
    r"constraint\[0\]: unknown type 'ball', known: rod, point, hinge, weld, plane, line, coupling, screw": (
        '[[constraint]]\ntype = "ball"\nframes = ["l1", "l2"]'
    ),
    r"constraint\[0\]\.frames: this key is required": '[[constraint]]\ntype = "rod"',
    r"constraint\[0\]\.length: got -1": '[[constraint]]\ntype = "rod"\nframes = ["l1", "l2"]\nlength = -1',
    r"constraint\[0\]: frames must be two different frames, got 'l1' twice": (
        '[[constraint]]\ntype = "rod"\nframes = ["l1", "l1"]'
    ),
    r"constraint\[0\]\.lenght: unknown key; did you mean 'length'": (
        '[[constraint]]\ntype = "rod"\nframes = ["l1", "l2"]\nlenght = 1'
    ),
    r"constraint: the name 'a' is given twice": (
        2 * '[[constraint]]\ntype = "rod"\nname = "a"\nframes = ["l3", "world"]\n'
    ),
    r"spring\[0\]: give either stiffness k .* or coefficient c": '[[spring]]\nframes = ["l1", "l2"]',
    r"spring\[0\]\.type: got 'cubic', expected \"quartic\"": (
        '[[spring]]\ntype = "cubic"\nframes = ["l1", "l2"]\nstiffness = 1'
    ),
    r"spring\[0\]\.length: got 1e-200 m, expected at least 1e-09 m": (
        '[[spring]]\nframes = ["l1", "l2"]\nstiffness = 1\nlength = 1e-200'
    ),
    r"spring_damper\[0\]\.coefficient: unknown key; valid names: name, frames, stiffness, damping, length": (
        '[[spring_damper]]\nframes = ["l1", "l2"]\ncoefficient = 1'
    ),
    "spring_dampers: unknown key; did you mean 'spring_damper'": (
        '[[spring_dampers]]\nframes = ["l1", "l2"]\nstiffness = 1'
    ),
    "actuators: unknown key; did you mean 'actuator'": '[[actuators]]\ntype = "joint"\njoint = "j1"',
    r"spring_damper\[0\]\.damping: got -1": '[[spring_damper]]\nframes = ["l1", "l2"]\ndamping = -1',
    r"actuator\[0\]: unknown type 'motor', known: joint, wrench, thruster, t": '[[actuator]]\ntype = "motor"',
    r"actuator\[0\]: type is required": '[[actuator]]\njoint = "j1"',
    r"constraint\[0\]\.length: got 1e\+160: .*less than or equal": (
        '[[constraint]]\ntype = "rod"\nframes = ["l1", "l2"]\nlength = 1e160'
    ),
    r"actuator\[0\]\.axis: must not be zero": (
        '[[actuator]]\ntype = "thruster"\nframe = "l1"\naxis = [0, 0, 0]'
    ),
    r"actuator\[0\]\.effort: got \[8\.0, 0\.0\], expected \[lower, upper\] with lower < upper": (
        '[[actuator]]\ntype = "thruster"\nframe = "l1"\neffort = [8, 0]'
    ),
    r"actuator\[0\]: effort has 2 numbers for 1 components": (
        '[[actuator]]\ntype = "wrench"\nframe = "l1"\ncomponents = ["fx"]\neffort = [1, 2]'
    ),
    r"actuator\[0\]: components are repeated": (
        '[[actuator]]\ntype = "wrench"\nframe = "l1"\ncomponents = ["fx", "fx"]'
    ),
    r"actuator\[0\]\.components\[0\]: got 'ft', expected \"fx\" \| \"fy\"": (
        '[[actuator]]\ntype = "wrench"\nframe = "l1"\ncomponents = ["ft"]'
    ),
    r"actuator\[0\]\.torque: unknown key; did you mean 'torque_ratio'": (
        '[[actuator]]\ntype = "thruster"\nframe = "l1"\ntorque = 1'
    ),
    r"actuator\[0\]\.frame: frame 'base' is fixed to the world": (
        '[[actuator]]\ntype = "wrench"\nframe = "base"'
    ),
    r"actuator: the name 'l1.fx' is given twice": 2 * '[[actuator]]\ntype = "wrench"\nframe = "l1"\n',
    r"actuator\[0\]: joints: 'j1' is named twice": TENDON.replace('"j2"', '"j1"'),
    r"actuator\[0\]: ratios has 1 numbers for 2 joints": TENDON.replace("[1.0, -0.5]", "[1.0]"),
    r"actuator\[0\]\.name: 'j2' is the name of a joint": TENDON.replace('"pull"', '"j2"'),
    r"visual\[0\]\.type: got 'arrow', expected \"rod\" \| \"spring\"": (
        '[[visual]]\ntype = "arrow"\nframes = ["l1", "l2"]'
    ),
    r"visual\[0\]\.color": '[[visual]]\ntype = "rod"\nframes = ["l1", "l2"]\ncolor = [1, 2, 3]',
    r"urdf: .*other\.urdf does not exist": 'urdf = "other.urdf"',
    r"urdf: package://nowhere/a\.urdf: no package folder 'nowhere' found, name its parent in package_dirs": (
        'urdf = "package://nowhere/a.urdf"'
    ),
    r"constraint\[0\]: frames 'base' and 'world' are on the same rigid body": (
        '[[constraint]]\ntype = "rod"\nframes = ["base", "world"]'
    ),
}


@pytest.mark.parametrize("message", WRONG)
def test_wrong_files_are_refused_with_file_and_key(tmp_path: Path, message: str) -> None:
    with pytest.raises(RobotFileError, match=message) as refused:
        load(tmp_path, WRONG[message])
    assert len(str(refused.value)) <= MAX_MESSAGE
    assert refused.value.path == tmp_path / "robot.toml"
    assert str(tmp_path / "robot.toml") in str(refused.value)


def test_frames_that_coincide_need_a_length(tmp_path: Path) -> None:
    urdf = urdfs.robot(
        urdfs.link("base"),
        urdfs.link("l1"),
        urdfs.joint("j1", "prismatic", "base", "l1").replace('xyz="0.3 0 0.1"', 'xyz="0 0 0"'),
    )
    for kind, extra in (("constraint", 'type = "rod"'), ("spring", "stiffness = 1")):
        with pytest.raises(RobotFileError, match=rf"{kind}\[0\]\.length: not given, and the frames coincide"):
            load(tmp_path, f'[[{kind}]]\n{extra}\nframes = ["l1", "world"]\n', urdf)


NAMES = {
    "no frame 'l9'": (UnknownFrame, '[[constraint]]\ntype = "rod"\nframes = ["l9", "world"]'),
    "no frame 'tip'": (UnknownFrame, 'trace = ["tip"]'),
    "no frame 'nose'": (UnknownFrame, '[[actuator]]\ntype = "thruster"\nframe = "nose"'),
    "no joint 'j9': valid names: j1, j2, j3": (UnknownJoint, '[actuation]\njoints = ["j9"]'),
    "no joint 'j8'": (UnknownJoint, 'lock = ["j8"]'),
    "no joint 'j7'": (UnknownJoint, "[initial]\nq = { j7 = 0.0 }"),
    r"initial\.q: got shape \(2,\), expected \(3,\)": (DimensionMismatch, "[initial]\nq = [0.0, 0.0]"),
}


@pytest.mark.parametrize("message", NAMES)
def test_unknown_names(tmp_path: Path, message: str) -> None:
    error, toml = NAMES[message]
    with pytest.raises(error, match=message):
        load(tmp_path, toml)


def test_a_zero_quaternion_in_the_initial_pose(tmp_path: Path) -> None:
    with pytest.raises(InvalidValue, match=r"joint 'root_joint'.*expected a unit vector"):
        load(tmp_path, "free_flyer = true\n[initial]\nq = { root_joint = [0, 0, 0, 0, 0, 0, 0] }")


def test_dependent_constraints_are_refused_by_name(tmp_path: Path) -> None:
    rod = '[[constraint]]\ntype = "rod"\nname = "{}"\nframes = ["l3", "world"]\n'
    with pytest.raises(UnsupportedRobot, match=r"constraint 'second' is a duplicate: 'first' implies it"):
        load(tmp_path, rod.format("first") + rod.format("second"))


def test_constraints_may_make_up_for_a_singular_mass_matrix(tmp_path: Path) -> None:
    # Two massless slides beside a mass that a rod ties together: only together do they have inertia.
    parts = [urdfs.link("base"), urdfs.link("a"), urdfs.link("b", None)]
    slides = [
        urdfs.joint("ja", "prismatic", "base", "a", axis="1 0 0"),
        urdfs.joint("jb", "prismatic", "base", "b", axis="1 0 0").replace(
            'xyz="0.3 0 0.1"', 'xyz="0.3 0 0.6"'
        ),
    ]
    toml = '[[constraint]]\ntype = "rod"\nname = "tie"\nframes = ["a", "b"]\n[initial]\nq = { jb = 0.4 }\n'
    robot = load(tmp_path, toml, urdfs.robot(*parts, *slides))
    assert isinstance(robot.constraints[0], Rod)
    v = np.array([1.0, 1.0])
    assert np.abs(robot.constraint_jacobian(robot.q0) @ v).max() < 1e-12
    np.testing.assert_allclose(
        robot.velocity_from_momentum(robot.q0, robot.momentum(robot.q0, v)), v, atol=1e-9
    )

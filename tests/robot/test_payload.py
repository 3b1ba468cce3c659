"""Payloads against URDFs that say the same: a link on a fixed joint."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path
from xml.etree import ElementTree

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.cli.solution_summary import solution_rows
from mbocp.exceptions import (
    InvalidValue,
    ProblemFileError,
    RobotError,
    RobotFileError,
    UnknownFrame,
    UnsupportedRobot,
)
from mbocp.formulation import formulate
from mbocp.mechanics import JointMechanics
from mbocp.mechanics.natural_coordinates.bodies import body_tree
from mbocp.problem import Problem
from mbocp.problem.file.load import parse_problem
from mbocp.problem.file.tables import problem_to_toml
from mbocp.problem.problem import problem_from_tables
from mbocp.robot import Payload, Robot, describe, load_robot, robot_from_spec
from mbocp.view.replay import write_replay
from tests.mechanics import mimics
from tests.robot import urdfs
from tests.view.pages import read_page

BOX = Payload(
    frame="",
    name="crate",
    mass=2.0,
    com=(0.05, -0.02, 0.13),
    inertia=(0.02, 0.03, 0.025, 0.001, -0.002, 0.0005),
    box=(0.2, 0.3, 0.1),
)
BODIES = {  # a link of each robot that moves
    "ur5": "wrist_2_link",
    "kinova": "j2s6s200_link_4",
    "panda": "panda_leftfinger",  # beside its mimic joint
    "solo12": "FR_LOWER_LEG",
    "hector": "base_link",
    "anymal": "LF_SHANK",
    "double_pendulum": "link2",
    "four_bar": "coupler",
    "delta": "platform",
    "elastic_pendulum": "bob",
    "cart_pendulum_rigid": "bob",
    "unicycle_pendulum": "pendulum_com",
}


def written(robot: Robot, frame: str, folder: Path) -> Path:
    """The robot's URDF without pictures and with the crate as a link, beside its robot.toml."""
    assert robot.source is not None
    root = ElementTree.parse(robot.source).getroot()
    for link in root.iterfind("link"):
        for tag in ("visual", "collision"):
            for element in link.findall(tag):
                link.remove(element)
    xx, yy, zz, xy, xz, yz = BOX.inertia
    com = " ".join(map(repr, BOX.com))
    words = (
        f'<robot><link name="added"><inertial><origin xyz="{com}"/><mass value="{BOX.mass}"/><inertia '
        f'ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="{xy}" ixz="{xz}" iyz="{yz}"/></inertial></link>'
        f'<joint name="mount" type="fixed"><parent link="{frame}"/><child link="added"/></joint></robot>'
    )
    root.extend(ElementTree.fromstring(words))
    folder.mkdir(exist_ok=True)
    table = robot.source.parent / "robot.toml"
    (folder / "robot.urdf").write_text(ElementTree.tostring(root, encoding="unicode"))
    if table.is_file():
        (folder / "robot.toml").write_text(table.read_text())
        return folder / "robot.toml"
    return folder / "robot.urdf"


def pair(name: str, folder: Path) -> tuple[Robot, Robot]:
    """The robot with the payload, and the one whose URDF has it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if name == "hand":
            spec = urdfs.write(folder / "bare", mimics.HAND)
            bare, frame = load_robot(spec), "t2"
        else:
            bare, frame = load_robot(name), BODIES[name]
        path = written(bare, frame, folder)
        floating = bare.joint_names[0] == "root_joint"
        other = load_robot(path, free_flyer=floating, mimic=True if name in ("panda", "hand") else None)
        if name in ("panda", "solo12", "anymal"):  # without the reference pose, and with mimic joints
            bare = load_robot(name, free_flyer=floating, mimic=name == "panda")
    return bare.with_payload(carried(frame)), other


def carried(frame: str, **changes: object) -> Payload:
    return Payload(**{**BOX.table, "frame": frame, **changes})  # type: ignore[arg-type]


def numbers(expression: ca.SX, symbols: list[ca.SX], values: list[np.ndarray]) -> np.ndarray:
    return np.asarray(ca.DM(ca.Function("f", symbols, [ca.densify(expression)])(*values)))


@pytest.mark.parametrize("name", [*BODIES, "hand"])
def test_dynamics_are_those_of_a_link(name: str, tmp_path: Path) -> None:
    robot, other = pair(name, tmp_path)
    assert robot.model.nv == other.model.nv
    other.model.armature = robot.model.armature
    rng = np.random.default_rng(0)
    q, v, a = (ca.SX.sym(n, k) for n, k in (("q", robot.nq), ("v", robot.nv), ("a", robot.nv)))
    mechanics, data = JointMechanics(robot), other.model.createData()
    torque = ca.Function("tau", [q, v, a], [ca.densify(mechanics.inverse_dynamics(q, v, a))])
    for _ in range(3):
        at = other.integrate(other.neutral(), rng.standard_normal(other.nv))
        rate, acceleration = rng.standard_normal(other.nv), rng.standard_normal(other.nv)
        expected = pin.rnea(other.model, data, at, rate, acceleration)
        size = 1e-11 * (1.0 + np.abs(expected).max())
        np.testing.assert_allclose(np.asarray(torque(at, rate, acceleration)).ravel(), expected, atol=size)
        np.testing.assert_allclose(robot.mass_matrix(at), other.mass_matrix(at), atol=1e-11)
        assert robot.potential_energy(at) == pytest.approx(other.potential_energy(at), rel=1e-11)
    assert describe(robot)["mass"] == pytest.approx(describe(other)["mass"], rel=1e-12)


@pytest.mark.parametrize("name", ["ur5", "four_bar", "solo12", "hand"])
def test_natural_coordinates_are_those_of_a_link(name: str, tmp_path: Path) -> None:
    robot, other = pair(name, tmp_path)
    for ours, theirs in zip(body_tree(robot).bodies, body_tree(other).bodies, strict=True):
        assert ours.mass == pytest.approx(theirs.mass, rel=1e-12)
        np.testing.assert_allclose(ours.lever, theirs.lever, atol=1e-13)
        np.testing.assert_allclose(ours.euler, theirs.euler, atol=1e-13)


def test_a_point_mass_and_several_payloads() -> None:
    arm = load_robot("ur5")
    point = Payload(frame="tool0", mass=1.5, com=(0, 0, 0.2), name="point")
    both = arm.with_payload(point).with_payload(carried("forearm_link"))
    same = load_robot("ur5", payload=[point, carried("forearm_link")])
    assert both.fingerprint == same.fingerprint != arm.fingerprint
    assert [p.name for p in both.payloads] == ["point", "crate"]
    assert load_robot("ur5").fingerprint == arm.fingerprint
    jacobian = pin.computeFrameJacobian(
        both.model, both.model.createData(), both.q0, both.frame_id("point"), pin.LOCAL
    )[:3]
    alone = arm.with_payload(carried("forearm_link"))
    added = both.mass_matrix(both.q0) - alone.mass_matrix(alone.q0)
    np.testing.assert_allclose(added, 1.5 * jacobian.T @ jacobian, atol=1e-12)


def test_a_tool_has_its_frame_at_its_tip() -> None:
    tool = {"name": "torch", "frame": "tool0", "mass": 1.2, "com": [0.0, 0.0, 0.06]}
    tip = {"position": [0.05, 0.0, 0.21], "orientation": [0.3, 0.7854, -0.2]}
    arm = load_robot("ur5", payload=[{**tool, **tip}])
    q = np.array([0.1, -1.2, 1.3, 0.4, -0.5, 0.6])
    flange, found = arm.frame_placement("tool0", q), arm.frame_placement("torch", q)
    turn = pin.rpy.rpyToMatrix(0.3, 0.7854, -0.2)
    np.testing.assert_allclose(found.rotation, flange.rotation @ turn, atol=1e-14)
    np.testing.assert_allclose(found.translation, flange.act(np.array([0.05, 0.0, 0.21])), atol=1e-14)
    assert arm.payloads[0].table == {**tool, **tip}
    bare = load_robot("ur5", payload=[tool])
    np.testing.assert_allclose(arm.mass_matrix(q), bare.mass_matrix(q), atol=1e-14)  # a tip weighs nothing
    np.testing.assert_allclose(arm.frame_placement("torch", q).rotation, found.rotation)
    quaternion = pin.Quaternion(turn).coeffs().tolist()
    other = load_robot("ur5", payload=[{**tool, **tip, "orientation": quaternion}])
    np.testing.assert_allclose(other.frame_placement("torch", q).rotation, found.rotation, atol=1e-14)


def test_another_tip_compiles_nothing() -> None:
    def problem(angle: float, reach: float) -> Problem:
        tip = {"position": [0.0, 0.0, reach], "orientation": [0.0, angle, 0.0]}
        goal = {"frame": {"name": "tip", "position": [0.4, 0.2, 0.4], "rpy": [math.pi, 0.0, 0.0]}, "v": 0.0}
        return problem_from_tables(
            {
                "robot": {"name": "ur5", "payload": [{"name": "tip", "frame": "tool0", "mass": 0.0, **tip}]},
                "horizon": {"duration": 1.0, "steps": 20},
                "goal": goal,
            }
        )

    straight, bent = problem(0.0, 0.1), problem(0.5, 0.2)
    assert formulate(straight).pieces.signature == formulate(bent).pieces.signature
    solution = mbocp.solve(bent)
    assert solution.converged
    reached = bent.robot.frame_placement("tip", solution.qs[-1])
    np.testing.assert_allclose(reached.translation, [0.4, 0.2, 0.4], atol=1e-8)
    np.testing.assert_allclose(reached.rotation, pin.rpy.rpyToMatrix(math.pi, 0.0, 0.0), atol=1e-7)
    again = parse_problem(problem_to_toml(bent))
    np.testing.assert_array_equal(again.robot.varying_values, bent.robot.varying_values)


def test_inertia_as_diagonal_six_or_table() -> None:
    def loaded(inertia: object) -> str:
        return load_robot("ur5", payload=[{"frame": "tool0", "mass": 1.0, "inertia": inertia}]).fingerprint

    six = loaded([0.1, 0.2, 0.15, 0.0, 0.0, 0.0])
    assert six == loaded([0.1, 0.2, 0.15]) == loaded({"ixx": 0.1, "iyy": 0.2, "izz": 0.15})
    assert six == loaded(np.array([0.1, 0.2, 0.15]))
    assert loaded([0.1, 0.2, 0.15, 0.0, 0.0, 0.01]) == loaded(
        {"ixx": 0.1, "iyy": 0.2, "izz": 0.15, "iyz": 0.01}
    )


def test_frames_on_locked_joints_and_followers(tmp_path: Path) -> None:
    lock = {"wrist_3_joint": 0.7, "wrist_2_joint": -0.4}
    locked = load_robot("ur5", lock=lock, payload=[carried("tool0").table])
    free = load_robot("ur5", payload=[carried("tool0").table])
    q = np.array([0.1, 0.2, 0.3, 0.4])
    whole = np.concatenate([q, [-0.4, 0.7]])
    np.testing.assert_allclose(locked.mass_matrix(q), free.mass_matrix(whole)[:4, :4], atol=1e-12)
    fixed = dict.fromkeys(load_robot("ur5").joint_names[:2], 0.0)
    with pytest.raises(UnsupportedRobot, match="frame 'upper_arm_link' is fixed to the world: nothing would"):
        load_robot("ur5", lock=fixed, payload=[carried("upper_arm_link").table])


def test_the_initial_pose_of_a_mechanism_does_not_depend_on_it() -> None:
    bare = load_robot("delta")
    loaded = load_robot("delta", payload=[carried("platform").table])
    np.testing.assert_array_equal(loaded.q0, bare.q0)
    assert loaded.redundant_rows == bare.redundant_rows
    assert loaded.fingerprint == bare.with_payload(carried("platform")).fingerprint


def test_a_payload_makes_a_massless_link_heavy(tmp_path: Path) -> None:
    urdf = urdfs.robot(
        urdfs.link("base"), urdfs.link("arm", None), urdfs.joint("j", "revolute", "base", "arm", axis="0 1 0")
    )
    path = urdfs.write(tmp_path, urdf)
    with pytest.raises(UnsupportedRobot, match="mass matrix is singular"):
        load_robot(path)
    robot = load_robot(path, payload=[{"frame": "arm", "mass": 2.0, "com": [0.5, 0, 0]}])
    assert robot.mass_matrix([0.0])[0, 0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"mass": -1.0}, r"payload\[0\]: mass: got -1.0, expected 0 to"),
        ({"mass": float("nan")}, r"payload\[0\]\.mass: got nan, expected a finite number"),
        ({"mass": "2"}, r"payload\[0\]\.mass: got '2', expected a number"),
        ({"mass": None}, r"payload\[0\]\.mass: this key is required"),
        ({"frame": None}, r"payload\[0\]\.frame: this key is required"),
        ({"frame": 3}, r"payload\[0\]\.frame: got 3, expected a name"),
        ({"com": [0, 0]}, r"payload\[0\]\.com: got \[0, 0\], expected 3 numbers"),
        ({"com": [0, 0, float("inf")]}, r"payload\[0\]\.com: got inf, expected a finite number"),
        ({"inertia": [1, 1, 3]}, r"principal moments 1, 1, 3 kg m\^2 may be above the sum of the other two"),
        ({"inertia": [1, 1, 1, 4, 0, 0]}, r"principal moments must not be negative, one is -3 kg m\^2"),
        ({"inertia": [1, 1]}, r"got \[1, 1\], expected 3 numbers ixx, iyy, izz, 6 numbers"),
        ({"inertia": {"ixx": 1, "iyy": 1}}, "izz is missing"),
        ({"inertia": {"ixx": 1, "iyy": 1, "zz": 1}}, "unknown key 'zz'"),
        ({"box": [1, 0, 1]}, r"box: got \[1.0, 0.0, 1.0\], expected three positive lengths"),
        ({"sphere": 1.0}, "shape: got box and sphere, expected one of them"),
        ({"weight": 1.0}, r"payload\[0\]\.weight: unknown key"),
    ],
)
def test_what_is_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(RobotError, match=words):
        load_robot("ur5", payload=[{**BOX.table, "frame": "tool0", **changes}])


def test_refused_frames_and_names() -> None:
    arm = load_robot("ur5")
    with pytest.raises(UnknownFrame, match=r"payload 'crate': .*has no frame 'tool_0': did you mean 'tool0'"):
        arm.with_payload(carried("tool_0"))
    with pytest.raises(UnsupportedRobot, match="payload 'crate': frame 'base_link' is fixed to the world"):
        arm.with_payload(carried("base_link"))
    with pytest.raises(UnsupportedRobot, match="payload 'tool0': a frame has this name already"):
        arm.with_payload(carried("tool0", name="tool0"))
    with pytest.raises(UnsupportedRobot, match="payload 'crate': a frame has this name already"):
        arm.with_payload(carried("tool0"), carried("tool0"))
    with pytest.raises(InvalidValue, match="payload 'payload': mass: got nan"):
        Payload(frame="tool0", mass=float("nan"))
    with pytest.raises(RobotError, match=r"payload\[0\]: got 3, expected a table"):
        load_robot("ur5", payload=[3])  # type: ignore[list-item]


def test_robot_toml(tmp_path: Path) -> None:
    urdf = urdfs.chain("revolute", "revolute", "revolute")
    toml = '[[payload]]\nframe = "l3"\nmass = 1\nsphere = 0.1\n[[payload]]\nframe = "l2"\nmass = 2.0\n'
    path = urdfs.write(tmp_path, urdf, toml)
    robot = load_robot(path)
    assert [(p.name, p.mass) for p in robot.payloads] == [("payload_0", 1.0), ("payload_1", 2.0)]
    assert robot_from_spec(robot.spec).fingerprint == robot.fingerprint
    bare = load_robot(path, payload=[])
    assert bare.payloads == ()
    assert robot_from_spec(bare.spec).payloads == ()
    with pytest.raises(RobotFileError, match=r"robot\.toml: payload\[0\]: mass: got -1.0"):
        load_robot(urdfs.write(tmp_path, urdf, '[[payload]]\nframe = "l3"\nmass = -1\n'))
    with pytest.raises(RobotFileError, match=r"payload\[0\]\.masss: unknown key; did you mean 'mass'"):
        load_robot(urdfs.write(tmp_path, urdf, '[[payload]]\nframe = "l3"\nmasss = 1\nmass = 1\n'))


PROBLEM = """[robot]
name = "ur5"
[[robot.payload]]
name = "crate"
frame = "tool0"
mass = 2
com = [0, 0, 0.1]
inertia = [0.01, 0.01, 0.02]
cylinder = [0.1, 0.2]
[[robot.payload]]
frame = "forearm_link"
mass = 1.0
[horizon]
duration = 1.0
steps = 10
[goal]
q = [0.1, -1.5, 0.2, 0, 0, 0]
"""


def test_problem_files() -> None:
    problem = parse_problem(PROBLEM)
    assert [(p.name, p.mass) for p in problem.robot.payloads] == [("crate", 2.0), ("payload_1", 1.0)]
    again = parse_problem(problem_to_toml(problem))
    assert again.robot.fingerprint == problem.robot.fingerprint
    assert again.robot.payloads == problem.robot.payloads
    heavier = parse_problem(PROBLEM, ["robot.payload.0.mass=3.5"])
    assert [p.mass for p in heavier.robot.payloads] == [3.5, 1.0]
    light = parse_problem(PROBLEM, {"robot.payload": []})
    assert light.robot.fingerprint == load_robot("ur5").fingerprint
    carrying = problem.with_(robot=load_robot("ur5").with_payload(carried("tool0")))
    assert parse_problem(problem_to_toml(carrying)).robot.payloads == (carried("tool0"),)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("robot.payload.0.mass=-1", r"<text>: robot\.payload\.0: mass: got -1.0, expected 0 to"),
        ("robot.payload.1.inertia=[1,1,3]", r"robot\.payload\.1: inertia: .* may be above the sum"),
        ("robot.payload.2.mass=1", "robot.payload is .*, which has no keys below it"),
        ("robot.payload.0.weight=1", r"robot\.payload\.0\.weight: unknown key"),
        ("robot.payload=[{mass=1}]", r"robot\.payload\.0\.frame: this key is missing"),
    ],
)
def test_refused_in_a_problem_file(override: str, words: str) -> None:
    with pytest.raises(ProblemFileError, match=words):
        parse_problem(PROBLEM, [override])


def test_an_unknown_frame_in_a_problem_file() -> None:
    with pytest.raises(UnknownFrame, match=r"<text>: robot: .*payload 'crate': .*did you mean 'tool0'"):
        parse_problem(PROBLEM, ['robot.payload.0.frame="tool_0"'])


def test_describe_and_results(tmp_path: Path) -> None:
    robot = load_robot("chain_1").with_payload(carried("tip"))
    facts = describe(robot)
    assert facts["payloads"] == [carried("tip").table]
    json.dumps(facts, allow_nan=False)
    goal = {"q": [1.0], "v": 0}
    heavy = mbocp.solve(Problem.create(robot, 1.0, 20, goal=goal, scheme="se1"))
    assert heavy.converged
    loaded = mbocp.Solution.load(heavy.save(tmp_path / "heavy.h5"))
    again = robot_from_spec(loaded.robot_spec)
    assert again.fingerprint == robot.fingerprint
    assert dict(solution_rows(loaded, ""))["carries"] == "crate (2.0 kg at tip)"
    light = mbocp.solve(Problem.create("chain_1", 1.0, 20, goal=goal, scheme="se1"))
    assert "payload" not in light.robot_spec
    assert "carries" not in dict(solution_rows(light, ""))
    assert heavy.cost > 10.0 * light.cost


def test_replays_draw_it(tmp_path: Path) -> None:
    """Beside the sticks of a robot without pictures."""
    path = urdfs.write(tmp_path, urdfs.chain("revolute", "revolute"))
    shapes = ({"box": (0.1, 0.2, 0.3)}, {"sphere": 0.1}, {"cylinder": (0.1, 0.4)}, {})
    payloads = [
        Payload(frame="l2", mass=1.0, name=f"p{i}", **shape)  # type: ignore[arg-type]
        for i, shape in enumerate(shapes)
    ]
    robot = load_robot(path, payload=payloads)
    page = read_page(write_replay(robot, [0.0, 1.0], [[0, 0], [1, 1]], tmp_path / "replay.html"))
    drawn = page.objects("/replay/world/robot")
    assert sum("payload:p" in name for name in drawn) == 4
    assert any("stick" in name for name in drawn)

"""Numbers with units are read as SI, and refused where the unit does not fit the key or the joint."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

import mbocp
from mbocp._keys import Key, Table
from mbocp._quantities import Quantity, unit_of
from mbocp.exceptions import MbocpError, ProblemFileError
from mbocp.problem.file.keys_page import all_keys
from mbocp.problem.file.load import parse_problem
from mbocp.problem.file.read_tables import problem_schema
from mbocp.problem.file.tables import problem_to_toml
from mbocp.robot import load_robot

ARM = """
robot = "ur5"
horizon = { duration = 1.0, steps = 10 }
"""
SLIDER = """
robot = "cart_pendulum_rigid"
horizon = { duration = 1.0, steps = 10 }
goal = { v = 0 }
"""
UNITS = {  # by what they come to [SI]
    "90 deg": math.radians(90.0),
    "-7°": math.radians(-7.0),
    "0.25 turn": math.pi / 2.0,
    "60 rpm": 2.0 * math.pi,
    "350 mm": 0.35,
    "12 in": 0.3048,
    "3 µm": 3e-6,
    "100 cm^2": 0.01,
    "250 g": 0.25,
    "2 lb": 0.90718474,
    "20 ms": 0.02,
    "1.5 min": 90.0,
    "2.5 kN": 2500.0,
    "1.5 N m": 1.5,
    "1.5Nm": 1.5,
    "3 N·mm": 3e-3,
    "2 kg m^2/s²": 2.0,
    "5 1/s": 5.0,
    "5/s": 5.0,
    "4 W/(N m)^2": 4.0,
    "2e1 N sqrt(s)": 20.0,
}


@pytest.mark.parametrize("text", UNITS)
def test_units_come_to_si(text: str) -> None:
    assert Quantity.of(text, ()) == pytest.approx(UNITS[text], rel=1e-15)


@pytest.mark.parametrize(
    "text",
    ["mm", "90", "90 degrees", "1 m/", "1 (m", "1 m)", "2 m^x", "1 ^2", "nan m", "1st", "1 " + 999 * "("],
)
def test_other_texts_are_none(text: str) -> None:
    assert Quantity.of(text, ()) is None


def test_every_declared_unit_is_known() -> None:
    """But those in words, whose keys take numbers alone."""
    unknown = {
        "those of the number",
        "part of the horizon",
    }
    declared = {item.unit for _, info in all_keys() for item in info.metadata if isinstance(item, Key)}
    for unit in declared - unknown - {""}:
        assert all(unit_of(one) for group in unit.split("; ") for one in group.split(", ")), unit


def test_problems_are_those_of_the_numbers() -> None:
    said = parse_problem(
        ARM,
        [
            'horizon.duration="1500 ms"',
            'start.q=["90 deg", -1.2, "0.25 turn", 0, 0, 0]',
            'goal={v=0, frame={name="tool0", position=["350 mm", "45 cm", 0.25], rpy=["180 deg", 0, 0]}}',
            'limits={velocity="90 deg/s", effort={elbow_joint="20 N m"}}',
            'path=[{kind="speed", frame="tool0", max="800 mm/s", until="400 ms"}]',
            'robot.payload=[{frame="tool0", mass="500 g", position=[0, 0, "10 cm"], sphere="1 cm"}]',
            'obstacle=[{shape="sphere", radius="50 mm", position=["2 m", 0, 0]}]',
            'robust={start={q="0.5 deg"}, parameters={"robot.payload.payload_0.mass"="50 g", '
            '"robot.payload.payload_0.com"=["5 mm", 0, 0]}}',
            'start.free={q={elbow_joint=["-90 deg", "90 deg"]}, v={elbow_joint=["-30 deg/s", 1]}}',
        ],
    )
    written = parse_problem(
        ARM,
        [
            "horizon.duration=1.5",
            f"start.q=[{math.radians(90)}, -1.2, {math.pi / 2}, 0, 0, 0]",
            f'goal={{v=0, frame={{name="tool0", position=[0.35, 0.45, 0.25], rpy=[{math.pi}, 0, 0]}}}}',
            f"limits={{velocity={math.pi / 2}, effort={{elbow_joint=20}}}}",
            'path=[{kind="speed", frame="tool0", max=0.8, until=0.4}]',
            'robot.payload=[{frame="tool0", mass=0.5, position=[0, 0, 0.1], sphere=0.01}]',
            'obstacle=[{shape="sphere", radius=0.05, position=[2, 0, 0]}]',
            'robust={start={q=0.008726646259971648}, parameters={"robot.payload.payload_0.mass"=0.05, '
            '"robot.payload.payload_0.com"=[0.005, 0, 0]}}',
            f"start.free={{q={{elbow_joint=[{-math.pi / 2}, {math.pi / 2}]}}, "
            f"v={{elbow_joint=[{-math.pi / 6}, 1]}}}}",
        ],
    )
    assert problem_to_toml(said) == problem_to_toml(written)


def test_so_are_accuracies_cycles_and_prices_of_parameters() -> None:
    said = parse_problem(
        ARM,
        [
            'horizon={duration=1, accuracy="0.1 mm"}',
            "start.free=true",
            'goal.periodic={moved={elbow_joint="1 turn"}}',
            'robot.payload=[{frame="tool0", mass=1}]',
            'parameter=[{of="robot.payload.payload_0.mass", min="500 g", max=2, cost={reference="800 g"}}]',
        ],
    )
    assert said.accuracy == 1e-4
    assert said.goal.periodic is not None
    assert said.goal.periodic.moved == {"elbow_joint": 2.0 * math.pi}
    assert (said.parameter[0].lower, said.parameter[0].cost.reference) == (0.5, 0.8)
    assert not any(
        isinstance(one, Quantity)
        for one in (said.accuracy, said.goal.periodic.moved["elbow_joint"], said.parameter[0].cost.reference)
    )
    walker = 'robot = { name = "ur5", free_flyer = true }\nhorizon = { duration = 1.0, steps = 10 }'
    step = 'goal.periodic={moved={root_joint={x="20 cm", yaw="90 deg"}}}'
    moved = parse_problem(walker, ["start.free=true", step]).goal.periodic
    assert moved is not None
    assert moved.moved == {"root_joint": {"x": 0.2, "yaw": math.radians(90.0)}}


def test_python_takes_them() -> None:
    problem = mbocp.Problem.create("ur5", "2 s", 10, goal={"q": {"elbow_joint": "90 deg"}, "v": 0})
    assert problem.duration == 2.0
    assert problem.goal.q[2] == math.radians(90.0)
    assert problem.with_(start={"q": {"elbow_joint": "-30 deg"}}).q_start[2] == pytest.approx(-math.pi / 6)


def test_steps_of_given_lengths_last_as_long_as_a_text_says() -> None:
    problem = parse_problem(ARM, ["horizon={lengths=[0.4, 0.6]}", "goal={v=0}"])
    np.testing.assert_allclose(problem.with_(duration="2 s").lengths, [0.8, 1.2])
    with pytest.raises(MbocpError, match=r"horizon\.duration: got '2 m', a length"):
        problem.with_(duration="2 m")


REFUSED = {
    "goal.q={elbow_joint='350 mm'}": r"goal\.q\.elbow_joint: got '350 mm', a length, expected .* rad",
    "goal.q=[0, 0, '350 mm', 0, 0, 0]": r"goal\.q\.elbow_joint: got '350 mm', a length, expected .* rad",
    "goal.q=[0, 0, '3 s', 0, 0, 0]": r"goal\.q: got '3 s' at index 2, a time, expected a number in m or rad",
    "goal.q={elbow_joint='3 degrees'}": r"goal\.q: got '3 degrees', expected a number in m or rad, or a text",
    "goal.v={elbow_joint='3 m/s'}": r"goal\.v\.elbow_joint: got '3 m/s', a speed, expected .* rad/s",
    "goal.p={elbow_joint='3 kg m/s'}": r"goal\.p\.elbow_joint: got '3 kg m/s', expected .* in N m s",
    "start.a={elbow_joint='3 m/s^2'}": r"start\.a\.elbow_joint: got '3 m/s\^2', expected .* in rad/s\^2",
    "horizon.duration='2 m'": r"horizon\.duration: got '2 m', a length, expected a number in s",
    "limits.effort='30 N'": r"limits\.effort\.shoulder_pan_joint: got '30 N', a force, expected .* N m",
    "limits.jerk={elbow_joint='3 m/s^3'}": r"limits\.jerk\.elbow_joint: got .*, expected .* rad/s\^3",
    "limits.position={elbow_joint=['3 mm', 2]}": r"limits\.position\.elbow_joint: got '3 mm', a length",
    "guess.u='3 N'": r"guess\.u\.shoulder_pan_joint: got '3 N', a force",
    "cost.energy={losses='3 W/N^2'}": r"losses\.shoulder_pan_joint: got .*, expected .* W/\(N m\)\^2",
    "robust.start={q='3 m'}": r"robust\.start\.q\.shoulder_pan_joint: got '3 m', a length",
    "robust={parameters={'robot.payload.c.mass'='3 m'}}": r"c\.mass: got '3 m', .* without unit",
    "horizon.accuracy='3 kg'": r"horizon\.accuracy: got '3 kg', a mass, expected a number in rad or m",
    "start.free={v={elbow_joint=['-3 deg', 1]}}": r"v\.elbow_joint: got '-3 deg', an angle, .* in rad/s",
    "goal.periodic={moved={elbow_joint='3 m'}}": r"moved\.elbow_joint: got '3 m', a length, .* in rad",
    "goal.periodic={combine={elbow_joint={elbow_joint='3 m'}}}": r"combine\..* got '3 m', .* without unit",
    "path=[{kind='speed', frame='tool0', max='3 mm'}]": r"path\.0\.max: got '3 mm', a length, .* m/s",
    "path=[{kind='speed', frame='tool0', max=1, from={share='1 s'}}]": r"from: got '1 s' for share",
    "robot.lock={elbow_joint='3 mm'}": r"joint 'elbow_joint'.*: got '3 mm', a length, .* in rad",
    "robot.elastic=[{joint='elbow_joint', stiffness='9 N/m', motor_inertia=1}]": r"stiffness: got '9 N/m'",
    "start.q={elbow_joint='3'}": r"start\.q: got '3' for 'elbow_joint', expected a number",
    "cost.effort='3 N'": r"cost\.effort: got '3 N', expected a number",
}


@pytest.mark.parametrize("setting", REFUSED)
def test_units_that_do_not_fit_are_refused(setting: str) -> None:
    with pytest.raises(MbocpError, match=REFUSED[setting]):
        parse_problem(ARM, [setting.replace("'", '"')])


def test_the_kind_of_joint_decides() -> None:
    problem = parse_problem(SLIDER, ['limits.position={cart_x=["-20 cm", "20 cm"]}'])
    assert problem.limits.q_upper[0] == 0.2
    with pytest.raises(ProblemFileError, match=r"got '20 deg', an angle, expected a number in m"):
        parse_problem(SLIDER, ['limits.position={cart_x=["-20 cm", "20 deg"]}'])


def test_the_schema_takes_them() -> None:
    schema = Draft202012Validator(problem_schema())
    table: dict[str, Any] = {
        "robot": "ur5",
        "goal": {"q": ["90 deg", 0.1], "frame": {"name": "t", "x": "3 mm"}},
    }
    assert schema.is_valid(table)
    assert not schema.is_valid({**table, "goal": {"q": ["elbow"]}})
    assert not schema.is_valid({**table, "cost": {"effort": "3 N"}})


TOML = """
urdf = "arm.urdf"
gravity = [0, 0, "-981 cm/s^2"]
lock = { slide = "20 mm" }
initial = { q = { turn = "30 deg" } }

[[actuator]]
type = "joint"
joint = "turn"
effort = "%s"

[[spring_damper]]
frames = ["hand", "world"]
stiffness = "2 N/mm"
length = "10 cm"

[[payload]]
frame = "hand"
mass = "250 g"
inertia = ["10 kg cm^2", "10 kg cm^2", "10 kg cm^2"]
"""
URDF = """
<robot name="arm"><link name="base"/>
  <link name="arm"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="hand"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="5" velocity="1"/></joint>
  <joint name="slide" type="prismatic"><parent link="arm"/><child link="hand"/>
    <limit lower="-1" upper="1" effort="5" velocity="1"/></joint>
</robot>
"""


def test_robot_files_take_them(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").write_text(URDF, encoding="utf-8")
    file = tmp_path / "robot.toml"
    file.write_text(TOML % "40 N m", encoding="utf-8")
    robot = load_robot(file)
    assert robot.model.gravity.linear[2] == -9.81
    assert robot.q0 == pytest.approx([math.pi / 6])
    assert robot.limits.effort == pytest.approx([40.0])
    assert [(force.stiffness, force.length) for force in robot.forces] == [(2000.0, 0.1)]
    assert robot.payloads[0].mass == 0.25
    np.testing.assert_allclose(robot.payloads[0].inertia[:3], 1e-3)
    for wrong, words in (("40 N", r"'turn'.*got '40 N', a force"), ("40 kg", r"effort: got '40 kg', a mass")):
        file.write_text(TOML % wrong, encoding="utf-8")
        with pytest.raises(MbocpError, match=words):
            load_robot(file)


def test_keys_of_one_row_have_units_of_their_own() -> None:
    class Two(Table):
        """Two keys of one row."""

        a: float = 0.0
        b: float = 0.0

    key = Key("place and speed", "m; m/s", beside=("b",))
    assert (key.unit_of("a", "a"), key.unit_of("b", "a")) == ("m", "m/s")
    assert Key("rows of a table", "m; m/s").unit_of("a", "a") == "m; m/s"

"""Robots without dynamics: URDFs without inertias move by the accelerations of their joints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.exceptions import ProblemError, UnsupportedRobot
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.robot import Payload, load_parts
from mbocp.robot.loading.mechanics_checks import SingularMassMatrix

LIMIT = '<limit lower="-2" upper="2" effort="30" velocity="2"/><dynamics damping="3"/>'
ARM = f"""<robot name="bare"><link name="base"/><link name="upper"/><link name="fore"/><link name="tool"/>
<joint name="lift" type="prismatic"><parent link="base"/><child link="upper"/>
<axis xyz="0 0 1"/>{LIMIT}</joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
<axis xyz="0 1 0"/>{LIMIT}</joint>
<joint name="end" type="fixed"><parent link="fore"/><child link="tool"/>
<origin xyz="0.5 0 0"/></joint></robot>"""
LEAST = {"time": 1.0, "effort": 1e-6}


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    file = tmp_path / "arm.urdf"
    file.write_text(ARM)
    return file


def test_such_a_robot_is_refused_unless_it_is_said(arm: Path) -> None:
    with pytest.raises(SingularMassMatrix, match="dynamics = false"):
        mbocp.load_robot(arm)
    robot = mbocp.load_robot(arm, dynamics=False)
    assert [(label.name, label.unit) for label in robot.u_labels] == [("lift", "m/s^2"), ("elbow", "rad/s^2")]
    assert not np.isfinite(robot.limits.effort).any()
    assert np.isfinite(robot.limits.velocity).all()


@pytest.mark.parametrize("name", ["ur5", "panda", "kinova"])
def test_controls_are_accelerations(name: str) -> None:
    """Whatever the inertias of the file, its damping and friction are."""
    robot = mbocp.load_robot(name, dynamics=False)
    rng = np.random.default_rng(3)
    model, data = robot.model, robot.model.createData()
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    u = rng.normal(size=robot.nu)
    tau = robot.actuation_matrix(q) @ u + robot.force_elements(q, rng.normal(size=model.nv))
    np.testing.assert_allclose(pin.aba(model, data, q, rng.normal(size=model.nv), tau), u, atol=1e-12)
    np.testing.assert_allclose(robot.mass_matrix(q), np.eye(model.nv), atol=1e-12)


@pytest.mark.parametrize("name", ["four_bar", "five_bar"])
def test_controls_of_closed_loops_are_accelerations_of_their_motors(name: str) -> None:
    """Whatever links between the motors: no force acts on what has no mass."""
    robot = mbocp.load_robot(name, dynamics=False)
    motors = np.any(robot.actuation.selection, axis=1)
    turned = robot.integrate(robot.q0, np.where(motors, 0.4, 0.0))
    held = [joint for joint, turns in zip(robot.joint_names, motors, strict=True) if turns]
    goal = {"q": robot.assemble(turned, fixed=held), "v": 0}
    problem = Problem.create(robot, 1.0, 20, goal=goal, cost={"effort": 1.0})
    s = mbocp.solve(problem, check=True, accuracy=False)
    assert problem.scheme == "midpoint"
    np.testing.assert_allclose(s.us, np.diff(s.vs, axis=0)[:, motors] / problem.dt, atol=1e-9)
    assert s.cost == pytest.approx(6.0 * 0.4**2 * motors.sum(), rel=5e-3)  # of cubics from rest to rest
    for scheme in ("lobatto3", "rk4"):
        with pytest.raises(ProblemError, match="divides by masses"):
            problem.with_(scheme=scheme)


def test_it_moves_to_a_tool_goal_in_the_least_time(arm: Path) -> None:
    """Of the joint that needs longest: 2 sqrt(d / a), from rest to rest."""
    limits = {"velocity": True, "position": True, "acceleration": 4.0}
    problem = Problem.create(
        mbocp.load_robot(arm, dynamics=False),
        {"min": 0.1, "max": 3.0},
        30,
        goal={"q": [0.2, 0.8], "v": 0},
        limits=limits,
        cost=LEAST,
    )
    s = mbocp.solve(problem, check=True)
    assert s.duration == pytest.approx(2.0 * np.sqrt(0.8 / 4.0), rel=2e-3)
    np.testing.assert_allclose(s.us, s.accelerations, atol=1e-9)
    assert np.isnan(s.positive_work)
    tool = {"name": "tool", "position": [0.3, 0.0, 0.6]}
    reach = mbocp.solve(problem.with_(goal={"frame": tool, "v": 0}), check=True)
    place = reach.load_problem().robot.frame_placement("tool", reach.q_final).translation
    np.testing.assert_allclose(place, [0.3, 0.0, 0.6], atol=1e-8)


def test_files_say_it(arm: Path, tmp_path: Path) -> None:
    toml = tmp_path / "robot.toml"
    toml.write_text(f'urdf = "{arm.name}"\ndynamics = false\n')
    assert mbocp.load_robot(toml).nu == 2
    with pytest.raises(SingularMassMatrix):
        mbocp.load_robot(toml, dynamics=True)
    text = (
        f'robot = {{ name = "{arm}", dynamics = false }}\n'
        "[horizon]\nduration = 1\nsteps = 5\n[goal]\nq = [0.1, 0.1]\n"
    )
    problem = parse_problem(text)
    again = parse_problem(problem_to_toml(problem))
    assert again.robot.fingerprint == problem.robot.fingerprint
    both = load_parts([{"robot": str(arm), "name": "a", "dynamics": False}, {"robot": "ur5", "name": "b"}])
    assert {label.unit for label in both.u_labels} == {"m/s^2", "rad/s^2", "N m"}


@pytest.mark.parametrize(
    ("robot", "words", "says"),
    [
        ("iris", {}, "'root_joint' has several velocities"),
        ("ur5", {"payload": [{"frame": "tool0", "mass": 1.0}]}, "a payload has a mass"),
        ("elastic_pendulum", {}, "a spring"),
    ],
)
def test_what_has_no_meaning_without_masses_is_refused(robot: str, words: dict[str, Any], says: str) -> None:
    with pytest.raises(UnsupportedRobot, match=f"dynamics = false: .*{says}"):
        mbocp.load_robot(robot, dynamics=False, **words)


@pytest.mark.parametrize("is_below", [True, False])
def test_parts_without_dynamics_neither_carry_masses_nor_are_carried(is_below: bool) -> None:
    """Torques of an arm would leave out what it carries, and what has no mass cannot carry an arm."""
    lower = {"name": "lower", "robot": "ur5", "dynamics": not is_below}
    upper = {"name": "upper", "robot": "ur5", "parent": "lower/tool0", "dynamics": is_below}
    with pytest.raises(UnsupportedRobot, match=r"dynamics = false: joint '.*' moves parts that have masses"):
        load_parts([lower, upper])
    both = load_parts([{**lower, "dynamics": False}, {**upper, "dynamics": False}])
    assert {label.unit for label in both.u_labels} == {"rad/s^2"}


def test_what_pulls_at_joints_without_dynamics_is_refused() -> None:
    """Their controls would be no accelerations: in parts, of what is carried later, in phases."""
    kinematic = {"name": "arm", "robot": "ur5", "dynamics": False}
    box = {"name": "box", "mass": 2.0, "box": [0.1, 0.1, 0.1]}
    grip = {"name": "grip", "type": "weld", "frames": ["arm/tool0", "box/body"]}
    with pytest.raises(UnsupportedRobot, match="dynamics = false: constraint 'grip' pulls at masses"):
        load_parts([kinematic, box], constraint=[grip])
    load = {"frame": "arm/tool0", "mass": 1.0}
    with pytest.raises(UnsupportedRobot, match="dynamics = false: a payload has a mass"):
        load_parts([kinematic], payload=[load])
    robot = mbocp.load_robot("ur5", dynamics=False)
    with pytest.raises(UnsupportedRobot, match="dynamics = false: a payload has a mass"):
        robot.with_payload(Payload(frame="tool0", mass=1.0))
    assert robot.with_payload(Payload(frame="tool0", mass=0.0)).nv == robot.nv
    phase = {"name": "wipe", "steps": 5, "duration": 1.0, "hold": {"frame": "tool0", "kind": "plane"}}
    with pytest.raises(ProblemError, match="forces hold, and with dynamics = false there are none"):
        Problem.create(robot, phase=[phase])


def test_limits_of_torques_are_none(arm: Path) -> None:
    robot = mbocp.load_robot("ur5", dynamics=False)
    with pytest.raises(ProblemError, match="effort"):
        Problem.create(robot, 1.0, 5, goal={"v": 0}, limits={"effort": True})

"""`cost.effort_about_gravity`: what it costs beyond holding the weight, and where there is none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.mechanics.forces import controls_beside
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.robot import Robot
from mbocp.solution import Solution

POSE = [0.3, -1.2, 1.4, -1.6, -1.57, 0.0]


def arm(cost: dict[str, Any], goal: Any = POSE, **words: Any) -> Problem:
    given = {"start": {"q": POSE}, "goal": {"q": goal, "v": 0}, "cost": cost, "scheme": "midpoint"}
    return Problem.create("ur5", 1.0, 20, **{**given, **words})


def test_an_arm_that_holds_still_costs_nothing() -> None:
    still = mbocp.solve(arm({"effort": 0.0, "effort_about_gravity": 1.0}), check=True)
    robot = mbocp.load_robot("ur5")
    gravity = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), np.array(POSE))
    assert still.cost == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(still.us, np.tile(gravity, (20, 1)), atol=1e-6)
    swinging = mbocp.solve(arm({"effort": 1.0, "velocity": 1.0}), check=True)
    assert np.abs(swinging.qs - POSE).max() > 1e-2  # it pays to move


def test_the_cost_by_hand() -> None:
    """Of a motion, with a weight for each control, at the middles of the steps."""
    weights = np.array([1.0, 0.5, 2.0, 1.0, 0.2, 3.0])
    goal = [0.8, -1.0, 1.0, -1.2, -1.0, 0.4]
    cost = {"effort": 0.1, "velocity": 0.5, "effort_about_gravity": weights.tolist()}
    problem = arm(cost, goal)
    solution = mbocp.solve(problem, check=True)
    robot, total = problem.robot, 0.0
    data = robot.model.createData()
    for n, u in enumerate(solution.us):
        middle = robot.integrate(solution.qs[n], 0.5 * robot.difference(solution.qs[n], solution.qs[n + 1]))
        more = u - pin.computeGeneralizedGravity(robot.model, data, middle)
        v = (solution.vs[n] + solution.vs[n + 1]) / 2
        total += problem.dt / 2 * (0.1 * u @ u + weights @ more**2 + 0.5 * v @ v)
    assert solution.cost == pytest.approx(total, rel=1e-10)
    with_ipopt = mbocp.solve(problem.with_(solver={"method": "ipopt"}), check=True)
    assert with_ipopt.cost == pytest.approx(solution.cost, rel=1e-8)


def test_a_payload_is_weight_too() -> None:
    load = {"name": "box", "frame": "tool0", "mass": 3.0}
    robot = {"name": "ur5", "payload": [load]}
    given: dict[str, Any] = {"start": {"q": POSE}, "goal": {"q": POSE, "v": 0}, "scheme": "se1"}
    cost = {"effort": 0.0, "effort_about_gravity": 1.0}
    solution = mbocp.solve(Problem.create(robot, 1.0, 10, cost=cost, **given), check=True)
    assert solution.cost == pytest.approx(0.0, abs=1e-12)


GEARS = {"shoulder_lift_joint": 100.0, "elbow_joint": 0.1}
SPRING = {"joint": "shoulder_lift_joint", "stiffness": 1500.0, "motor_inertia": 2.0}


def held_still(robot: dict[str, Any], **words: Any) -> Solution:
    """A UR5 with other motors, which is to stay where it is."""
    given: dict[str, Any] = {"start": {"q": POSE}, "goal": {"q": POSE, "v": 0}, "scheme": "midpoint"}
    cost = {"effort": 0.0, "velocity": 1.0, "effort_about_gravity": 1.0}
    return mbocp.solve(
        Problem.create({"name": "ur5"} | robot, 1.0, 10, cost=cost, **given, **words), check=True
    )


def weight_behind(gears: dict[str, float]) -> Array:
    robot = mbocp.load_robot("ur5")
    weight = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), np.array(POSE))
    return weight / [gears.get(name, 1.0) for name in robot.joint_names]


@pytest.mark.parametrize("names", [list(GEARS), ["elbow_joint"], []])
def test_motors_with_gears_and_behind_springs_hold_the_weight(names: list[str]) -> None:
    gears = {name: GEARS[name] for name in names}
    robot: dict[str, Any] = {
        "motor": [{"joint": j, "gear_ratio": n, "inertia": 1e-4} for j, n in gears.items()]
    }
    still = held_still(robot if len(names) == 2 else robot | {"elastic": [SPRING]})
    assert still.cost == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(still.us, np.tile(weight_behind(gears), (10, 1)), atol=1e-6)


def test_a_gear_that_is_found_holds_the_weight() -> None:
    gear = {"of": "robot.motor.elbow_joint.gear_ratio", "min": 8.0, "max": 30.0, "cost": {"linear": 0.1}}
    still = held_still({"motor": [{"joint": "elbow_joint", "gear_ratio": 20.0}]}, parameter=[gear])
    assert still.cost == pytest.approx(0.8, rel=1e-6)
    expected = np.tile(weight_behind({"elbow_joint": 8.0}), (10, 1))
    np.testing.assert_allclose(still.us, expected, rtol=1e-5, atol=1e-6)


def test_rotors_of_a_drone_share_its_weight(tmp_path: Path) -> None:
    rotors = [(0.2, 0.0, 0.02), (0.0, 0.2, -0.02), (-0.2, 0.0, 0.02), (0.0, -0.2, -0.02)]
    rows = [
        f'[[actuator]]\ntype = "thruster"\nname = "{x} {y}"\nframe = "body"\nposition = [{x}, {y}, 0]\n'
        f"torque_ratio = {turn}\n"
        for x, y, turn in rotors
    ]
    (tmp_path / "robot.urdf").write_text(
        '<robot name="drone"><link name="body"><inertial><mass value="2"/>'
        '<inertia ixx="0.02" iyy="0.02" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>'
    )
    (tmp_path / "robot.toml").write_text("free_flyer = true\n" + "".join(rows))
    cost = {"effort": 0.0, "velocity": 1.0, "effort_about_gravity": 1.0}
    here = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    goal = {"q": here, "v": 0}
    problem = Problem.create(str(tmp_path / "robot.toml"), 1.0, 10, goal=goal, cost=cost, scheme="midpoint")
    still = mbocp.solve(problem, check=True)
    np.testing.assert_allclose(still.us, 2.0 * 9.81 / 4.0, rtol=1e-8)
    assert still.cost == pytest.approx(0.0, abs=1e-12)


def smallest_controls(robot: Robot, q: Array, ties: Array) -> Array:
    """Those that hold the weight beside constraints, by NumPy."""
    leaves = np.linalg.svd(ties)[2][len(ties) :]  # what constraints leave of velocities
    gravity = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), q)
    return np.linalg.lstsq(leaves @ robot.actuation_matrix(q), leaves @ gravity, rcond=1e-9)[0]


STILL = {"effort": 0.0, "velocity": 1.0, "effort_about_gravity": 1.0}
LOOPS: list[tuple[str | dict[str, Any], str]] = [
    *(("four_bar", scheme) for scheme in ("se1", "rk4", "lobatto3", "semi_implicit_euler")),
    *((name, "midpoint") for name in ("five_bar", "slider_crank", "parallelogram_arm")),
    ({"name": "five_bar", "motor": [{"joint": "left_shoulder", "gear_ratio": 100, "inertia": 0}]}, "se1"),
    ({"name": "four_bar", "actuated": ["crank", "rocker"]}, "midpoint"),
    ({"name": "four_bar", "actuated": ["coupler"]}, "midpoint"),
]


@pytest.mark.parametrize(
    ("named", "scheme"), [*LOOPS, pytest.param("delta", "midpoint", marks=pytest.mark.slow)]
)
def test_closed_loops_hold_their_part_of_the_weight(named: str | dict[str, Any], scheme: str) -> None:
    start = mbocp.load_robot(named if isinstance(named, str) else named["name"]).q0
    given: dict[str, Any] = {"start": {"q": start}, "goal": {"q": start, "v": 0}, "scheme": scheme}
    problem = Problem.create(named, 0.5, 10, cost=STILL, **given)
    still = mbocp.solve(problem, check=True)
    robot = problem.robot
    expected = smallest_controls(robot, start, robot.constraint_jacobian(start))
    assert still.cost == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(still.us, np.tile(expected, (10, 1)), atol=1e-7)


def test_an_elastic_joint_in_a_loop_hands_the_weight_on() -> None:
    spring = {"joint": "left_shoulder", "stiffness": 300.0, "motor_inertia": 0.1}
    start = mbocp.load_robot("five_bar").q0
    given: dict[str, Any] = {"start": {"q": start.tolist()}, "goal": {"q": start.tolist(), "v": 0}}
    stiff, soft = (
        mbocp.solve(
            Problem.create({"name": "five_bar"} | robot, 0.5, 10, cost=STILL, scheme="midpoint", **given),
            check=True,
        )
        for robot in ({}, {"elastic": [spring]})
    )
    assert soft.cost == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(soft.us, stiff.us, atol=1e-7)


def test_feet_that_are_held_bear_the_weight() -> None:
    """Four, with forces to spare; then one leg is in the air, and three bear it."""
    start = {"q": {"root_joint": [0, 0, 0.235, 0, 0, 0, 1]}}
    feet = ("FL", "FR", "HL", "HR")
    held = [{"name": foot, "frame": f"{foot}_FOOT", "kind": "point"} for foot in feet]
    phases = [
        {"name": name, "steps": 4, "duration": 0.2, "hold": held[:count]}
        for name, count in (("stand", 4), ("lift", 3))
    ]
    given: dict[str, Any] = {"start": start, "phase": phases, "scheme": "se1", "goal": {"v": 0}}
    problem = Problem.create("solo12", cost=STILL, **given)
    still = mbocp.solve(problem, check=True)
    robot, table = problem.robot, problem.timeline.switches
    assert table is not None
    assert still.cost == pytest.approx(0.0, abs=1e-12)
    for step in (0, 3, 7):
        expected = smallest_controls(robot, still.qs[step], table.in_step(still.qs[step], step))
        np.testing.assert_allclose(still.us[step], expected, atol=1e-7)
    assert np.abs(still.us[0] - still.us[7]).max() > 0.1


def test_a_thruster_that_turns_with_its_link(tmp_path: Path) -> None:
    """On the second of two links, the first of which has a motor."""
    links = "".join(
        f'<link name="{name}"><inertial><origin xyz="0.5 0 0"/><mass value="1"/>'
        '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        for name in ("upper", "lower")
    )
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{x} 0 0"/><axis xyz="0 1 0"/>'
        '<limit lower="-9" upper="9" effort="99" velocity="9"/></joint>'
        for name, parent, child, x in (("shoulder", "base", "upper", 0), ("elbow", "upper", "lower", 1))
    )
    (tmp_path / "robot.urdf").write_text(f'<robot name="arm"><link name="base"/>{links}{joints}</robot>')
    (tmp_path / "robot.toml").write_text(
        '[[actuator]]\ntype = "joint"\njoint = "shoulder"\n'
        '[[actuator]]\ntype = "thruster"\nname = "jet"\nframe = "lower"\nposition = [1, 0, 0]\n'
    )
    q = {"shoulder": 0.3, "elbow": -0.7}
    goal = {"q": q, "v": 0}
    named = str(tmp_path / "robot.toml")
    problem = Problem.create(named, 0.5, 10, start={"q": q}, goal=goal, cost=STILL, scheme="midpoint")
    still = mbocp.solve(problem, check=True)
    assert still.cost == pytest.approx(0.0, abs=1e-12)
    forces = problem.robot.actuation_matrix(still.qs[0]) @ still.us[0]
    robot = problem.robot
    gravity = pin.computeGeneralizedGravity(robot.model, robot.model.createData(), still.qs[0])
    np.testing.assert_allclose(forces, gravity, atol=1e-7)


@pytest.mark.parametrize("acts", [(1, 1, 1), (1, 0, 1), (0, 0, 0)])
@pytest.mark.parametrize("count", [2, 4, 6])
def test_controls_beside_constraints(count: int, acts: tuple[int, ...]) -> None:
    """Values as NumPy has them, with too few controls and too many; derivatives as by differences."""
    rng = np.random.default_rng(count)
    pushes, ties = np.linalg.qr(rng.normal(size=(6, 6)))[0][:, :count], rng.normal(size=(3, 6, 2))
    force, at = rng.normal(size=6), ca.SX.sym("at", 2)
    acts_dm, J = ca.SX(ca.DM(acts)), ca.SX(ca.DM(ties[:, :, 0])) + at[0] * ca.DM(ties[:, :, 1]) * at[1]
    B = ca.SX(ca.DM(pushes)) * (1 + at[1])
    found = controls_beside(np.ones(count), B, J, acts_dm, ca.SX(ca.DM(force)))
    function = ca.Function("u", [at], [found, ca.jacobian(found, at)])
    weight = rng.normal(size=count)
    weighed = ca.dot(weight, found)
    slope = ca.Function("s", [at], [ca.gradient(weighed, at), ca.hessian(weighed, at)[0]])
    x = np.array([0.3, 0.2])
    rows = np.array(acts, dtype=bool)
    Jx, Bx = (ties[:, :, 0] + x[0] * x[1] * ties[:, :, 1])[rows], pushes * (1 + x[1])
    leaves = np.linalg.svd(Jx)[2][rows.sum() :]
    expected = np.linalg.lstsq(leaves @ Bx, leaves @ force, rcond=1e-9)[0]
    values = np.linalg.svd(leaves @ Bx, compute_uv=False)
    error = (3e-4 / values[values > 1e-9].min() ** 2) ** 6  # what the rounds leave, relatively
    bound = 1e-9 + error * np.abs(expected).max()
    np.testing.assert_allclose(np.array(function(x)[0])[:, 0], expected, rtol=0, atol=bound)
    for k, h in enumerate(1e-5 * np.eye(2)):
        by_differences = np.array(function(x + h)[0] - function(x - h)[0])[:, 0] / 2e-5
        np.testing.assert_allclose(np.array(function(x)[1])[:, k], by_differences, atol=1e-6)
        bend = np.array(slope(x + h)[0] - slope(x - h)[0])[:, 0] / 2e-5
        np.testing.assert_allclose(np.array(slope(x)[1])[:, k], bend, atol=1e-6)


def test_the_text_says_it() -> None:
    problem = arm({"effort": 0.0, "effort_about_gravity": 1.0})
    text = problem_to_toml(problem)
    assert "effort_about_gravity = 1" in text
    assert problem_to_toml(parse_problem(text)) == text
    assert "effort_about_gravity" not in problem_to_toml(arm({"effort": 1.0}))


@pytest.mark.parametrize(
    ("cost", "words", "message"),
    [
        ({"effort_about_gravity": -1.0}, {}, "effort_about_gravity"),
        ({"effort": 0.0, "effort_about_gravity": [1, 1, 1, 1, 1, 0]}, {}, "cost.effort"),
        ({"effort_about_gravity": 1.0}, {"coordinates": "natural"}, 'are for coordinates = "joint"'),
    ],
)
def test_what_is_refused(cost: dict[str, Any], words: dict[str, Any], message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        mbocp.solve(arm(cost, **words))

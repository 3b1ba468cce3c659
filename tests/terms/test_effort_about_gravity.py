"""`cost.effort_about_gravity`: what it costs beyond holding the weight, and where there is none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.problem import Problem, parse_problem, problem_to_toml
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


def test_what_is_held_besides_is_refused() -> None:
    cost = {"effort_about_gravity": 1.0}
    with pytest.raises(ProblemError, match=r"effort_about_gravity: .*carries a part of the weight"):
        Problem.create("four_bar", 1.0, 10, goal={"q": {"crank": 1.5}}, cost=cost)


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

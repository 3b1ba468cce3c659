"""Path constraints on all of the robot: values beside Pinocchio's, motions that keep them, refusals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp._files import parse_toml
from mbocp.exceptions import ProblemError
from mbocp.problem import Problem, parse_problem, problem_to_toml
from tests.problem.file.test_ground import solo, steps

BOTH = [
    {"kind": "centre_of_mass", "x": [-9, 9], "y": [-9, 9], "z": [-9, 9]},
    {"kind": "angular_momentum", "x": [-99, 99], "y": [-99, 99], "z": [-99, 99]},
]


@pytest.mark.parametrize("name", ["ur5", "solo12", "double_pendulum", "four_bar", "talos_legs"])
def test_values_are_pinocchios(name: str) -> None:
    robot = mbocp.load_robot(name)
    problem = Problem.create(robot, 1.0, 4, path=BOTH, goal={"v": 0}, scheme="se1")
    rng, data = np.random.default_rng(2), robot.model.createData()
    for _ in range(3):
        q = pin.randomConfiguration(robot.model, -np.ones(robot.nq), np.ones(robot.nq))
        v, u = rng.normal(size=robot.nv), np.zeros((1, robot.nu))
        centre, momentum = (one.values_along(robot, q[None], v[None], u)[0] for one in problem.path)
        assert np.allclose(centre, pin.centerOfMass(robot.model, data, q), atol=1e-12)
        wanted = pin.computeCentroidalMomentum(robot.model, data, q, v).angular
        assert np.allclose(momentum, wanted, atol=1e-11 * (1.0 + np.abs(wanted).max()))


def test_a_stand_shifts_its_weight_without_a_turn() -> None:
    """The centre of mass goes to a place, and the momentum about it stays small."""
    goal_of_centre = {"kind": "centre_of_mass", "name": "weight", "y": [0.03, 0.03], "from": {"share": 1.0}}
    quiet = {"kind": "angular_momentum", "name": "turn", **{axis: [-0.02, 0.02] for axis in "xyz"}}
    phase = steps(["FL", "FR", "HL", "HR"], count=12)
    phase[0]["duration"] = 0.5
    problem = solo(phase, path=[goal_of_centre, quiet], cost={"effort": 1.0, "velocity": 0.01})
    solution = mbocp.solve(problem, check=True)
    robot = problem.robot
    data = robot.model.createData()
    centres = np.array([pin.centerOfMass(robot.model, data, q).copy() for q in solution.qs])
    assert centres[-1][1] == pytest.approx(0.03, abs=1e-9)
    assert abs(centres[0][1]) < 0.01
    turns = [
        pin.computeCentroidalMomentum(robot.model, data, q, v).angular.copy()
        for q, v in zip(solution.qs, solution.vs, strict=True)
    ]
    assert np.abs(turns).max() < 0.02 + 1e-9
    assert solution.limit_violation < 1e-8
    labels = {label.name for one in problem.path for label in one.labels}
    assert {"weight.y", "turn.x", "turn.z"} <= labels


def test_the_text_says_it_without_a_frame() -> None:
    problem = Problem.create("ur5", 1.0, 4, path=BOTH, goal={"v": 0}, scheme="se1")
    text = problem_to_toml(problem)
    centre, _ = parse_toml(text)["path"]
    assert centre["kind"] == "centre_of_mass"
    assert "frame" not in centre
    assert problem_to_toml(parse_problem(text)) == text


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"kind": "centre_of_mass"}, r"path\.0: bounds nothing; give x, y or z"),
        ({"kind": "centre_of_mass", "frame": "tool0", "x": [0, 1]}, r"path\.0\.frame: .* all of the robot"),
        (
            {"kind": "angular_momentum", "max": 1.0},
            r"path\.0\.max: kind = .* does not use it",
        ),
        ({"kind": "position", "x": [0, 1]}, r"path\.0\.frame: this key is missing"),
    ],
)
def test_what_is_wrong_is_refused(table: dict[str, Any], words: str) -> None:
    with pytest.raises(ProblemError, match=words):
        Problem.create("ur5", 1.0, 4, path=[table], scheme="se1")

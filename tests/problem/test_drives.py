"""Problems of robots whose controls prescribe velocities and accelerations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from mbocp.exceptions import OverdeterminedGoal, ProblemError
from mbocp.problem import Problem, load_problem, parse_problem, problem_to_toml
from mbocp.robot import Robot, load_robot

from .conftest import EXAMPLES

GOAL = {"base_x": 0.5, "base_y": 0.5, "yaw": 1.0, "pendulum": [0, 0, 0, 1]}
REST = {"base_x": 0.0, "base_y": 0.0, "yaw": 0.0, "pendulum": [0, 0, 0]}


@pytest.fixture(scope="module")
def unicycle() -> Robot:
    return load_robot("unicycle_pendulum")


def make(robot: Robot, **words: Any) -> Problem:
    scheme = words.pop("scheme", "rk4")
    words = {"goal": {"q": GOAL, "v": REST}, "cost": {"control_rate": 1.0, "effort": 0}} | words
    return Problem.create(robot, 3.0, words.pop("steps", 20), scheme=scheme, **words)


def test_the_example_of_the_second_paper() -> None:
    problem = load_problem(EXAMPLES / "so3" / "unicycle_pendulum.toml")
    assert (problem.duration, problem.num_steps, problem.scheme, problem.lie) == (
        3.0,
        100,
        "rk4",
        "munthe_kaas",
    )
    np.testing.assert_allclose(problem.limits.u_upper, [2 * np.pi, 6.0])
    np.testing.assert_allclose(problem.limits.u_lower, [-2 * np.pi, -6.0])
    assert not problem.cost.effort.any()
    np.testing.assert_allclose(problem.cost.control_rate, [2e-3, 2e-3])
    assert problem.cost.potential == -1.0
    weights, where = problem.cost.tracking_weights, problem.robot.velocity_indices
    assert [float(weights[where(name)][0]) for name in ("base_x", "base_y", "yaw")] == [2.0, 2.0, 0.2]
    assert np.count_nonzero(weights) == 3
    tip = problem.robot.potential_energy(problem.goal.q) - problem.robot.potential_energy(problem.q_start)
    assert tip > 0.0  # from hanging to upright
    np.testing.assert_array_equal(problem.v_start, np.zeros(6))


@pytest.mark.parametrize("scheme", ["se1", "se2", "midpoint"])
def test_they_need_an_explicit_scheme(unicycle: Robot, scheme: str) -> None:
    with pytest.raises(
        ProblemError, match=r"prescribe velocities \(yaw_rate, forward\), which only explicit"
    ):
        make(unicycle, scheme=scheme)


def test_a_velocity_that_is_a_control_is_no_end_condition(unicycle: Robot) -> None:
    (yaw,) = (i for i, label in enumerate(unicycle.v_labels) if label.name == "yaw")
    for v in (REST, [0] * 6):
        goal = make(unicycle, goal={"q": GOAL, "v": v}).goal
        np.testing.assert_array_equal(np.flatnonzero(~goal.rate_active), [yaw])
    with pytest.raises(
        ProblemError, match=r"goal\.v: got 0\.5 for yaw, whose velocity is the control 'yaw_rat"
    ):
        make(unicycle, goal={"q": GOAL, "v": {"yaw": 0.5}})
    with pytest.raises(ProblemError, match=r"goal\.p: controls .* prescribe velocities .*; give v"):
        make(unicycle, goal={"q": GOAL, "p": [0] * 6})


def test_start_and_goal_move_as_the_drives_allow(unicycle: Robot) -> None:
    with pytest.raises(ProblemError, match=r"start\.v: .*'base_y'.* drive 'forward' allows"):
        make(unicycle, start={"v": {"base_y": 0.5}})
    np.testing.assert_array_equal(make(unicycle, start={"v": {"base_x": 0.5}}).v_start[:2], [0.5, 0])
    sideways = {**REST, "base_x": -np.sin(1.0), "base_y": np.cos(1.0)}
    with pytest.raises(ProblemError, match=r"goal\.v: the drives .* allow no velocity like this"):
        make(unicycle, goal={"q": GOAL, "v": sideways})
    ahead = {**REST, "base_x": np.cos(1.0), "base_y": np.sin(1.0)}
    make(unicycle, goal={"q": GOAL, "v": ahead})


def test_end_conditions_count_speeds(unicycle: Robot) -> None:
    assert make(unicycle).num_end_conditions == 10  # six of q, forward speed, three of the pendulum
    assert make(unicycle, goal={"q": GOAL}).num_end_conditions == 6
    with pytest.raises(OverdeterminedGoal, match=r"10 independent .* 4 steps with 2 controls .* at most 8"):
        make(unicycle, steps=4)


def test_a_partial_goal_reads_back(unicycle: Robot) -> None:
    problem = make(unicycle)
    again = parse_problem(problem_to_toml(problem))
    np.testing.assert_array_equal(problem.goal.rate_active, again.goal.rate_active)
    assert again.num_end_conditions == 10

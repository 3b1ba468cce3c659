"""Guesses of robots that walk: feet go along with the body, and stand under it at the goal."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from mbocp import Problem, load_problem
from mbocp._arrays import Array
from mbocp.formulation import formulate
from mbocp.guesses.straight_line import line
from mbocp.robot import Robot, load_robot

FEET = {foot: f"{foot}_FOOT" for foot in ("FL", "FR", "HL", "HR")}
WAY = (0.12, 0.05, 0.3)  # [m, m, rad]
GAITS = {"trot": 2, "pace": 2, "bound": 2, "hop": 2, "walk": 1}


def moved(robot: Robot) -> Array:
    """The start, further and turned."""
    x, y, yaw = WAY
    q = np.array(robot.q0)
    q[:2], q[3:7] = [x, y], [0, 0, np.sin(yaw / 2), np.cos(yaw / 2)]
    return q


def walks(word: str, **more: Any) -> Problem:
    robot = load_robot("solo12")
    gait = {"swings": word, "cycles": GAITS[word], "duration": 0.2, "steps": 6}
    gait |= {"stance": 0.2} if word == "hop" else {}
    ground = {"feet": FEET, "friction": 0.7}
    goal = {"q": moved(robot), "v": 0}
    return Problem.create(robot, gait=gait, ground=ground, **{"goal": goal, "cost": {"effort": 1.0}, **more})


def guess_of(problem: Problem) -> Array:
    formulation = formulate(problem)
    return formulation.motion_of(line(formulation)).qs


@cache
def guess_along(word: str) -> Array:
    return guess_of(walks(word))


def places(problem: Problem, qs: Array) -> Array:
    """Of the feet, shape (n, 4, 3)."""
    return np.array(
        [[problem.robot.frame_placement(foot, q).translation for foot in FEET.values()] for q in qs]
    )


@pytest.mark.parametrize("word", GAITS)
def test_it_ends_at_the_goal_with_feet_under_the_body(word: str) -> None:
    problem, qs = walks(word), guess_along(word)
    assert np.abs(problem.robot.difference(qs[-1], moved(problem.robot))).max() < 1e-8
    way = [pin.log3(pin.Quaternion(q[3:7]).matrix())[2] for q in qs]
    assert np.diff(qs[:, 0]).min() > -5e-3  # hardly back, before a hop
    assert np.diff(way).min() > -1e-2
    assert np.diff(qs[:, 0]).max() < 5 * np.diff(qs[:, 0]).mean()  # it moves on while feet stand


def test_knees_stay_bent_before_a_jump() -> None:
    problem = load_problem("examples/legged/solo12_jump.toml")
    knees = [at for at, label in enumerate(problem.robot.q_labels) if "KFE" in label.name]
    assert np.abs(guess_of(problem)[:, knees]).min() > 1.0  # rad


@pytest.mark.parametrize("word", ["trot", "walk"])
def test_a_goal_of_the_base_and_of_the_legs_is_the_same(word: str) -> None:
    problem = walks(word)
    robot, (x, y, yaw) = problem.robot, WAY
    legs = {label.name: angle for label, angle in zip(robot.q_labels[7:], robot.q0[7:], strict=True)}
    frame = {"name": "base_link", "position": [x, y, 0.235], "rpy": [0, 0, yaw]}
    other = walks(word, goal={"q": legs, "frame": frame, "v": 0})
    assert np.allclose(guess_along(word), guess_of(other), atol=1e-7)


def test_feet_that_stand_in_the_middle_of_a_trot_are_halfway_under_the_body() -> None:
    problem = walks("trot")
    qs = guess_along("trot")
    robot, feet = problem.robot, places(problem, qs)
    first, last = (places(problem, q[None])[0] for q in (robot.q0, moved(robot)))
    footholds = []
    for before, after in pairwise(feet[:, 0]):  # of the front left foot, which swings first
        if np.abs(after - before).max() < 1e-9 and not any(np.allclose(after, x) for x in footholds):
            footholds.append(after)
    assert len(footholds) == 2
    share = (footholds[0] - first[0])[:2] @ (last - first)[0, :2] / np.sum((last - first)[0, :2] ** 2)
    assert share == pytest.approx(3 / 8, abs=0.02)  # it stands from a quarter to half of the way
    assert np.allclose(footholds[1], last[0], atol=1e-8)


def test_a_foothold_that_is_said_is_kept() -> None:
    robot = load_robot("talos_legs")
    feet = {"left": "left_sole_link", "right": "right_sole_link"}
    there = robot.frame_placement(feet["right"], robot.q0).translation
    via = [{"frame": {"name": feet["right"], "x": there[0] + 0.2}}]
    phases = [
        {"name": "step", "steps": 6, "duration": 0.6, "contacts": ["left"], "via": via},
        {"name": "stand", "steps": 4, "duration": 0.4, "contacts": list(feet)},
    ]
    ground = {"feet": feet, "friction": 0.7, "sole": [0.2, 0.12]}
    problem = Problem.create(
        robot,
        phase=phases,
        ground=ground,
        goal={"v": 0, "frame": {"name": "base_link", "x": 0.1}},
        cost={"effort": 1e-3},
    )
    foot = problem.robot.frame_placement(feet["right"], guess_of(problem)[-1])
    assert foot.translation[[0, 2]] == pytest.approx([there[0] + 0.2, there[2]], abs=1e-7)
    assert foot.rotation[2] == pytest.approx(
        robot.frame_placement(feet["right"], robot.q0).rotation[2], abs=1e-7
    )

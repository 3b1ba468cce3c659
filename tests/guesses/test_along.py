"""Guesses along lines: the frame is on the line, the ends are those of the motion, nothing leaps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from mbocp.guesses.along import usual_way
from mbocp.guesses.ways import straight
from mbocp.problem import Problem

START = {"q": [0, -1.57, 1.57, -1.57, -1.57, 0]}
GOAL = {"v": 0, "frame": {"name": "tool0", "position": [0.45, -0.35, 0.3]}}
SHARES = np.linspace(0.0, 1.0, 41)


def arm(*kinds: dict[str, Any], goal: dict[str, Any] = GOAL, robot: Any = "ur5", **words: Any) -> Problem:
    path = [{"frame": "tool0", **kind} for kind in kinds]
    return Problem.create(
        robot, 1.5, 40, start=START, goal=goal, path=path, **{"integrator": {"scheme": "se1"}, **words}
    )


def off_line(problem: Problem, qs: Any) -> Any:
    places = np.array([problem.robot.frame_placement("tool0", q).translation for q in qs])
    shares = SHARES[:, None]
    return np.abs(places - (1 - shares) * places[0] - shares * places[-1]).max()


def test_the_tool_is_on_the_line() -> None:
    problem = arm({"kind": "line"})
    plain, qs = (way(problem)(problem.q_start, SHARES) for way in (straight, usual_way))
    assert off_line(problem, plain) > 0.01
    assert off_line(problem, qs) < 1e-8
    assert qs[0] == pytest.approx(problem.q_start, abs=1e-12)
    assert np.abs(np.diff(qs, axis=0)).max() < 0.2
    end = problem.robot.frame_placement("tool0", qs[-1]).translation
    assert end == pytest.approx(GOAL["frame"]["position"], abs=1e-9)  # type: ignore[index]


def test_it_keeps_its_orientation_and_ends_at_a_goal_of_joints() -> None:
    kept = arm({"kind": "line"}, {"kind": "orientation_kept"})
    qs = usual_way(kept)(kept.q_start, SHARES)
    turns = [kept.robot.frame_placement("tool0", q).rotation for q in qs]
    assert max(float(np.linalg.norm(pin.log3(turns[0].T @ R))) for R in turns) < 1e-8
    whole = arm({"kind": "line"}, goal={"q": qs[-1], "v": 0})
    ended = usual_way(whole)(whole.q_start, SHARES)
    assert off_line(whole, ended) < 1e-8
    assert ended[-1] == pytest.approx(qs[-1], abs=1e-12)


def test_without_a_line_all_the_time_the_way_is_straight() -> None:
    for problem in (arm(), arm({"kind": "orientation_kept"}), arm({"kind": "line", "until": 0.5})):
        ways = (way(problem)(problem.q_start, SHARES) for way in (straight, usual_way))
        assert np.array_equal(*ways)


def test_a_line_out_of_reach_leaves_the_way_straight() -> None:
    """A chord of the circle that a tool makes whose arm cannot bend."""
    stiff = {"name": "ur5", "lock": ["shoulder_lift_joint", "elbow_joint", "wrist_1_joint"]}
    line = [{"kind": "line", "frame": "tool0"}]
    ends = {"start": {"q": [-1.0, 0, 0]}, "goal": {"q": [1.0, 0, 0], "v": 0}}
    problem = Problem.create(stiff, 1.5, 40, path=line, **{"integrator": {"scheme": "se1"}, **ends})
    found = usual_way(problem)(problem.q_start, SHARES)
    assert np.array_equal(found, straight(problem)(problem.q_start, SHARES))

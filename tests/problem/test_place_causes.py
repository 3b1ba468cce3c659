"""Places that are asked for and forbidden: what is said is a proof."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.explain import planted, sound, verdict
from mbocp.problem import Problem
from mbocp.problem.reasons.causes import causes_of
from mbocp.robot import Robot, load_robot
from mbocp.robot.kinematics import reach

ROBOTS = {
    name: load_robot(name) for name in ("ur5", "double_pendulum", "panda", "cart_pendulum_rigid", "delta")
}


def problem(**words: Any) -> Problem:
    goal = {"q": [0.6, 0.4], "v": 0}
    return Problem.create("double_pendulum", 1.0, 20, goal=goal, **words)


def kinds(**words: Any) -> list[tuple[str, str]]:
    return [(cause.kind, cause.where) for cause in causes_of(problem(**words)) if cause.is_certain]


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=30)
@given(seed=st.integers(0, 2**31))
def test_no_frame_leaves_its_ball(name: str, seed: int) -> None:
    robot, rng = ROBOTS[name], np.random.default_rng(seed)
    lower = np.where(np.isfinite(robot.limits.position_lower), robot.limits.position_lower, -3.0)
    upper = np.where(np.isfinite(robot.limits.position_upper), robot.limits.position_upper, 3.0)
    q = robot.normalise(rng.uniform(lower, upper)) if robot.nq == robot.nv else robot.q0
    for frame in robot.frame_names:
        center, radius = ball(robot, frame)
        at = robot.frame_placement(frame, q).translation
        assert np.linalg.norm(at - center) <= radius + 1e-9


def ball(robot: Robot, name: str) -> tuple[np.ndarray, float]:
    frame, limits = robot.model.frames[robot.frame_id(name)], robot.limits
    ends = limits.position_lower, limits.position_upper
    return reach(robot.model, frame.parentJoint, frame.placement.translation, *ends)


def box(name: str, axis: str, low: float, high: float, **span: float) -> dict[str, Any]:
    return {"name": name, "kind": "position", "frame": "link2", axis: [low, high], **span}


def test_walls_exclude_each_other_only_where_both_hold() -> None:
    a, b = box("a", "x", -9, 0.01), box("b", "x", 0.03, 9)
    during, later = {"from": 0.3, "until": 0.5}, {"from": 0.6, "until": 0.8}
    assert kinds(path=[{**a, **during}, {**b, **during}]) == [("contradiction", "a")]
    assert kinds(path=[{**a, **during}, {**b, **later}]) == []
    assert kinds(path=[{**a, **during}, box("b", "z", -0.5, 9, **during)]) == []
    touching = [box("a", "x", -9, 0.01, **during), box("b", "x", 0.01, 9, **during)]
    assert kinds(path=touching) == []


def test_out_of_reach_names_the_distance() -> None:
    far = box("far", "x", 30.0, 40.0, **{"from": 0.4, "until": 0.6})
    (cause,) = causes_of(problem(path=[far]))
    assert (cause.kind, cause.where, cause.is_certain) == ("reach", "far", True)
    center, radius = ball(ROBOTS["double_pendulum"], "link2")
    assert f"{30.0 - center[0]:.4g} m from the base" in cause.words
    assert f"reach {radius:.4g} m" in cause.words
    assert kinds(path=[box("near", "x", radius * 0.5, 40.0, **{"from": 0.4, "until": 0.6})]) == []


def test_all_that_was_planted_is_named_and_nothing_else() -> None:
    found = [(one.kind, one.where, verdict(one)) for one in planted(["double_pendulum"], seed=3)]
    assert len(found) == 25
    assert [entry for entry in found if entry[2].outcome != "named"] == []
    assert {verdict(one).outcome for one in sound(["double_pendulum"], seed=3)} == {"silent"}

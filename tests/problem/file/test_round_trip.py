"""What is written of a problem reads back as the same problem, whatever keys it has."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.robot import load_robot

REST = st.sampled_from([0.0, {"elbow_joint": 0.0}, [0.0, 0.1, 0.0, 0.0, 0.0, 0.0]])
POSE = {"name": "tool0", "position": [0.35, 0.45, 0.25]}
FRAMES = st.sampled_from([POSE, {**POSE, "position_tolerance": 0.01}])
GOALS = st.fixed_dictionaries(
    {},
    optional={
        "q": st.sampled_from([{"elbow_joint": 1.2}, {"wrist_3_joint": 0.4, "wrist_2_joint": -1.0}]),
        "v": REST,
        "a": st.one_of(REST, st.just("free")),
        "frame": FRAMES,
    },
).filter(lambda goal: goal.keys() - {"a"} and not {"q", "frame"} <= goal.keys())
STARTS = st.fixed_dictionaries(
    {"q": st.just([0.0, -1.57, 1.57, -1.57, -1.57, 0.0])},
    optional={"v": st.just({"elbow_joint": 0.2}), "a": st.sampled_from([0.0, {"elbow_joint": -3.0}])},
)
LIMITS = st.fixed_dictionaries(
    {},
    optional={
        "velocity": st.just(True),
        "effort": st.just(True),
        "acceleration": st.sampled_from([20.0, {"elbow_joint": [-15.0, 20.0]}]),
        "jerk": st.sampled_from([500.0, {"elbow_joint": 400.0}]),
        "effort_rate": st.just(3e3),
    },
)
REMAINING = st.fixed_dictionaries(
    {
        "duration": st.sampled_from([1.0, {"min": 0.2, "max": 5.0}]),
        "scheme": st.sampled_from(["", "se1", "gauss2", "rk4"]),
    },
    optional={
        "via": st.just([{"name": "there", "share": 0.5, "q": {"elbow_joint": 1.4}}]),
        "controls": st.just("linear"),
    },
).filter(lambda words: "controls" not in words or words["scheme"] == "gauss2")


@settings(max_examples=12, suppress_health_check=[HealthCheck.too_slow])
@given(start=STARTS, goal=GOALS, limits=LIMITS, words=REMAINING)
def test_what_is_written_reads_back_as_the_same(
    start: dict[str, Any], goal: dict[str, Any], limits: dict[str, Any], words: dict[str, Any]
) -> None:
    cost = {"effort": 1.0, "velocity": 1.0}
    robot = load_robot("ur5")
    problem = Problem.create(robot, steps=20, start=start, goal=goal, limits=limits, cost=cost, **words)
    text = problem_to_toml(problem)
    again = parse_problem(text)
    assert problem_to_toml(again) == text
    for name in ("q_start", "v_start", "a_start"):
        assert np.array_equal(getattr(again, name), getattr(problem, name)), name
    for name in ("q_active", "value", "rate_active", "a", "a_active"):
        assert np.array_equal(getattr(again.goal, name), getattr(problem.goal, name)), name
    assert again.goal.a_rule == problem.goal.a_rule
    for letter in ("u", "v", "q", "a", "j", "du"):
        for side in ("lower", "upper"):
            name = f"{letter}_{side}"
            assert np.array_equal(getattr(again.limits, name), getattr(problem.limits, name)), name
    assert (again.duration_range, again.scheme) == (problem.duration_range, problem.scheme)

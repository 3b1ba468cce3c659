"""Rest where jerks are limited: no acceleration is left at the end, and motions begin with the one before."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.cli.check import words_of_rest
from mbocp.exceptions import MbocpError
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.robot import Robot
from mbocp.solution import Solution

GOAL = {"q": [1.0, 0.0], "v": 0.0}
FREE = {"min": 0.1, "max": 5.0}
LEAST = {"time": 1.0, "effort": 1e-7}


def pendulum(goal: dict[str, Any] = GOAL, limits: dict[str, Any] | None = None, **words: Any) -> Problem:
    words = {"duration": FREE, "steps": 24, "cost": LEAST, "scheme": "se1", **words}
    limits = {"jerk": 100.0} if limits is None else limits
    return Problem.create(words.pop("robot", "double_pendulum"), goal=goal, limits=limits, **words)


def solved(problem: Problem) -> Solution:
    solution = mbocp.solve(problem)
    assert solution.converged, solution.advice
    return solution


def exact(distance: float, jerk: float, acceleration: float = math.inf, speed: float = math.inf) -> float:
    """Least time from rest to rest by the profile of up to seven pieces of constant jerk [s]."""
    peak = (jerk * distance**2 / 4.0) ** (1.0 / 3.0)  # four pieces
    if peak > acceleration**2 / jerk:
        lag = acceleration**2 / jerk
        peak = (math.sqrt(lag**2 + 4.0 * distance * acceleration) - lag) / 2.0
    peak = min(peak, speed)
    reached = min(acceleration, math.sqrt(jerk * peak))
    return peak / reached + reached / jerk + distance / peak


@pytest.mark.parametrize(
    ("limits", "steps", "bound"),
    [
        ({"jerk": 100.0}, 24, 1e-6),
        ({"jerk": 100.0, "acceleration": 6.0}, 96, 1e-3),
        ({"jerk": 100.0, "acceleration": 6.0, "velocity": 1.2}, 96, 1e-3),
    ],
)
def test_least_times_are_those_of_the_exact_profile(
    limits: dict[str, float], steps: int, bound: float
) -> None:
    values = (limits[key] for key in ("jerk", "acceleration", "velocity") if key in limits)
    least = exact(1.0, *values)
    found = solved(pendulum(limits=limits, steps=steps)).duration
    assert least * (1.0 - bound) <= found <= least * (1.0 + bound)  # means of steps know no sharper corners


def test_the_file_may_leave_the_last_acceleration_free() -> None:
    free = pendulum({**GOAL, "a": "free"})
    assert not free.goal.a_active.any()
    assert solved(free).duration < 0.95 * exact(1.0, 100.0)
    again = parse_problem(problem_to_toml(free))
    assert again.goal.a_rule == "free"
    assert again.with_(limits={"jerk": 50.0}).goal.a_rule == "free"


def test_it_follows_the_limits_and_goes_with_them() -> None:
    problem = pendulum(limits={"acceleration": 8.0})
    assert not problem.goal.a_active.any()
    limited = problem.with_(limits={"jerk": {"joint1": 90.0}})
    assert limited.goal.a_rule == "rest"
    assert limited.goal.a_active.tolist() == [True, False]
    assert "a = " not in problem_to_toml(limited).split("[goal]")[1].split("[cost]")[0]
    assert not limited.with_(limits=problem.limits).goal.a_active.any()
    assert not limited.with_(goal={"v": [1.0, 0.0]}).goal.a_active.any()
    assert limited.with_(goal={"a": 0.0}).goal.a_active.all()
    drawn = limited.with_(goal={"enforce": "penalty"}, cost={"terminal": 1.0}, limits={"jerk": 80.0})
    assert not drawn.goal.a_active.any()


@pytest.mark.parametrize(
    ("goal", "rests"),
    [
        ({"q": [1.0, 0.0], "p": 0.0}, [True, True]),
        ({"q": [1.0, 0.0], "v": [0.0, 1.0]}, [True, False]),
        ({"q": [1.0, 0.0]}, [False, False]),
    ],
)
def test_joints_that_stop_are_at_rest(goal: dict[str, Any], rests: list[bool]) -> None:
    assert pendulum(goal).goal.a_active.tolist() == rests


def test_a_frame_that_stops_every_joint_brings_rest(ur5: Robot) -> None:
    pose = {"name": "tool0", "position": [0.35, 0.45, 0.25], "velocity": 0.0}
    start = {"q": [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]}
    words: dict[str, Any] = {"robot": ur5, "start": start, "scheme": "midpoint"}
    assert not pendulum({"frame": pose}, **words).goal.a_active.any()  # six joints, three conditions
    assert pendulum({"frame": {**pose, "angular_velocity": 0.0}}, **words).goal.a_active.all()
    assert not pendulum({"frame": {**pose, "velocity": [0.1, 0, 0]}}, **words).goal.a_active.any()


def test_what_controls_cannot_set_stays_free_and_is_said() -> None:
    problem = pendulum(robot={"name": "double_pendulum", "actuated": ["joint1"]})
    assert not problem.goal.a_active.any()
    assert words_of_rest(problem) == "acceleration free: 1 control cannot set it"
    assert words_of_rest(pendulum()) == "a = 0 since jerk is limited"
    assert words_of_rest(pendulum({**GOAL, "a": "free"})) == "acceleration free"
    assert not words_of_rest(pendulum(limits={"acceleration": 8.0}))


def test_a_replan_goes_on_with_the_acceleration_of_the_plan() -> None:
    """The rest of an optimal motion is optimal: it takes as long, and from a = 0 longer."""
    plan = solved(pendulum())
    n = 6
    start = {"q": plan.qs[n], "v": plan.vs[n], "a": plan.accelerations[n - 1]}
    later = pendulum(start=start, steps=18)
    s = solved(later)
    assert s.duration == pytest.approx(plan.duration - plan.t[n], rel=1e-6)
    jerk = np.diff(np.vstack([later.a_start, s.accelerations]), axis=0) / (s.duration / 18)
    assert np.abs(jerk[:, 0]).max() <= 100.0 * (1.0 + 1e-6)
    assert s.limit_violation < 1e-6
    assert solved(later.with_(a_start=np.zeros(2))).duration > 1.01 * s.duration
    again = s.load_problem()
    assert np.array_equal(again.a_start, later.a_start)
    named = later.with_(start={"a": {"joint2": 0.5}})
    assert named.a_start.tolist() == [0.0, 0.5]


def test_a_replan_that_forgets_the_acceleration_is_told() -> None:
    plan = solved(pendulum())
    later = pendulum(start={"q": plan.qs[6], "v": plan.vs[6]}, steps=18)
    with pytest.warns(
        UserWarning, match=r"start\.a of joint1 is 0 rad/s\^2 where that has 15.7.*acceleration_at\(6\)"
    ):
        s = mbocp.solve(later, warm_start=plan)
    kept = mbocp.solve(later.with_(a_start=plan.acceleration_at(6)), warm_start=plan)
    assert kept.converged
    assert kept.duration < s.duration
    assert kept.iterations <= s.iterations


def test_another_acceleration_compiles_nothing() -> None:
    from mbocp.formulation import formulate

    keys = [formulate(pendulum(start={"a": [a, 0.0]})).pieces.signature for a in (0.0, 3.0)]
    assert keys[0] == keys[1]


@pytest.mark.parametrize(
    ("a", "message"),
    [
        ([1.0], r"start\.a"),
        ([1.0, math.nan], r"start\.a"),
        ([1.0, 9.0], r"start\.a: joint2 is 9 rad/s\^2, above its limit 8 in limits\.acceleration"),
        ("free", r"start\.a: "),
        (1.0, r"start\.a: got 1"),
    ],
)
def test_accelerations_that_cannot_be_are_refused(a: Any, message: str) -> None:
    with pytest.raises(MbocpError, match=message):
        pendulum(limits={"acceleration": 8.0}, start={"a": a})


def test_a_result_is_not_lost_where_a_frame_and_accelerations_are_asked_for(ur5: Robot) -> None:
    goal = {"frame": {"name": "tool0", "position": [0.35, 0.45, 0.25]}, "v": 0.0, "a": 0.0}
    start = {"q": [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]}
    words: dict[str, Any] = {"scheme": "midpoint", "duration": 1.0, "steps": 20}
    words["cost"] = {"effort": 1.0, "velocity": 1.0}
    s = solved(pendulum(goal, {}, robot=ur5, start=start, **words))
    assert np.abs(s.accelerations[-1]).max() < 1e-6
    assert s.load_problem().goal.a_active.all()

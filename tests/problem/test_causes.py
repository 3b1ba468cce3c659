"""What arithmetic says against a problem: planted causes are named, solvable problems have none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbocp.problem import Problem, load_problem
from mbocp.problem.causes import causes_of
from mbocp.problem.least_time import least_time

EXAMPLES = Path(__file__).parents[2] / "examples"
pytestmark = pytest.mark.filterwarnings("ignore")
GOAL = {"q": [2.0, -0.7, 1.5, -2.3, -1.57, 0.8], "v": 0}
START = {"q": [0, -1.57, 0, -1.57, 0, 0]}


def arm(duration: float = 2.0, steps: int = 100, **words) -> Problem:
    return Problem.create("ur5", duration, steps, start=START, **{"goal": GOAL, **words})


def first(problem: Problem) -> tuple[str, str, bool]:
    cause = causes_of(problem)[0]
    return cause.kind, cause.where, cause.is_certain


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_least_times_are_those_of_bang_coast_bang(sign):
    rest = {"to_rate": 0.0}
    assert least_time(sign * 2.0, 4.0) == 0.5
    assert least_time(sign * 1.0, acceleration=4.0, **rest) == pytest.approx(1.0)
    assert least_time(sign * 3.0, 1.0, 2.0, **rest) == pytest.approx(3.5)
    assert least_time(sign * 1.0, acceleration=2.0) == pytest.approx(1.0)  # arrives at speed
    assert least_time(sign * 1.5, 2.0, 2.0, from_rate=sign, to_rate=sign * 1.0) == pytest.approx(1.0)
    assert least_time(0.0, acceleration=2.0, from_rate=sign * 3.0, to_rate=0.0) == pytest.approx(1.5)
    assert least_time(sign * 1.0, jerk=12.0, **rest) == pytest.approx(1.0)


def test_no_motion_of_random_accelerations_is_faster():
    rng = np.random.default_rng(0)
    for _ in range(200):
        a, dt = rng.uniform(0.5, 3.0), 1e-3
        pieces = np.repeat(rng.uniform(-a, a, 8), 100)
        v0 = rng.uniform(-1.0, 1.0)
        v = v0 + np.cumsum(pieces) * dt
        d = float(np.sum(v - 0.5 * pieces * dt) * dt)
        least = least_time(d, max(np.abs(v).max(), abs(v0)), a, from_rate=v0, to_rate=float(v[-1]))
        assert least <= 0.8 + 1e-9


@pytest.mark.parametrize(
    ("problem", "expected"),
    [
        (lambda: arm(0.5, limits={"velocity": True}), ("speed", "shoulder_pan_joint", True)),
        (lambda: arm(1.0, limits={"acceleration": 5.0}), ("acceleration", "shoulder_pan_joint", True)),
        (lambda: arm(1.0, limits={"jerk": 20.0}), ("jerk", "shoulder_pan_joint", True)),
        (lambda: arm(0.2, limits={"effort": True}), ("torque", "shoulder_lift_joint", False)),
        (lambda: arm(4.0, limits={"effort": 20.0}), ("weight", "shoulder_lift_joint", False)),
        (
            lambda: arm(path=[{"name": "slow", "kind": "speed", "frame": "tool0", "max": 0.2}]),
            ("frame_speed", "slow", True),
        ),
        (
            lambda: arm(
                via=[{"name": "gate", "time": 0.3, "q": [2.0, -1, 0, 0, 0, 0]}], limits={"velocity": 3.0}
            ),
            ("speed", "shoulder_pan_joint", True),
        ),
        (
            lambda: arm(steps=2, goal={**GOAL, "q": [3.0, -0.7, 1.5, -2.3, -1.57, 0.8]}),
            ("steps", "shoulder_pan_joint", False),
        ),
    ],
    ids=["speed", "acceleration", "jerk", "torque", "weight", "frame", "via", "steps"],
)
def test_what_is_planted_is_named(problem, expected):
    assert first(problem()) == expected


def test_the_words_have_the_numbers():
    (cause, *_) = causes_of(load_problem(EXAMPLES / "arms/ur5_limits.toml", {"horizon.duration": 0.6}))
    assert cause.words == (
        "shoulder_pan_joint needs 0.698 s for 2.2 rad to the goal at its 3.15 rad/s; the horizon is 0.6 s"
    )


def test_a_base_without_a_motor_falls():
    still = Problem.create("solo12", 1.0, 50, goal={"v": 0}).q_start
    (cause, *_) = causes_of(Problem.create("solo12", 1.0, 50, goal={"q": still, "v": 0}))
    assert (cause.kind, cause.is_certain) == ("fall", True)
    assert "4.9" in cause.words


@pytest.mark.parametrize(
    "name", ["arms/ur5_limits", "arms/minimum_time", "arms/via_points", "free_flyer/gates", "loops/stewart"]
)
def test_nothing_is_said_against_what_has_a_solution(name):
    assert causes_of(load_problem(EXAMPLES / f"{name}.toml")) == ()

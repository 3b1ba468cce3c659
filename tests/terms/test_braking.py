"""Joints that can always stop before their limits."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbocp
from mbocp.exceptions import ProblemError
from mbocp.job import Job
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.solution import Status
from mbocp.solution.curves import Curves
from mbocp.solution.later import retold
from mbocp.strategies import OneSolve, RoomToBrake
from mbocp.terms.kinds import Braking

DECELERATION, RESERVE, LIMIT = 1.5, 0.2, 1.0
BRAKING: dict[str, Any] = {
    "kind": "braking",
    "frame": "joint1",
    "deceleration": DECELERATION,
    "reserve": RESERVE,
    "max": LIMIT,
    "min": -2.0,
}


def swing(*path: dict[str, Any], **words: Any) -> Problem:
    robot = mbocp.load_robot("double_pendulum", damping=False)
    return Problem.create(robot, 1.6, 30, goal={"q": [0.95, -0.4], "v": 0}, cost={}, path=path, **words)


@given(q=st.floats(-2.0, 1.0), v=st.floats(-3.0, 3.0))
def test_it_says_what_a_limit_of_the_velocity_says(q: float, v: float) -> None:
    """-sqrt(2 a (q - q_min)) + v_0 <= v <= sqrt(2 a (q_max - q)) - v_0, as far as v is not in the reserve."""
    (constraint,) = swing(BRAKING).path
    highest, lowest = constraint.values(
        mbocp.load_robot("double_pendulum"), np.array([q, 0.3]), np.array([v, 1.0])
    )
    is_kept = highest <= LIMIT and lowest >= -2.0
    above = v <= -RESERVE or v + RESERVE <= np.sqrt(2.0 * DECELERATION * (LIMIT - q))
    below = v >= RESERVE or RESERVE - v <= np.sqrt(2.0 * DECELERATION * (q + 2.0))
    assert is_kept == (above and below) or abs(highest - LIMIT) < 1e-9 or abs(lowest + 2.0) < 1e-9


def test_a_motion_keeps_it_and_would_not_do_so_by_itself() -> None:
    bound = {"velocity": 4.0}
    alone = mbocp.solve(swing(limits=bound), check=True)
    s = mbocp.solve(swing(BRAKING, limits=bound), check=True)

    def left_over(s: mbocp.Solution) -> float:
        q, v = s.qs[:, 0], s.vs[:, 0]
        return float((v + RESERVE - np.sqrt(2.0 * DECELERATION * np.maximum(LIMIT - q, 0.0))).max())

    assert left_over(alone) > 0.3
    assert left_over(s) < 1e-6
    assert s.cost > alone.cost
    assert list(s.path_names) == ["braking of joint1.max", "braking of joint1.min"]


@pytest.mark.parametrize("sides", [{"max": 1.0}, {"min": -1.0}, {"min": -1.0, "max": 1.0}])
def test_it_reads_back(sides: dict[str, float]) -> None:
    keys = {**{key: value for key, value in BRAKING.items() if key not in ("min", "max")}, **sides}
    problem = swing(keys)
    again = parse_problem(problem_to_toml(problem))
    for one, other in zip(problem.path, again.path, strict=True):
        np.testing.assert_array_equal(one.lower, other.lower)
        np.testing.assert_array_equal(one.upper, other.upper)
        assert one.term == other.term
        assert one.numbers == other.numbers


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frame": "link1"}, "no joint with one angle"),
        ({"deceleration": 0.0}, "above 0"),
        ({"reserve": -1.0}, "0 or above"),
        ({"deceleration": None}, "deceleration: this key is missing"),
        ({"min": None, "max": None}, "give min or max"),
        ({"max": 0.9}, "at the goal braking of joint1.max"),
    ],
)
def test_what_it_cannot_be(changes: dict[str, Any], words: str) -> None:
    table = {key: value for key, value in {**BRAKING, **changes}.items() if value is not None}
    with pytest.raises(ProblemError, match=words):
        swing(table)


def test_a_joint_that_slides_is_refused() -> None:
    robot = mbocp.load_robot("cart_pendulum_elastic")
    name = next(label.name for label in robot.v_labels if label.unit == "m/s")
    with pytest.raises(ProblemError, match="no joint with one angle"):
        Problem.create(robot, 1.0, 10, path=[{**BRAKING, "frame": name}])


def cut_corner() -> Problem:
    """In steps so long that they cut a corner of the limit."""
    return Problem.create(
        mbocp.load_robot("double_pendulum", damping=False),
        {"min": 0.2, "max": 4.0},
        16,
        start={"q": [-1.0, 0.0]},
        goal={"q": [0.9, 0.0], "v": 0},
        cost={"time": 1.0, "effort": 1e-4},
        limits={"acceleration": 12.0, "velocity": 2.0},
        path=[{**BRAKING, "reserve": 0.0, "min": -9.0}],
    )


def missing_reserve(s: mbocp.Solution) -> float:
    q, v = (x[:, 0] for x in curves_of(s).places(20)[1][:2])
    return Braking.missing_reserve(cut_corner().path[0], q, v)


@dataclass(frozen=True)
class Reluctant:
    """Solves from no motion that is known already, or never with more reserve than was asked for."""

    needs_guess: bool

    def run(self, job: Job) -> mbocp.Solution:
        found = OneSolve().run(job)
        has_more = job.problem.path[0].number("reserve")[0] > 0.0
        fails = job.start is not None if self.needs_guess else has_more
        return retold(found, status=Status.LINE_SEARCH_FAILED) if fails else found


def test_more_reserve_is_had_from_the_guess_where_it_is_not_from_the_motion() -> None:
    s = RoomToBrake(Reluctant(needs_guess=True)).run(Job.of(cut_corner()))
    assert s.is_stationary
    assert missing_reserve(s) <= 2e-4


def test_a_reserve_that_is_not_had_is_told() -> None:
    s = RoomToBrake(Reluctant(needs_guess=False)).run(Job.of(cut_corner()))
    assert s.is_stationary
    told = re.search(r"falls short of its reserve: braking of joint1 by ([0-9.]+) rad/s", s.advice)
    assert told is not None
    assert float(told[1]) == pytest.approx(missing_reserve(s), rel=0.2)


def test_it_holds_between_nodes_too() -> None:
    """Where long steps cut a corner, nodes get more reserve until the cubics between them keep it."""
    problem = cut_corner()
    s = mbocp.solve(problem, check=True)
    alone = OneSolve().run(Job.of(problem))
    assert missing_reserve(alone) > 0.01
    assert missing_reserve(s) <= 2e-4
    assert alone.duration < s.duration < 1.1 * alone.duration
    assert any(phase.name == "reserves at nodes" for phase in s.phases)
    (constraint,) = s.load_problem().path
    assert constraint.number("reserve") == pytest.approx([0.0])


def curves_of(s: mbocp.Solution) -> Curves:
    return Curves(s.t, s.qs, s.vs)

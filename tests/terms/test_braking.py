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
from mbocp.formulation import Motion, formulate
from mbocp.job import Job
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.solution import Status
from mbocp.solution.curves import Curves
from mbocp.solution.later import retold
from mbocp.strategies import OneSolve, RoomToBrake
from mbocp.terms.kinds import Braking
from tests.formulation.stages import check_derivatives

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


def cut_corner(controls: str = "constant", steps: int = 16, **changes: float) -> Problem:
    """In steps so long that they cut a corner of the limit."""
    return Problem.create(
        mbocp.load_robot("double_pendulum", damping=False),
        {"min": 0.2, "max": 4.0},
        steps,
        start={"q": [-1.0, 0.0]},
        goal={"q": [0.9, 0.0], "v": 0},
        cost={"time": 1.0, "effort": 1e-4},
        limits={"acceleration": 12.0, "velocity": 2.0},
        path=[{**BRAKING, "reserve": 0.0, "min": -9.0, **changes}],
        controls=controls,
    )


def find_missing_reserve(s: mbocp.Solution) -> float:
    q, v = (x[:, 0] for x in Curves(s.t, s.qs, s.vs).places(20)[1][:2])
    return Braking.find_missing_reserve(cut_corner().path[0], q, v)


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
    assert find_missing_reserve(s) <= 2e-4


def test_a_reserve_that_is_not_had_is_told() -> None:
    s = RoomToBrake(Reluctant(needs_guess=False)).run(Job.of(cut_corner()))
    assert s.is_stationary
    told = re.search(r"falls short of its reserve: braking of joint1 by ([0-9.]+) rad/s", s.advice)
    assert told is not None
    assert float(told[1]) == pytest.approx(find_missing_reserve(s), rel=0.2)


def test_nodes_get_more_reserve_where_controls_are_constant() -> None:
    """Where long steps cut a corner, until the cubics between them keep it."""
    problem = cut_corner()
    s, alone = mbocp.solve(problem, check=True), OneSolve().run(Job.of(problem))
    assert find_missing_reserve(alone) > 0.01
    assert find_missing_reserve(s) <= 2e-4
    assert alone.duration < s.duration < 1.1 * alone.duration
    assert any(phase.name == "reserves at nodes" for phase in s.phases)
    (constraint,) = s.load_problem().path
    assert constraint.number("reserve") == pytest.approx([0.0])


def test_it_holds_within_long_steps_and_costs_little() -> None:
    s, fine = (mbocp.solve(cut_corner("stages", steps), check=True) for steps in (16, 48))
    assert find_missing_reserve(s) <= 1e-6
    assert fine.duration < s.duration < 1.01 * fine.duration
    assert not any(phase.name == "reserves at nodes" for phase in s.phases)
    within = [name for name in s.path_names if name.startswith("braking") and "steps" in name]
    assert len(within) == 4
    check_derivatives(formulate(cut_corner("stages")), 2, [0, 3, 4])


def test_multipliers_are_what_the_time_gains_from_a_farther_limit() -> None:
    s, step = mbocp.solve(cut_corner("stages"), check=True), 1e-4
    nearer, farther = (
        mbocp.solve(cut_corner("stages", max=LIMIT + d), check=True).cost for d in (-step, step)
    )
    own = s.lam_path[:, [name.startswith("braking of joint1.max") for name in s.path_names]]
    within = s.lam_path[:, [name.startswith("braking of joint1.max ") for name in s.path_names]]
    assert within.sum() > 0.05 * own.sum()
    assert (farther - nearer) / (2.0 * step) == pytest.approx(-own.sum(), rel=1e-3)


@given(seed=st.integers(0, 10_000))
def test_no_place_of_a_cubic_is_beyond_what_states_remember(seed: int) -> None:
    rng = np.random.default_rng(seed)
    formulation = formulate(cut_corner("linear", 4, reserve=RESERVE))
    qs, vs = rng.uniform(-1.0, 1.0, (2, 5, 2))
    qs[0], vs[0] = [-1.0, 0.0], 0.0  # where it starts
    dts = rng.uniform(0.06, 0.9) * np.ones(4)
    xs = formulation.iterate_of(Motion(qs, vs, np.zeros((4, 2)), dts), np.zeros((4, 0))).xs
    remembered = xs[1:, formulation.layout.states["braking_within"]].reshape(4, 2, 2)
    (path,) = formulation.problem.path
    at = Curves(np.append(0.0, np.cumsum(dts)), qs, vs).places(20)[1]
    values = path.values_along(formulation.problem.robot, at[0], at[1], np.zeros_like(at[0]))
    nodes = path.values_along(formulation.problem.robot, qs, vs, np.zeros_like(qs))
    for k, (within, own) in enumerate(zip(values.reshape(4, 21, 2), remembered, strict=True)):
        corners = np.vstack([nodes[k : k + 2], own])
        assert (within[:, 0] <= corners[:, 0].max() + 1e-9).all()
        assert (within[:, 1] >= corners[:, 1].min() - 1e-9).all()

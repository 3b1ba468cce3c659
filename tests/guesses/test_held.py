"""Guesses of problems in which something is held: held at every node, wanted where it is asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import mbocp
from mbocp import Problem
from mbocp._arrays import Array
from mbocp.formulation import formulate
from mbocp.formulation.features.changing_constraints import measure_switched_violation
from mbocp.guesses.straight_line import is_whole, line
from mbocp.robot import Robot
from tests.holds.cases import CASES
from tests.phases.test_partings import cell

ROBOT = cell()
ANGLES = st.floats(-3.0, 3.0, allow_nan=False)
PAIRS = st.tuples(ANGLES, ANGLES).map(list)


def carried(begin: list[float], via: dict[str, Any], **more: Any) -> Problem:
    """A pendulum carries a ball that is welded to its tip, and leaves it in the world."""
    robot = ROBOT
    q = np.array(robot.q0)
    q[:2] = begin
    tip = robot.frame_placement("arm/tip", q)
    held = [*tip.translation.tolist(), *pin.Quaternion(tip.rotation).coeffs().tolist()]
    grip = {"name": "grip", "frame": "ball/body", "to": "arm/tip"}
    phases = [
        {"name": "carry", "steps": 16, "duration": 0.8, "hold": [grip], "via": [via]},
        {"name": "leave", "steps": 4, "duration": 0.3, "hold": [{"name": "place", "frame": "ball/body"}]},
    ]
    words: dict[str, Any] = {
        "start": {"q": {"arm": begin, "ball": held}},
        "goal": {"q": {"arm": [0.5, 0.2]}, "v": {"arm": [0.0, 0.0]}},
        "cost": {"effort": 1.0, "velocity": 0.1},
        "scheme": "midpoint",
        "guess": {"kind": "line"},
    }
    return Problem.create(robot, phase=phases, **{"integrator": {"scheme": "se1"}, **words, **more})


def at(angles: list[float]) -> dict[str, Any]:
    return {"q": {"arm": angles}, "v": {"arm": [0.0, 0.0]}}


def guess_of(problem: Problem) -> tuple[Array, Array]:
    formulation = formulate(problem)
    motion = formulation.motion_of(line(formulation))
    return motion.qs, motion.vs


def off(problem: Problem, qs: Array, vs: Array) -> float:
    table = problem.timeline.switches
    assert table is not None
    return measure_switched_violation(table, qs, vs).position


def weld_angles(robot: Robot, qs: Array) -> Array:
    """Angle by which the ball has turned in the hand: rows of a weld vanish at half turns, too."""
    turns = [
        robot.frame_placement("arm/tip", q).rotation.T @ robot.frame_placement("ball/body", q).rotation
        for q in qs
    ]
    return np.array([np.linalg.norm(pin.log3(turns[0].T @ turn)) for turn in turns])


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(begin=PAIRS, via=PAIRS)
def test_what_is_held_is_held_at_every_node(begin: list[float], via: list[float]) -> None:
    problem = carried(begin, at(via))
    qs, vs = guess_of(problem)
    assert off(problem, qs, vs) < 1e-9
    assert weld_angles(problem.robot, qs[:18]).max() < 1e-8
    assert np.abs(np.diff(qs[17:, 2:5], axis=0)).max() < 1e-9  # left where it was let go
    np.testing.assert_allclose(qs[17, :2], via, atol=1e-9)
    quaternions = qs[:, 5:9]
    assert np.einsum("ni,ni->n", quaternions[1:], quaternions[:-1]).min() > 0.0
    table = problem.timeline.switches
    assert table is not None
    for step in problem.impacts:
        assert np.abs(table.in_step(qs[step + 1], step) @ vs[step + 1]).max() < 1e-9


@pytest.mark.parametrize("scheme", ["se1", "midpoint"])
@pytest.mark.parametrize("name", CASES)
def test_all_kinds_of_holds_and_loops(name: str, scheme: str) -> None:
    problem = CASES[name](scheme)
    assert off(problem, *guess_of(problem)) < 1e-9


def test_the_hand_goes_where_the_ball_is_wanted() -> None:
    robot = ROBOT
    q = np.array(robot.q0)
    q[:2] = 1.2, 0.8
    place = robot.frame_placement("arm/tip", q).translation
    problem = carried(
        [0.3, 0.4], {"frame": {"name": "ball/body", "y": float(place[1]), "z": float(place[2])}}
    )
    qs, vs = guess_of(problem)
    assert off(problem, qs, vs) < 1e-9
    there = problem.timeline.waypoints[0].node
    np.testing.assert_allclose(qs[there, 2:5], place, atol=1e-8)
    np.testing.assert_allclose(qs[-1, 2:5], place, atol=1e-8)  # the goal says nothing of the ball


def test_a_goal_of_the_arm_is_whole_where_the_rest_is_held() -> None:
    problem = carried([0.3, 0.4], at([1.0, 0.5]))
    assert is_whole(problem)
    free = Problem.create(ROBOT, 0.5, 8, goal={"q": {"arm": [0.5, 0.2]}}, scheme="midpoint")
    assert not is_whole(free)


def test_motors_balance_what_is_carried() -> None:
    """A guess at rest is a motion at rest: the hand carries the weight of the ball."""
    problem = carried([0.5, 0.2], at([0.5, 0.2]))
    formulation = formulate(problem)
    iterate = line(formulation)
    found = mbocp.solve(problem, check=True)
    at_rest = formulation.motion_of(iterate)
    assert np.abs(at_rest.vs).max() < 1e-12
    held = [k for k, label in enumerate(formulation.constraint_labels) if label.name.startswith("grip")]
    lams = formulation.duals_of(iterate, at_rest).lams[:15, held[:3]]
    np.testing.assert_allclose(np.linalg.norm(lams, axis=1), 0.3 * 9.81, rtol=1e-6)
    assert found.iterations <= 5

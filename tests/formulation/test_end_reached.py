"""A motion that meets the end condition somewhere else than at the goal has not converged."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp._arrays import null_space
from mbocp.cli.app import app
from mbocp.exceptions import NotConverged
from mbocp.formulation import Motion, formulate
from mbocp.formulation.end_reached import RateMiss, miss_of_end, miss_of_rates
from mbocp.formulation.end_rows import end_condition_rows
from mbocp.formulation.features.changing_constraints import ties_at_end
from mbocp.formulation.formulate import without_end_rows
from mbocp.guesses import in_turn, starts
from mbocp.problem import Problem
from mbocp.problem.problem import problem_from_tables
from mbocp.solution import Status

FLYER = Path(__file__).parents[2] / "examples" / "optima" / "robots" / "free_flyer" / "robot.toml"

SWING = {
    "robot": {"name": "double_pendulum", "damping": False},
    "coordinates": "natural",
    "horizon": {"duration": 1.5, "steps": 30},
    "start": {"q": [0.0, 0.0]},
    "integrator": {"scheme": "se1"},
    "goal": {"q": [np.pi, 0.0], "v": [0.0, 0.0]},
}


def swing(**tables: Any) -> Problem:
    """Turn the first link of a hanging double pendulum by half."""
    return problem_from_tables({**SWING, **tables})


def formulated(problem: Problem, *, counts_turns: bool = True) -> Any:
    """What is asked of a formulation, without its functions."""
    return SimpleNamespace(problem=problem, counts_turns=counts_turns)


def test_half_a_turn_off_is_another_root() -> None:
    """Hanging still meets the end condition in natural coordinates, at no cost."""
    s = mbocp.solve(swing(guess={"kind": "hold"}))
    assert s.status is Status.OTHER_ROOT
    assert s.is_stationary
    assert not s.converged
    np.testing.assert_allclose(s.qs[-1], 0.0, atol=1e-6)
    assert "3.14 off goal.q" in s.advice
    with pytest.raises(NotConverged, match="other_root"):
        mbocp.solve(swing(guess={"kind": "hold"}), check=True)


def test_another_guess_is_tried_where_it_was_left_to_mbocp(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(starts, "kinds_in_turn", lambda problem: iter(("hold", "joint")))
    s = mbocp.solve(swing(cost={"velocity": 1.0}))
    assert s.converged, s.advice
    assert abs(s.qs[-1, 0]) == pytest.approx(np.pi, abs=1e-6)
    assert len(s.history) > s.iterations  # the guess that failed is part of the history
    monkeypatch.setattr(starts, "kinds_in_turn", lambda problem: iter(("hold", "control")))
    s = mbocp.solve(swing(solver={"max_iterations": 6}, cost={}))
    assert s.status is Status.OTHER_ROOT  # no other guess leads anywhere: that says most


def test_the_command_fails_and_says_why(tmp_path: Path) -> None:
    path = tmp_path / "swing.toml"
    path.write_text(
        'robot = {name = "double_pendulum", damping = false}\ncoordinates = "natural"\n'
        "horizon = {duration = 1.5, steps = 30}\nstart = {q = [0, 0]}\n"
        'goal = {q = [3.141592653589793, 0], v = [0, 0]}\nguess = {kind = "hold"}\n'
    )
    found = CliRunner().invoke(app, ["solve", str(path), "--json"])
    assert found.exit_code == 1
    assert json.loads(found.stdout)["status"] == "other_root"


def test_whole_turns_are_the_goal_where_bodies_do_not_count_them() -> None:
    formulation = formulated(swing(goal={"q": [0.5, 0.2], "v": [0.0, 0.0]}), counts_turns=False)
    there = np.array([[0.0, 0.0], [0.5 - 2 * np.pi, 0.2 + 4 * np.pi]])
    missed = miss_of_end(formulation, there)
    assert missed is not None
    assert not missed.is_other_root
    assert "whole turns" in missed.words
    half = miss_of_end(formulation, there + np.array([0.0, np.pi]))
    assert half is not None
    assert half.is_other_root
    assert miss_of_end(formulation, np.array([[0.0, 0.0], [0.5, 0.2]])) is None


def test_joint_coordinates_count_turns() -> None:
    formulation = formulated(swing(coordinates="joint", goal={"q": [0.5, 0.2], "v": [0.0, 0.0]}))
    missed = miss_of_end(formulation, np.array([[0.0, 0.0], [0.5 - 2 * np.pi, 0.2]]))
    assert missed is not None
    assert missed.is_other_root


def test_drift_off_the_loops_is_no_other_root() -> None:
    """The end of an explicit scheme is as far off as the loops are open; on another branch they are shut."""
    robot = mbocp.load_robot("five_bar")
    q0 = np.array(robot.q0)
    given = {"start": {"q": q0}, "goal": {"q": q0, "v": np.zeros(robot.nv)}}
    formulation = formulated(Problem.create(robot, 1.0, 10, scheme="heun", **given))
    open_ = miss_of_end(formulation, np.array([q0, q0 + 1e-3 * np.arange(1, robot.nq + 1)]))
    assert open_ is not None
    assert not open_.is_other_root
    assert "drifts off the loops" in open_.words


def a_jump() -> Problem:
    """A quadruped that lands where its feet come down: where they stand is found with the motion."""
    feet = [{"name": leg, "frame": f"{leg}_FOOT", "kind": "point"} for leg in ("FL", "FR", "HL", "HR")]
    tables = {
        "robot": {"name": "solo12"},
        "start": {"q": {"root_joint": [0, 0, 0.235, 0, 0, 0, 1]}},
        "phase": [
            {"name": "push", "steps": 4, "duration": 0.3, "hold": feet},
            {"name": "flight", "steps": 4, "duration": 0.2},
            {"name": "land", "steps": 4, "duration": 0.3, "hold": feet},
        ],
        "goal": {"v": 0, "frame": {"name": "base_link", "position": [0.2, 0, 0.235], "rpy": [0, 0, 0]}},
        "integrator": {"scheme": "se1"},
    }
    return problem_from_tables(tables)


def standing(problem: Problem, hip: float, knee: float) -> np.ndarray:
    """Configuration of `a_jump` above its goal whose four legs are bent alike [rad]."""
    q = problem.goal.q.copy()
    for leg, (side, way) in enumerate([(1, 1), (-1, 1), (1, -1), (-1, -1)]):
        q[7 + 3 * leg : 10 + 3 * leg] = 0.1 * side, way * hip, -way * knee
    return q


@pytest.mark.filterwarnings("ignore:points are held wherever")
@pytest.mark.parametrize("knee", [0.01, 1.6])
def test_a_body_at_rest_says_that_the_legs_on_which_it_stands_are(knee: float) -> None:
    """However they are bent: of conditions on legs, some leave the body free where one is stretched."""
    problem = a_jump()
    chosen = standing(problem, 0.8, knee)
    ties, bent = ties_at_end(problem, chosen), ties_at_end(problem, standing(problem, 0.8, 1.6))
    assert bent is not None
    rows = end_condition_rows(problem.robot, replace(problem.goal, q=chosen), ties=ties)
    np.testing.assert_array_equal(rows.D_rate, np.eye(problem.robot.nv)[:6])
    assert np.linalg.svd(np.vstack([rows.D_rate, bent[1]]))[1].min() > 0.02


def test_an_arm_at_rest_says_that_its_load_is_at_rest() -> None:
    """Wherever the motion ends: of conditions on both, some say nothing where the arm is singular."""
    arm = {"name": "arm", "robot": "ur5"}
    load = {"name": "load", "mass": 1.0, "box": [0.1, 0.1, 0.1]}
    held = {"frame": "arm/tool0", "to": "load/body"}
    problem = problem_from_tables(
        {
            "robot": {"part": [arm, load]},
            "start": {"q": {"arm": [0.0, -1.57, 1.57, -1.57, -1.57, 0.0], "load": [3.0, 0, 0, 0, 0, 0, 1]}},
            "phase": [
                {"name": "reach", "steps": 4, "duration": 1.0},
                {"name": "carry", "steps": 4, "duration": 1.0, "hold": [held]},
            ],
            "goal": {"v": 0.0},
        }
    )
    assert problem.robot.is_load.tolist() == [False] * 6 + [True] * 6
    ties = ties_at_end(problem, problem.goal.q)
    rows = end_condition_rows(problem.robot, problem.goal, ties=ties)
    np.testing.assert_array_equal(rows.D_rate, np.eye(12)[:6])


def test_what_motors_act_on_through_springs_or_thrust_is_no_load() -> None:
    assert not mbocp.load_robot(FLYER).is_load.any()
    elastic = [{"joint": "elbow_joint", "stiffness": 1e3, "motor_inertia": 0.1}]
    joints = mbocp.load_robot("ur5", elastic=elastic, actuated=["elbow_joint"])
    assert not joints.is_load.any()


def at_speeds(problem: Problem, v: np.ndarray) -> Motion:
    """A motion that ends at the goal with these velocities."""
    qs, vs = np.array([problem.q_start, problem.goal.q]), np.array([0.0 * v, v])
    return Motion(qs, vs, np.zeros((1, problem.robot.nu)), np.ones(1))


def test_velocities_that_the_goal_does_not_have_are_told() -> None:
    formulation = formulated(swing(coordinates="joint", goal={"q": [0.5, 0.2], "v": [0.0, 0.0]}))
    assert miss_of_rates(formulation, at_speeds(formulation.problem, np.array([1e-9, 0.0]))) is None
    missed = miss_of_rates(formulation, at_speeds(formulation.problem, np.array([0.0, 0.3])))
    assert missed is not None
    assert missed.is_free
    assert "joint2 ends 0.3 rad/s off goal.v" in missed.words
    momenta = formulated(swing(coordinates="joint", goal={"q": [0.5, 0.2], "p": [0.0, 0.0]}))
    found = miss_of_rates(momenta, at_speeds(momenta.problem, np.array([0.0, 0.3])))
    assert found is not None
    assert "off goal.p" in found.words


def test_what_the_scheme_leaves_across_the_constraints_is_no_other_root() -> None:
    robot = mbocp.load_robot("four_bar")
    problem = Problem.create(robot, 1.0, 4, goal={"q": robot.q0, "v": 0}, scheme="midpoint")
    across = robot.constraint_jacobian(robot.q0)[0]
    missed = miss_of_rates(formulated(problem), at_speeds(problem, across))
    assert missed is not None
    assert not missed.is_free
    assert "take more steps" in missed.words
    along = null_space(robot.constraint_jacobian(robot.q0), 1e-9)[:, 0]
    assert miss_of_rates(formulated(problem), at_speeds(problem, along + 1e-3 * across)).is_free  # type: ignore[union-attr]
    both = at_speeds(problem, 1e-3 * along + across)
    assert miss_of_rates(formulated(problem), both).is_small  # type: ignore[union-attr]
    large = miss_of_rates(formulated(problem), both, is_strict=False)
    assert large is not None
    assert not large.is_free
    assert miss_of_rates(formulated(problem), at_speeds(problem, 0.0 * across), is_strict=False) is None


@pytest.mark.parametrize(
    ("scheme", "status", "words"),
    [
        ("midpoint", "converged", r"rocker ends [\de.-]+ rad/s off goal.v: the scheme leaves it across"),
        ("heun", "converged", r"drifts off the loops by up to [\d.]+ at pin\.[xz], t = "),
        ("euler", "under_resolved", r"drifts off the loops by up to [\d.]+ at pin\.[xz], t = "),
        ("lobatto3", "converged", ""),
        ("se1", "converged", ""),
    ],
)
def test_what_a_scheme_leaves_of_loops_is_said(scheme: str, status: str, words: str) -> None:
    goal, stop = {"q": {"crank": 2.5}, "v": 0}, {"share": 0.5, "v": 0}
    steps = 10 if scheme == "euler" else 20
    problem = Problem.create("four_bar", 0.6, steps, goal=goal, via=[stop], scheme=scheme)
    s = mbocp.solve(problem)
    assert str(s.status) == status, s.advice
    if words:
        assert re.search(words + ".*: take more steps, or the scheme lobatto3 or se1", s.advice), s.advice
        assert status != "converged" or re.search(r"via '1': \w+ passes [\de.-]+ rad/s off its v: ", s.advice)
    else:
        assert "the scheme" not in s.advice
        assert np.abs(s.vs[[10, -1]]).max() < 1e-9


def test_a_motion_that_is_not_at_rest_has_not_converged(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Whatever the cause: here a row of the end condition was lost."""
    whole = in_turn.formulate_with_independent_ends
    monkeypatch.setattr(
        in_turn,
        "formulate_with_independent_ends",
        lambda *given: (without_end_rows(whole(*given)[0], [3]), ""),
    )
    monkeypatch.setattr(in_turn, "with_rates_at_end", lambda *given: given[:2])
    problem = swing(coordinates="joint", goal={"q": [1.0, 0.0], "v": [0.0, 0.0]}, cost={"velocity": 0.1})
    s = mbocp.solve(problem)
    assert s.status is Status.OTHER_ROOT
    assert abs(s.vs[-1, 1]) > 1e-3
    assert "joint2 ends" in s.advice
    assert "off goal.v" in s.advice


def test_the_end_is_looked_at_again_where_the_motion_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows that say nothing of the end that is found give way to those that do."""
    problem = Problem.create(
        "four_bar", 0.5, 10, goal={"q": {"crank": 2.5}, "v": 0}, cost={"velocity": 1.0}, scheme="se1"
    )
    right = formulate(problem)
    settings = {"rounds": 0}
    real = in_turn.miss_of_rates

    def missed_once(formulation: Any, motion: Any) -> Any:
        settings["rounds"] += 1
        return RateMiss(True, "elsewhere") if settings["rounds"] == 1 else real(formulation, motion)

    monkeypatch.setattr(in_turn, "miss_of_rates", missed_once)
    blind = without_end_rows(right, [len(right.end_rows.of_joints) - 1])
    monkeypatch.setattr(in_turn, "formulate_with_independent_ends", lambda *given: (blind, ""))
    s = mbocp.solve(problem)
    assert settings["rounds"] == 2
    assert s.converged, s.advice
    assert np.abs(s.vs[-1]).max() < 1e-2 * np.abs(s.vs).max()

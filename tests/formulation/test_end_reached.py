"""A motion that meets the end condition somewhere else than at the goal has not converged."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp.cli.app import app
from mbocp.exceptions import NotConverged
from mbocp.formulation.end_reached import end_missed
from mbocp.guesses import starts
from mbocp.problem import Problem
from mbocp.problem.file.build import problem_from_tables
from mbocp.solution import Status

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
    missed = end_missed(formulation, there)
    assert missed is not None
    assert not missed.is_other_root
    assert "whole turns" in missed.words
    half = end_missed(formulation, there + np.array([0.0, np.pi]))
    assert half is not None
    assert half.is_other_root
    assert end_missed(formulation, np.array([[0.0, 0.0], [0.5, 0.2]])) is None


def test_joint_coordinates_count_turns() -> None:
    formulation = formulated(swing(coordinates="joint", goal={"q": [0.5, 0.2], "v": [0.0, 0.0]}))
    missed = end_missed(formulation, np.array([[0.0, 0.0], [0.5 - 2 * np.pi, 0.2]]))
    assert missed is not None
    assert missed.is_other_root


def test_drift_off_the_loops_is_no_other_root() -> None:
    """The end of an explicit scheme is as far off as the loops are open; on another branch they are shut."""
    robot = mbocp.load_robot("five_bar")
    q0 = np.array(robot.q0)
    given = {"start": {"q": q0}, "goal": {"q": q0, "v": np.zeros(robot.nv)}}
    formulation = formulated(Problem.create(robot, 1.0, 10, scheme="heun", **given))
    open_ = end_missed(formulation, np.array([q0, q0 + 1e-3 * np.arange(1, robot.nq + 1)]))
    assert open_ is not None
    assert not open_.is_other_root
    assert "drifts off the loops" in open_.words

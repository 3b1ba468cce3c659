"""Via points and lines in a replay."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.problem import Problem, load_problem
from mbocp.view.marks import marks_of, marks_of_result
from mbocp.view.replay import write_replay
from tests.view.pages import read_page


def test_via_points_are_balls_axes_and_boxes_and_lines_are_drawn(tmp_path: Path) -> None:
    place = [0.3, 0.35, 0.5]
    goal = {"name": "tool0", "position": [0.4, -0.2, 0.4]}
    via = [
        {"share": 0.25, "frame": {"name": "tool0", "position": place, "rpy": [3.0, 0.2, 0.4]}},
        {"share": 0.5, "frame": {"name": "tool0", "position": place, "position_tolerance": [0.1, 0.2, 0.05]}},
        {"share": 0.75, "q": [0.1] * 6},
    ]
    path = [{"kind": "line", "frame": "tool0", "tolerance": 1.0}]
    problem = Problem.create("ur5", 1.0, 8, goal={"v": 0, "frame": goal}, via=via, path=path, scheme="se1")
    qs = np.tile(problem.q_start, (9, 1))
    page = read_page(
        write_replay(problem.robot, np.linspace(0, 1, 9), qs, tmp_path / "via.html", marks=marks_of(problem))
    )
    assert len(page.objects("/replay/world/via/0")) == 1 + 3
    assert len(page.objects("/replay/world/via/1")) == 12
    assert len(page.objects("/replay/world/via")) == 16
    assert len(page.objects("/replay/world/lines")) == 1
    assert page.transform("/replay/world/via/0/ball")[:3, 3] == pytest.approx(place)


@pytest.mark.parametrize("file", ["arms/straight_line", "arms/via_points", "free_flyer/gates"])
def test_results_say_as_much_as_their_problems(file: str, tmp_path: Path) -> None:
    problem = load_problem(Path(__file__).parents[2] / "examples" / f"{file}.toml", {"horizon.steps": 20})
    solved = mbocp.solve(problem.with_(solver={"max_iterations": 1}))
    saved = mbocp.Solution.load(solved.save(tmp_path / "result.h5"))
    found, expected = marks_of_result(saved, problem.robot), marks_of(problem)
    passed = [
        saved.t[point.node] / saved.t[-1]
        for point in problem.timeline.waypoints
        for _ in point.via.goal.poses
    ]
    assert [mark.share for mark in found.via] == pytest.approx(passed)
    for mine, other in zip(found.via, expected.via, strict=True):
        assert mine.goal.target.position == pytest.approx(other.goal.target.position)
        assert (mine.goal.position_tolerance is None) == (other.goal.position_tolerance is None)
    for line, wanted in zip(found.lines, expected.lines, strict=True):
        assert np.array(line) == pytest.approx(np.array(wanted))

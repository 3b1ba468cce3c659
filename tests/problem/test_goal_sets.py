"""Several goals: the best of them is taken, and what is out of reach is left out."""

from __future__ import annotations

import json
import pickle
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.cli.solution_summary import solution_rows
from mbocp.exceptions import OverdeterminedGoal, ProblemFileError, UnreachableGoal
from mbocp.problem import Problem, ProblemWarning, parse_problem, problem_to_toml
from mbocp.problem.goals.frames import pose_errors
from mbocp.robot import FrameTarget, load_robot
from mbocp.solution import Solution
from mbocp.solution import active_limits as limits
from mbocp.view.meshcat.goals import goal_commands, goal_placements
from mbocp.view.of_solution import goals_of

NEAR = {"frame": {"name": "tool0", "position": [0.45, 0.25, 0.35]}}
FAR = {"frame": {"name": "tool0", "position": [-0.45, 0.3, 0.35]}}
BEYOND = {"frame": {"name": "tool0", "position": [2.0, 0.0, 0.3]}}
START = {"q": [0.3, -1.2, 1.4, -1.5, -1.5, 0.0]}


def posed(*goals: dict[str, Any], **options: Any) -> Problem:
    goal = {"v": 0, "any": list(goals)}
    return Problem.create(
        "ur5",
        1.0,
        15,
        start=START,
        goal=goal,
        cost={"velocity": 50.0},
        **{"integrator": {"scheme": "se1"}, **options},
    )


def test_the_nearer_of_two_poses_is_taken() -> None:
    problem = posed(FAR, NEAR)
    solution = mbocp.solve(problem, check=True)
    assert [start.goal for start in solution.starts] == [0, 1]
    assert solution.goal_place == 1
    assert solution.cost == solution.starts[1].cost < solution.starts[0].cost
    assert "goal.any.1" in solution.guess_used
    alone = [mbocp.solve(problem.with_(goal={"v": 0, "any": [goal]})) for goal in (FAR, NEAR)]
    assert [s.cost for s in solution.starts] == pytest.approx([s.cost for s in alone], rel=1e-8)
    reached = problem.member(1)
    assert pose_errors(problem.robot, reached.goal, solution.q_final).positions.max() < 1e-7
    assert np.abs(solution.vs[-1]).max() < 1e-7  # v = 0 is common to both
    [distance] = 1e3 * pose_errors(problem.robot, reached.goal, solution.q_final).positions
    assert f"off by {distance:.2e} mm" in solution.goal_error
    rows = dict(solution_rows(solution, "ur5"))
    assert str(rows["starts"]).index("goal.any.1") < str(rows["starts"]).index("goal.any.0")


def test_one_out_of_reach_is_left_out_with_a_warning() -> None:
    with pytest.warns(ProblemWarning, match=r"goal\.any\.0\.frame: out of reach .* left out") as told:
        problem = posed(BEYOND, NEAR)
    assert len(told) == 1
    assert [place for place, _ in problem.members] == [1]
    assert len(problem.goals) == 2
    solution = mbocp.solve(problem, check=True)
    assert [start.goal for start in solution.starts] == [1]
    assert solution.goal_place == 1


def test_all_out_of_reach_is_an_error() -> None:
    with pytest.raises(UnreachableGoal, match=r"all 2 goals are out of reach; goal\.any\.0.*; goal\.any\.1"):
        posed(BEYOND, {"frame": {"name": "tool0", "x": 3.0}})


def test_configurations_modulo_whole_turns() -> None:
    turn = 2.0 * np.pi
    q = np.array([2.9, -1.2, 1.4, -1.5, -1.5, 0.0])
    goals = [{"q": q + turn * np.array([k, 0, 0, 0, 0, 0])} for k in (0, -1)]
    start = {"q": [-2.5, -1.2, 1.4, -1.5, -1.5, 0.0]}
    problem = Problem.create(
        "ur5", 1.0, 15, start=start, goal={"v": 0, "any": goals}, cost={"velocity": 50.0}, scheme="se1"
    )
    solution = mbocp.solve(problem, check=True)
    assert solution.goal_place == 1  # 0.88 rad back, not 5.4 rad ahead
    assert solution.q_final == pytest.approx(np.asarray(goals[1]["q"]), abs=1e-7)
    assert solution.cost < 0.4 * solution.starts[0].cost


def test_goals_of_several_shapes_and_several_starts(tmp_path: Path) -> None:
    other = {"q": [0.5, -1.0, 1.2, -1.4, -1.4, 0.2], "v": {"elbow_joint": 0.0}}
    problem = posed(NEAR, other, solver={"starts": 2})
    assert problem.members[1][1].goal.rate_active.sum() == 1  # its own v, not the common one
    solution = mbocp.solve(problem, check=True)
    assert sorted(start.goal for start in solution.starts) == [0, 0, 1, 1]
    assert solution.cost == pytest.approx(min(start.cost for start in solution.starts), rel=1e-8)
    saved = Solution.load(solution.save(tmp_path / "set.h5"))
    assert saved.goal_place == solution.goal_place
    assert saved.starts == solution.starts
    assert [entry["goal"] for entry in json.loads(saved.to_json())["starts"]] == [0, 0, 1, 1]


def test_they_are_written_and_read_back() -> None:
    problem = posed(FAR, NEAR | {"enforce": "exact"})
    again = parse_problem(problem_to_toml(problem))
    assert problem_to_toml(again) == problem_to_toml(problem)
    assert len(again.goals) == 2
    assert [place for place, _ in again.members] == [0, 1]
    assert len(pickle.loads(pickle.dumps(problem)).members) == 2
    moved = parse_problem(problem_to_toml(problem), ["goal.any.0.frame.0.position=[-0.4,0.3,0.3]"])
    assert moved.goals[0].frames[0].target.position == pytest.approx([-0.4, 0.3, 0.3])
    assert moved.goals[1].frames[0].target.position == pytest.approx([0.45, 0.25, 0.35])


def test_overrides_reach_into_them(tmp_path: Path) -> None:
    path = tmp_path / "set.toml"
    path.write_text(
        'robot = "ur5"\n[horizon]\nduration = 1.0\nsteps = 15\n[goal]\nv = 0\n'
        "[[goal.any]]\nq = [0.2, -1.2, 1.4, -1.5, -1.5, 0.0]\n"
        '[[goal.any]]\nframe = { name = "tool0", position = [0.45, 0.25, 0.35] }\n'
    )
    problem = mbocp.load_problem(path, {"goal.any.1.frame.position": [0.4, 0.2, 0.3]})
    assert problem.goals[1].frames[0].target.position == pytest.approx([0.4, 0.2, 0.3])
    assert problem.goals[0].q_active.all()
    assert all(goal.rate_active.all() for goal in problem.goals)


def test_parts_of_a_problem_change() -> None:
    problem = posed(FAR, NEAR)
    slower = problem.with_(duration=2.0, cost={"velocity": 10.0})
    assert len(slower.members) == 2
    assert all(member.duration == 2.0 and member.cost.velocity[0] == 10.0 for _, member in slower.members)
    free = problem.with_(goal={"v": {"elbow_joint": 0.0}})
    assert [goal.rate_active.sum() for goal in free.goals] == [1, 1]
    assert [goal.frames[0].name for goal in free.goals] == ["tool0", "tool0"]
    one = problem.with_(goal=problem.member(1).goal)
    assert not one.goals
    assert mbocp.solve(one).goal_place is None


def test_what_cannot_be_a_set_is_refused() -> None:
    with pytest.raises(ProblemFileError, match=r"goal\.any\.1: asks for nothing"):
        Problem.create("ur5", 1.0, 15, goal={"any": [NEAR, {}]})
    with pytest.raises(ProblemFileError, match=r"goal\.any\.0\.frame") as caught:
        Problem.create("ur5", 1.0, 15, goal={"any": [{"frame": {"name": "tool0"}}]})
    assert "tool0" in str(caught.value)
    with pytest.raises(ProblemFileError, match=r"goal\.any\.0\.q"):
        Problem.create("ur5", 1.0, 15, goal={"any": [{"q": [0.0, 1.0]}]})
    with pytest.raises(ProblemFileError, match=r"goal\.any\.0\.pose: unknown key; where a tool should be is"):
        Problem.create("ur5", 1.0, 15, goal={"any": [{"pose": [0.0, 1.0]}]})
    with pytest.raises(ProblemFileError, match=r"give cost\.target"):
        Problem.create("ur5", 1.0, 15, goal={"any": [NEAR]}, cost={"tracking": 1.0})
    with pytest.raises(ProblemFileError, match=r"goal\.any\.1: gives other components"):
        Problem.create(
            "ur5", 1.0, 15, cost={"terminal": 1.0},
            goal={"enforce": "penalty", "any": [{"q": [0.0] * 6}, {"q": {"elbow_joint": 0.0}}]},
        )  # fmt: skip
    with pytest.raises(OverdeterminedGoal, match=r"goal\.any\.0: 12 independent"):
        Problem.create("ur5", 1.0, 1, goal={"v": 0, "any": [{"q": [0.1] * 6}]})


def test_warnings_are_told_once() -> None:
    far = {"q": [7.0, -1.0, 1.0, 0.0, 0.0, 0.0]}
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        Problem.create("ur5", 1.0, 15, start=far, goal={"v": 0, "any": [NEAR, FAR]}, scheme="se1")
    about_start = [entry for entry in told if "start.q" in str(entry.message)]
    assert len(about_start) == 1


def test_tolerances_are_those_of_the_goal_that_is_taken() -> None:
    box = {"frame": {**NEAR["frame"], "position_tolerance": 0.01}}
    wide = {"frame": {**FAR["frame"], "position_tolerance": 0.02}}
    solution = mbocp.solve(posed(wide, box), check=True)
    assert solution.goal_place == 1
    found = [limit for limit in limits.active_limits(solution) if limit.kind == "path"]
    assert found
    assert {abs(limit.bound) for limit in found} == {0.01}


def test_replays_draw_the_others_faint() -> None:
    ours, others = goals_of(posed(FAR, NEAR), 1)
    assert [t.position[0] for t in ours if t.position is not None] == [0.45]
    assert [t.position[0] for t in others if t.position is not None] == [-0.45]
    robot = load_robot("ur5")
    targets = [FrameTarget(**NEAR["frame"]), FrameTarget(**FAR["frame"])]
    placed = goal_placements(robot, targets, robot.q0)
    drawn = [str(command.lower()) for command in goal_commands(targets, placed, "/world", 1.0, bold=1)]
    faint = ["'opacity': 0.3" in command for command in drawn]
    assert faint == [False] * 4 + [True] * 3 + [False]


def test_the_example_takes_the_other_side() -> None:
    problem = mbocp.load_problem(Path(__file__).parents[2] / "examples" / "arms" / "either_side.toml")
    solution = mbocp.solve(problem)
    assert solution.converged
    costs = [start.cost for start in solution.starts]
    assert solution.goal_place == 1
    assert solution.cost == min(costs) < 0.8 * max(costs)

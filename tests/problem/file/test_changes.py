"""`Problem.with_` takes fields and the words of `Problem.create`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mbocp._files import parse_toml
from mbocp.exceptions import MbocpError, ProblemError
from mbocp.problem import Problem, load_problem
from mbocp.problem.file.tables import problem_to_toml, tables_of, to_toml, write_tables
from mbocp.robot import Robot

EXAMPLES = Path(__file__).parents[3] / "examples"
GOAL = [0.5, -1.0, 1.0, 0.0, 0.5, 0.0]


@pytest.fixture
def problem(ur5: Robot) -> Problem:
    return Problem.create(ur5, 1.0, 20, goal={"q": GOAL, "v": 0}, cost={"velocity": 2.0, "effort": 3.0})


def test_tables_change_the_keys_that_are_given(problem: Problem) -> None:
    other = problem.with_(start={"q": {"elbow_joint": 0.25}}, cost={"velocity": 1.0}, steps=30)
    assert other.num_steps == 30
    assert other.q_start[2] == 0.25
    assert (other.cost.velocity == 1.0).all()
    assert (other.cost.effort == 3.0).all()
    np.testing.assert_array_equal(other.goal.q, problem.goal.q)
    assert other.robot is problem.robot
    assert other.name == problem.name


def test_without_changes_it_is_the_same_problem(problem: Problem) -> None:
    for words in ({}, {"start": {}}, {"cost": {}, "solver": {}}):
        assert problem_to_toml(problem.with_(**words)) == problem_to_toml(problem)


def test_every_word_of_create(problem: Problem) -> None:
    tube = {"kind": "speed", "frame": "tool0", "max": 2.0}
    other = problem.with_(
        limits={"effort": 100.0},
        path=[tube],
        guess={"kind": "hold"},
        integrator={"scheme": "midpoint"},
        solver={"tolerance": 1e-8},
        goal={"p": [0.0] * 6},
        duration=2.0,
    )
    assert other.limits.finite("u").all()
    assert other.path[0].upper[0] == 2.0
    assert (other.guess.kind, other.scheme, other.goal.rate) == ("hold", "midpoint", "p")
    assert (other.solver.tolerance, other.solver.method, other.duration) == (1e-8, "auto", 2.0)


def test_path_constraints_of_other_tables_stay() -> None:
    """Feet on the ground, motors whose gears are found; whether a path is given by tables or by objects."""
    for name, frame in (("legged/solo12_trot", "base_link"), ("design/gear_ratio", "tool0")):
        problem = load_problem(EXAMPLES / f"{name}.toml")
        names = {row.name for row in problem.path}
        assert names
        with_table = problem.with_(path=[{"kind": "position", "frame": frame, "z": [-5, 5]}])
        own = [row for row in with_table.path if row.name not in names]
        for path in (own, [*problem.path, *own]):
            other = problem.with_(path=path)
            assert [row.name for row in other.path] == [row.name for row in with_table.path]
        assert {row.name for row in other.with_(path=()).path} == names
    assert not other.with_(limits={"velocity": 3.0}, path=()).path


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"durations": 1.0}, "durations: a problem has no such field: did you mean 'duration'"),
        ({"x": 1.0}, "x: a problem has no such field: valid names: start, goal, cost"),
        ({"cost": 3.0}, "cost: got 3.0, expected a table, or a Cost"),
        ({"start": [1.0]}, r"start: got \[1.0\], expected a table"),
        ({"cost": {"alpha": 1.0}}, r"cost.alpha: unknown key, did you mean cost.effort"),
    ],
)
def test_what_there_is_not_is_named(problem: Problem, words: dict[str, object], message: str) -> None:
    with pytest.raises(ProblemError, match=message):
        problem.with_(**words)


def test_zero_stands_for_rest_of_a_part_and_of_a_free_flyer() -> None:
    parts = [
        {"name": "left", "robot": "ur5"},
        {"name": "drone", "robot": "hector", "actuated": ["root_joint"]},
    ]
    whole = Problem.create({"part": parts}, 1.0, 20, goal={"v": 0})
    assert whole.goal.rate_active.all()
    for name, count in (("left", 6), ("drone", 6), ("drone/root_joint", 6), ("left/elbow_joint", 1)):
        goal = Problem.create({"part": parts}, 1.0, 20, goal={"v": {name: 0}}).goal
        assert goal.rate_active.sum() == count
        assert not goal.value.any()
    with pytest.raises(MbocpError, match=r"goal\.v\.left: got shape \(1,\), expected \(6,\)"):
        Problem.create({"part": parts}, 1.0, 20, goal={"v": {"left": 1.0}})


def test_zero_stands_for_rest(ur5: Robot) -> None:
    listed = Problem.create(ur5, 1.0, 20, start={"v": [0] * 6}, goal={"q": GOAL, "v": [0] * 6})
    short = Problem.create(ur5, 1.0, 20, start={"v": 0}, goal={"q": GOAL, "v": 0.0})
    assert problem_to_toml(short) == problem_to_toml(listed)
    with pytest.raises(MbocpError, match=r"got 1, expected 0 for rest, a list .* or a table by joint name"):
        Problem.create(ur5, 1.0, 20, goal={"v": 1})
    assert Problem.create(ur5, 1.0, 20, goal={"q": GOAL, "p": 0}).goal.rate_active.all()


@pytest.mark.parametrize(
    "name",
    ["arms/accurate_lift", "arms/via_points", "arms/slalom", "arms/throw_into_bucket", "loops/four_bar"],
)
def test_tables_are_those_that_the_file_would_have(name: str) -> None:
    problem = load_problem(EXAMPLES / f"{name}.toml")
    read = parse_toml(to_toml(tables_of(problem)))
    assert json.dumps(write_tables(problem), sort_keys=True) == json.dumps(read, sort_keys=True)

"""A solution has one way to its problem, and keeps what it asked of the motion."""

from __future__ import annotations

import dataclasses
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import ProblemFileError
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.solution import Solution
from mbocp.solution.checked import read_facts
from mbocp.solution.its_problem import facts_of
from mbocp.solution.problem_facts import Facts, PathRow, PhasePlace, ViaPlace
from mbocp.terms import path_constraint

from .fabricated import pendulum

ROOM = {"name": "room", "kind": "position", "frame": "link2", "z": [-9.0, 9.0]}
PHASES = [
    {"name": "out", "steps": 4, "duration": 0.4, "limits": {"velocity": 9.0}},
    {"name": "back", "steps": 6, "duration": {"min": 0.2, "max": 0.9}},
]
WORDS: dict[str, dict[str, Any]] = {
    "plain": {},
    "rates": {"limits": {"acceleration": 50.0}, "start": {"q": [0.1, 0.0], "a": [1.0, 2.0]}},
    "path": {"path": [{**ROOM, "from": 0.5, "until": 0.8}]},
    "via": {"via": [{"name": "mid", "q": [0.1, 0.1], "time": {"min": 0.3, "max": 0.7}}]},
    "free": {"duration": {"min": 0.5, "max": 2.0}},
    "phases": {"duration": None, "steps": None, "phase": PHASES},
}


def made(name: str, **more: Any) -> Problem:
    words = {"duration": 1.0, "steps": 10, "goal": {"q": [0.2, 0.1]}, **WORDS[name], **more}
    return Problem.create("double_pendulum", **words)


@pytest.mark.parametrize("name", WORDS)
def test_facts_survive_texts_and_files(name: str) -> None:
    problem = made(name)
    facts = facts_of(problem)
    sizes = {"q": problem.robot.nq, "v": problem.robot.nv, "u": problem.robot.nu}
    assert facts.fit(problem.num_steps, sizes) == facts
    assert facts_of(parse_problem(problem_to_toml(problem))) == facts
    assert read_facts(json.loads(json.dumps(dataclasses.asdict(facts)))) == facts


def test_facts_are_what_the_problem_says() -> None:
    assert facts_of(made("plain")) == Facts(a_start=(0.0, 0.0), ties=0)
    assert facts_of(made("free")).duration_range == (0.5, 2.0)
    rates = facts_of(made("rates"))
    np.testing.assert_array_equal(rates.bounds_of_rate("acceleration"), [[-50.0] * 2, [50.0] * 2])
    assert rates.a_start == (1.0, 2.0)
    assert facts_of(made("path")).path == (PathRow("room.z", -9.0, 9.0, "m", 4),)  # nodes 5 to 8
    assert facts_of(made("via")).via == (ViaPlace("mid", 6, True, 0.3, 0.7),)


def test_phases_say_where_they_are_and_which_limits_they_have() -> None:
    problem = made("phases")
    facts = facts_of(problem)
    assert facts.phases == (PhasePlace("out", 0, 4, 0.4, 0.4), PhasePlace("back", 4, 10, 0.2, 0.9))
    along = facts.limits_along("v")
    assert along is not None
    np.testing.assert_array_equal(along, problem.limits_along()["v"])
    assert (along[1][:4] == 9.0).all()
    assert np.isinf(along[1][4:]).all()
    assert facts.limits_along("u") is None


@pytest.mark.parametrize(
    "odd",
    [
        Facts(via=(ViaPlace("late", 11, True, 0.0, 1.0), ViaPlace("early", -3, True, 0.0, 1.0))),
        Facts(phases=(PhasePlace("short", 0, 4, 1.0, 1.0),)),
        Facts(phases=(PhasePlace("back", 0, 12, 1.0, 1.0), PhasePlace("and forth", 12, 10, 1.0, 1.0))),
        Facts(rates={"jerk": ((1.0,), (2.0, 3.0)), "luck": ((), ())}),
        Facts(along={"v": (((1.0,),), ((2.0,),)), "x": ((), ())}),
        Facts(a_start=(1.0, 2.0, 3.0)),
    ],
)
def test_facts_that_do_not_fit_the_motion_are_left_out(odd: Facts) -> None:
    assert odd.fit(10, {"q": 2, "v": 2, "u": 2}) == Facts()


def test_a_solve_hands_over_the_problem_that_was_solved(tmp_path: Path) -> None:
    problem = mbocp.load_problem(Path(__file__).parents[2] / "examples/paper/rigid_pendulum.toml")
    solution = mbocp.solve(problem)
    assert solution.problem is problem
    assert solution.shown is not None
    assert solution.shown.problem is problem
    for field in ("scheme", "lie", "substeps", "coordinates"):
        assert getattr(solution, field) == getattr(problem, field)
    for name, limits in problem.limits.fields.items():
        np.testing.assert_array_equal(getattr(solution, name), limits)
    loaded = Solution.load(solution.save(tmp_path / "result.h5"))
    assert loaded == solution
    assert loaded.facts == solution.facts == facts_of(problem)
    assert loaded.problem is loaded.problem
    assert problem_to_toml(loaded.problem) == solution.problem_text
    assert "problem" not in vars(pickle.loads(pickle.dumps(loaded)))
    old = dataclasses.replace(loaded, facts_kept=None)
    assert old.facts == solution.facts


def test_terms_of_ones_own_are_left_out_of_pictures() -> None:
    high = path_constraint(lambda at: at.q[0], name="high", lower=-9.0)
    text = problem_to_toml(made("path", terms=[high]))
    robot = mbocp.load_robot("double_pendulum")
    solution = pendulum(problem_text=text, robot_spec=dict(robot.spec), facts_kept=None)
    solution = dataclasses.replace(
        solution, qs=solution.qs[:, :2], vs=solution.vs[:, :2], ps=solution.ps[:, :2],
        mus=solution.mus[:, :4], labels=type(solution.labels)(),
        limits_q=np.zeros(0), limits_v=np.zeros(0), lam_qs=np.zeros(0), lam_vs=np.zeros(0),
    )  # fmt: skip
    with pytest.raises(ProblemFileError, match="high"):
        solution.problem  # noqa: B018
    shown = solution.shown
    assert shown is not None
    assert [constraint.name for constraint in shown.problem.path] == ["room"]
    assert [row.name for row in solution.facts.path] == ["room.z"]
    assert [term.name for term in solution.load_problem(terms=[high]).terms] == ["high"]

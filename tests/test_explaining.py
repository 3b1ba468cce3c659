"""Which limit has to give, on a pendulum that compiles in no time."""

from __future__ import annotations

import json

import pytest

from mbocp.explaining import explain
from mbocp.problem import Problem
from mbocp.solution import Status

PENDULUM = {"robot": "chain_1", "duration": 1.0, "steps": 40}


def pendulum(**words) -> Problem:
    name = Problem.create("chain_1", 1.0, 40, goal={"v": 0}, scheme="se1").robot.joint_names[0]
    return Problem.create(
        **{"integrator": {"scheme": "se1"}, **PENDULUM, "goal": {"q": {name: 1.5}, "v": 0}, **words},
    )


def test_a_weak_motor_has_to_be_stronger_by_what_is_said():
    free = explain(pendulum())
    assert free.is_solvable
    assert not free.given
    found = explain(pendulum(limits={"effort": 0.1}))
    assert not found.is_solvable
    effort = next(given for given in found.given if given.kind == "effort")
    assert effort.factor > 1.0
    assert "N m" in effort.words
    again = explain(pendulum(limits={"effort": 0.1 * effort.factor}))
    assert again.is_solvable


def test_a_certain_cause_needs_no_solve():
    found = explain(pendulum(limits={"velocity": 1.0}))
    assert found.causes[0].kind == "speed"
    assert not found.given


@pytest.mark.parametrize("is_in_the_way", [True, False])
def test_a_goal_among_obstacles_is_named_with_its_pose(is_in_the_way: bool):
    """In a ball about it no configuration is clear of it, and behind that one is."""
    place = [0.4, 0.2, 0.5]
    problem = Problem.create(
        "ur5",
        1.0,
        10,
        goal={"frame": {"name": "tool0", "position": place}},
        obstacle=[
            {"shape": "sphere", "radius": 0.08, "position": [*place[:2], 0.5 if is_in_the_way else 1.5]}
        ],
    )
    causes = explain(problem, search=False).causes
    assert [(cause.kind, cause.where, cause.is_certain) for cause in causes] == (
        [("goal", "tool0", False)] if is_in_the_way else []
    )
    for cause in causes:
        assert "obstacle 'sphere 1': at the goal" in cause.words
        assert cause.words.endswith("rad, tool0 at (0.4, 0.2, 0.5) m")
        assert all(f"{name} " in cause.words for name in problem.robot.joint_names)


def test_the_command_says_it(run, tmp_path):
    path = tmp_path / "fast.toml"
    path.write_text(
        'robot = "ur5"\n[horizon]\nduration = 0.2\nsteps = 20\n[goal]\nv = 0\n'
        "q = [1, 0, 0, 0, 0, 0]\n[limits]\nvelocity = true\n"
    )
    done = run("explain", str(path))
    assert done.exit_code == 0
    assert "impossible  shoulder_pan_joint needs 0.317 s for 1 rad" in done.stdout
    (cause,) = json.loads(run("explain", str(path), "--json").stdout)["causes"]
    assert (cause["kind"], cause["certain"]) == ("speed", True)


def test_a_failed_solve_says_the_first_cause(capsys):
    from mbocp.cli.solution_summary import print_summary
    from tests.cli.conftest import straight_line

    goal = {"q": [1, 0, 0, 0, 0, 0], "v": 0}
    problem = Problem.create("ur5", 0.2, 20, goal=goal, limits={"velocity": True}, scheme="se1")
    print_summary(straight_line(problem, Status.INFEASIBLE), problem)
    assert "cause        shoulder_pan_joint needs 0.317 s" in capsys.readouterr().out
    print_summary(straight_line(problem), problem)
    assert "cause" not in capsys.readouterr().out


@pytest.fixture
def run():
    from typer.testing import CliRunner

    from mbocp.cli.app import app

    return lambda *words: CliRunner().invoke(app, words)

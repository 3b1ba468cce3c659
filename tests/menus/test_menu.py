"""Menus: motions that differ, the cheapest first, with names that say how."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.cli.solution_summary import solution_rows
from mbocp.exceptions import InvalidValue, ProblemFileError
from mbocp.menus.menu import Choice
from mbocp.menus.names import _directions
from mbocp.solvers import Status

SE1 = ["integrator.scheme=se1"]


@pytest.fixture(scope="module")
def ur5_problem() -> mbocp.Problem:
    ur5 = mbocp.load_robot("ur5")
    pose = ur5.frame_placement("tool0", [0.6, -1.2, 1.6, -2.0, -1.2, 0.3])
    orientation = pin.Quaternion(pose.rotation).coeffs()
    return mbocp.Problem.create(
        ur5,
        2.0,
        20,
        start={"q": [0, -1.57, 1.57, -1.57, -1.57, 0]},
        goal={
            "v": 0,
            "frame": {"name": "tool0", "position": pose.translation, "orientation": orientation},
        },
        cost={"effort": 1.0, "velocity": 100.0},
        scheme="se1",
    )


@pytest.fixture(scope="module")
def ur5_menu(ur5_problem: mbocp.Problem) -> mbocp.Menu:
    return mbocp.menu(ur5_problem)


def test_a_menu_is_sorted_and_begins_with_the_best(ur5_problem, ur5_menu):
    costs = [solution.cost for solution in ur5_menu]
    assert costs == sorted(costs)
    assert all(solution.converged for solution in ur5_menu)
    assert ur5_menu[0].cost <= mbocp.solve(ur5_problem).cost * (1.0 + 1e-9)
    assert len(set(ur5_menu.names)) == len(ur5_menu)
    assert sum(choice.ways for choice in ur5_menu.choices) <= ur5_menu.tried == 24
    assert repr(ur5_menu).splitlines()[1].split() == ["0", f"{costs[0]:.6g}", *ur5_menu.names[0].split()]


def test_a_solve_takes_the_best_of_a_menu(ur5_problem, ur5_menu):
    solution = mbocp.solve(ur5_problem.with_(solver={"starts": "menu"}))
    assert solution.cost == pytest.approx(ur5_menu[0].cost, rel=1e-8)
    assert len(solution.starts) == ur5_menu.tried
    costs = {f"{s.cost:.6g}" for s in solution.starts if s.status is Status.CONVERGED}
    assert costs >= {f"{s.cost:.6g}" for s in ur5_menu}
    first = str(dict(solution_rows(solution, ""))["starts"]).splitlines()[0]
    number = 1 + [start.guess for start in solution.starts].index(solution.guess_used)
    assert first == f"number {number} of 24 was taken: {solution.guess_used}"
    assert 'starts = "menu"' in solution.problem_text
    again = mbocp.solve(solution.problem, warm_start=solution)
    assert again.starts[0].guess == "warm start from a solution"
    assert again.guess_used == again.starts[0].guess  # of several at the same minimum the first


def test_a_solve_takes_the_best_of_all_goals():
    changes = ["horizon.steps=15", "integrator.scheme=se1", "solver.starts=menu"]
    problem = mbocp.load_problem("examples/arms/either_side.toml", changes)
    solution = mbocp.solve(problem)
    assert {start.goal for start in solution.starts} == {0, 1}
    assert solution.goal_place == int(solution.guess_used[len("to goal.any.")])
    least = min(start.cost for start in solution.starts if start.status is Status.CONVERGED)
    assert solution.cost == pytest.approx(least, rel=1e-8)
    assert len(solution.problem.goals) == 2


def test_ctrl_c_ends_a_solve_with_the_best_way_so_far(ur5_problem):
    records = []

    def press(record: object) -> None:
        records.append(record)
        if len(records) == 60:
            raise KeyboardInterrupt

    solution = mbocp.solve(ur5_problem.with_(solver={"starts": "menu"}), callback=press)
    assert solution.status is Status.INTERRUPTED
    assert 1 < len(solution.starts) < 24


def test_starts_are_a_number_or_a_menu(ur5_problem):
    with pytest.raises(ProblemFileError, match=r"solver\.starts: got 'card', expected \"menu\"; or a whole"):
        ur5_problem.with_(solver={"starts": "card"})


def test_an_arm_of_six_joints_has_eight_branches_with_their_names(ur5_problem, ur5_menu):
    """Signs of joint angles tell the branches of a UR5 apart: q3 the elbow, q5 the wrist."""
    found = {}
    for choice in ur5_menu.choices:
        words = choice.name.split(", ")
        shoulder, elbow, wrist = [*words, "", ""][:3]
        q = choice.solution.qs[-1]
        signs = found.setdefault((shoulder, elbow), set())
        signs.add((bool(np.sin(q[2]) > 0), bool(np.sin(q[4]) > 0)))
        if wrist.startswith("wrist"):
            assert (wrist == "wrist flipped") == (np.sin(q[4]) * np.sin(ur5_problem.q_start[4]) < 0)
    assert set(found) == set(product(("shoulder left", "shoulder right"), ("elbow up", "elbow down")))
    for signs in found.values():  # the sign of the elbow is the same in a group, that of the wrist is not
        assert len({elbow for elbow, _ in signs}) == 1
        assert len({wrist for _, wrist in signs}) == 2
    for side in ("shoulder left", "shoulder right"):
        ups, downs = (next(iter(found[side, elbow]))[0] for elbow in ("elbow up", "elbow down"))
        assert ups != downs


def test_a_continuous_joint_goes_either_way_round():
    problem = mbocp.Problem.create(
        "double_pendulum_continuous",
        1.5,
        30,
        goal={"q": [np.cos(2.0), np.sin(2.0), 1, 0], "v": 0},
        cost={"effort": 1.0, "velocity": 1.0},
        scheme="se1",
    )
    menu = mbocp.menu(problem, tries=6)
    assert menu.names == ("direct", "the long way round in joint1")
    turned = [np.unwrap(np.arctan2(s.qs[:, 1], s.qs[:, 0]))[-1] for s in menu]
    np.testing.assert_allclose(turned, [2.0, 2.0 - 2.0 * np.pi], atol=1e-8)


def test_a_drone_passes_a_post_on_either_side():
    problem = mbocp.Problem.create(
        mbocp.load_robot("hector", actuated=["root_joint"]),
        2.0,
        20,
        start={"q": [-1.5, 0, 1, 0, 0, 0, 1]},
        goal={"q": [1.5, 0.02, 1, 0, 0, 0, 1], "v": 0},
        cost={"effort": 1.0, "velocity": 1.0},
        obstacle=[{"name": "post", "shape": "cylinder", "radius": 0.2, "length": 6.0, "position": [0, 0, 1]}],
        scheme="midpoint",  # by se1 a step in which it rolls over would be wrong by 0.9 rad
    )
    menu = mbocp.menu(problem)
    sides = {}
    for choice in menu.choices:
        at = choice.solution.qs[np.argmin(np.abs(choice.solution.qs[:, 0]))]
        side = "left" if at[1] > 0 else "right"  # it flies along x
        assert choice.name.startswith(f"{side} of the post")
        assert choice.solution.clearance != choice.solution.clearance or choice.solution.clearance > -1e-4
        sides[side] = choice
    assert set(sides) == {"left", "right"}


def test_one_motor_swings_a_double_pendulum_up_in_several_ways():
    problem = mbocp.Problem.create(
        mbocp.load_robot("double_pendulum", actuated=["joint2"]),
        3.0,
        40,
        goal={"q": [np.pi, 0.0], "v": 0},
        cost={"effort": 1.0, "velocity": 0.1},
        scheme="se1",
    )
    menu = mbocp.menu(problem)
    assert len(menu) > 1
    assert menu[0].cost < mbocp.solve(problem).cost * (1.0 + 1e-9)
    for choice in menu.choices:
        for joint, values in zip(("joint1", "joint2"), choice.solution.qs.T, strict=True):
            if f"{joint} swings backwards first" in choice.name:
                first = values[np.argmax(np.abs(values) > 0.2)]
                assert first < 0.0


def test_swings_are_counted_by_their_turns():
    t = np.linspace(0.0, 1.0, 101)
    assert _directions(t, 0.1) == [1]
    assert _directions(-np.sin(np.pi * t), 0.1) == [-1, 1]
    assert _directions(np.sin(5.0 * np.pi * t / 2.0), 0.1) == [1, -1, 1]
    assert _directions(0.05 * t, 0.1) == []
    assert _directions(t + 0.04 * np.sin(60.0 * t), 0.1) == [1]


def test_effort_alone_is_tried_with_few_steps():
    problem = mbocp.Problem.create(
        "double_pendulum",
        3.0,
        60,
        goal={"q": [2.5, 2.0], "v": [0, 0]},
        cost={"velocity": 0.0},
        scheme="se1",
    )
    menu = mbocp.menu(problem)
    four = mbocp.solve(problem.with_(solver={"starts": 4}))
    assert menu[0].cost < four.cost * (1.0 + 1e-3)
    again = mbocp.menu(problem, threads=1)
    assert [s.cost for s in again] == [s.cost for s in menu]
    assert again.names == menu.names


def test_several_goals_are_named():
    problem = mbocp.load_problem(
        "examples/arms/either_side.toml", ["horizon.steps=15", "integrator.scheme=se1"]
    )
    menu = mbocp.menu(problem, tries=2)
    assert {name.split(",")[0] for name in menu.names} == {"to goal 1", "to goal 2"}
    assert [f"to goal {1 + s.goal_place}" for s in menu] == [name.split(",")[0] for name in menu.names]


def test_what_nobody_can_solve_is_told():
    problem = mbocp.load_problem(
        "examples/arms/ur5_reach.toml", ["limits.effort=1.0", "horizon.steps=10", *SE1]
    )
    menu = mbocp.menu(problem, tries=2)
    assert not menu.converged
    assert menu.names == ("the only one",)


@pytest.mark.parametrize(("name", "value"), [("tries", 0), ("tries", 2.0), ("threads", -1), ("tries", True)])
def test_numbers_that_cannot_be_right_are_refused(ur5_problem, name, value):
    with pytest.raises(InvalidValue, match=name):
        mbocp.menu(ur5_problem, **{name: value})


def test_results_are_saved_and_shown(ur5_menu, tmp_path):
    two = replace(ur5_menu, choices=ur5_menu.choices[:2])
    files = two.save(tmp_path / "menu")
    assert files[0].name.startswith("1_shoulder_left_elbow_up")
    assert mbocp.Solution.load(files[1]).equals(ur5_menu[1])
    page = ur5_menu.replay(tmp_path / "menu.html").read_text()
    assert ur5_menu.names[1] in page
    longer = {**ur5_menu[0].robot_spec, "numbers": {"joint.elbow_joint.length": 0.6}}
    found = Choice("longer", replace(ur5_menu[0], robot_spec=longer), 1)  # as with a parameter
    shown = replace(ur5_menu, choices=(found,)).replay(tmp_path / "found.html").read_text()
    assert shown == mbocp.replay_solution(found.solution, tmp_path / "alone.html").read_text()
    assert shown != mbocp.replay_solution(ur5_menu[0], tmp_path / "short.html").read_text()
    (tmp_path / "file").write_text("")
    with pytest.raises(mbocp.MbocpError, match="file"):
        ur5_menu.save(tmp_path / "file")


def test_via_points_take_the_guesses_of_several_starts():
    menu = mbocp.menu("examples/arms/via_points.toml", tries=4)
    assert menu.tried == 4
    assert len(menu) > 1
    assert menu.names[0] == "shoulder left"


def test_ctrl_c_ends_a_menu_with_what_there_is(ur5_problem, ur5_menu):
    records = []

    def press(record: object) -> None:
        records.append(record)
        if len(records) == 60:
            raise KeyboardInterrupt

    menu = mbocp.menu(ur5_problem, threads=1, callback=press)
    assert len(records) == 60
    assert menu.converged
    assert len(menu) < len(ur5_menu)
    alone = ur5_problem.with_(cost={"velocity": 0.0}, goal={"q": [0.6, -1.2, 1.6, -2.0, -1.2, 0.3]})
    records.clear()
    with pytest.raises(KeyboardInterrupt):  # in a trial, before there is any motion
        mbocp.menu(alone, threads=1, callback=press)

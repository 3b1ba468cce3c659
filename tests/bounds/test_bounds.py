"""Bounds are below what is known to be best, and near it where they can be."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp.bounds.durations import BY_FORCES
from mbocp.bounds.efforts import dual_value, least_squares
from mbocp.bounds.of_problem import bound, quick_bound
from mbocp.bounds.task import BoundTask, windows_of
from mbocp.cli.app import app
from mbocp.cli.solution_summary import print_summary
from mbocp.problem import Problem, load_problem
from mbocp.robot import Robot, load_robot
from tests.robot.urdfs import chain, write

EXAMPLES = Path(__file__).parents[2] / "examples"
FASTEST = {"time": 1.0, "effort": 1e-6}
pytestmark = pytest.mark.filterwarnings("ignore::mbocp.problem.warn.ProblemWarning")


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory) -> Robot:
    return load_robot(write(tmp_path_factory.mktemp("one"), chain("revolute")), damping=False)


@pytest.fixture(scope="module")
def double(tmp_path_factory) -> Robot:
    return load_robot(write(tmp_path_factory.mktemp("two"), chain("revolute", "revolute")), damping=False)


def solved(problem: Problem) -> mbocp.Solution:
    solution = mbocp.solve(problem)
    assert solution.converged
    return solution


def reach(robot: Robot, q: object, duration: object = 0.5, **words: object) -> Problem:
    words.setdefault("cost", {"effort": 1.0})
    return Problem.create(robot, duration, 60, goal={"q": q, "v": 0}, scheme="midpoint", **words)


def test_a_cart_that_turns_on_a_short_rail_has_its_closed_form_as_bound():
    """Bryson and Denham: 4; without the rail it were 2."""
    found = bound(solved(load_problem(EXAMPLES / "optima" / "bryson_denham.toml")))
    assert 4.0 * (1.0 - 1e-3) < found.value < 4.0
    assert 0.0 < found.gap < 1e-3
    assert found.of == "continuous"


def test_carts_that_change_places_have_nearly_their_least_time_as_bound():
    found = bound(load_problem(EXAMPLES / "optima" / "two_carts.toml"))
    assert 0.98 * 20.0 < found.duration < 20.0
    assert found.method == BY_FORCES


@pytest.mark.parametrize("jerk", [False, True])
def test_least_times_within_accelerations_are_met(jerk, capsys):
    """Without jerks, whose steps differ, by the steps, too."""
    limits = {"jerk": 100.0 if jerk else math.inf}
    problem = load_problem(EXAMPLES / "arms" / "minimum_time.toml").with_(limits=limits)
    solution = solved(problem)
    found = bound(solution)
    assert found.of == ("continuous" if jerk else "continuous and discretised")
    assert solution.duration >= found.duration * (1.0 - (1e-3 if jerk else 1e-7))
    assert solution.duration <= found.duration * 1.002
    assert quick_bound(solution, problem).value == found.value
    print_summary(solution, problem)
    assert "at least" in capsys.readouterr().out


@pytest.mark.parametrize("seed", range(4))
def test_least_times_within_efforts_are_not_beaten(double, seed):
    rng = np.random.default_rng(seed)
    limits = {"effort": [20.0, 10.0], "velocity": 4.0}
    problem = reach(double, rng.uniform(-1.0, 1.5, 2), {"min": 0.01, "max": 3.0}, cost=FASTEST, limits=limits)
    solution, found = solved(problem), bound(problem)
    assert found.method == BY_FORCES
    assert 0.4 * solution.duration < found.duration < solution.duration
    assert found.value < solution.cost
    costly = problem.with_(cost={"effort": 1.0})
    assert bound(solved(costly)).duration == bound(costly).duration  # of motions that cost more, too


@pytest.mark.parametrize("seed", range(4))
def test_efforts_are_not_beaten(double, seed):
    rng = np.random.default_rng(seed)
    problem = reach(double, rng.uniform(-0.5, 0.5, 2), 0.2, limits={"velocity": 4.0})
    found = bound(solved(problem))
    assert 0.0 < found.value < found.reached
    assert 0.0 < found.gap < 1.0


@pytest.mark.parametrize("q", [0.3, -0.5])
def test_a_pendulum_needs_no_limits_beside_its_solution(pendulum, q):
    """What costs less has bounded efforts, and so speeds; the problem alone says nothing."""
    problem = reach(pendulum, [q], 0.3)
    assert bound(problem).value == 0.0
    assert "limits.velocity" in bound(problem).reason
    found = bound(solved(problem))
    assert found.method == "momenta"
    assert 0.0 < found.gap < 0.1


def test_forces_that_only_push_are_not_beaten(tmp_path):
    """A lift of 1 kg that is pushed with 12 N at least."""
    kinds = chain("prismatic").replace("0.2 0.9 0.4", "0 0 1").replace("0.1 0.2 0.3", "0 0 0")
    lift = load_robot(write(tmp_path, kinds), damping=False)
    problem = reach(lift, [-0.5], 1.0, limits={"effort": {"j1": [12.0, 20.0]}, "velocity": 5.0})
    problem = problem.with_(start={"q": [0.0], "v": [-2.0]}, goal={"v": [1.0]})
    solution = solved(problem)
    assert solution.cost == pytest.approx(0.5 * (9.81 + 3.0) ** 2)
    assert 0.99 * solution.cost < bound(problem).value < solution.cost


def test_any_multipliers_give_a_bound(double):
    """Far from the best ones, too: none is above the optimum, and the best are no worse."""
    solution = solved(reach(double, [0.4, 0.2], 0.2, limits={"velocity": 4.0}))
    windows, alpha = windows_of(BoundTask.of(solution.problem, solution.cost)), np.ones(2)
    assert windows is not None
    best, rng = least_squares(windows, alpha), np.random.default_rng(0)
    for size in 10.0 ** np.arange(-3.0, 2.0):
        lams, nus = size * rng.normal(size=(33, 2)), size * rng.normal(size=(2, 32, 2))
        assert dual_value(windows, alpha, lams, nus) < best < solution.cost


def test_rates_cost_what_straight_ways_cost(double):
    """The least of squared speeds is W d^2 / (2 T), that of accelerations from rest to rest 6 A d^2 / T^3."""
    cost = {"effort": 0.0, "velocity": [2.0, 0.0], "acceleration": [0.0, 3.0]}
    problem = reach(double, [0.4, -0.5], 0.5, cost=cost, limits={"effort": 1e3})
    least = 0.4**2 / 0.5 + 6.0 * 3.0 * 0.5**2 / 0.5**3
    found = bound(solved(problem))
    assert found.value == pytest.approx(least)
    assert found.of == "continuous and discretised"
    assert 0.0 < found.gap < 0.01


def test_an_angle_that_may_go_round_takes_the_short_way():
    robot = load_robot("double_pendulum_continuous")
    angles = np.array([3.0, 0.5])
    q = np.column_stack([np.cos(angles), np.sin(angles)]).ravel()
    start = {"q": [math.cos(-3.0), math.sin(-3.0), 1.0, 0.0]}
    words = {"cost": FASTEST, "limits": {"velocity": 1.0, "acceleration": 8.0}, "start": start}
    found = bound(reach(robot, q, {"min": 0.01, "max": 5.0}, **words))
    assert found.duration == pytest.approx(0.5 + 1.0 / 8.0)
    assert "joint2" in found.method


def test_a_tool_is_no_faster_than_joints_carry_it():
    problem = load_problem(EXAMPLES / "arms" / "ur5_fastest.toml").with_(duration_range=(0.01, 5.0))
    found = bound(problem)
    assert "frame" in found.method
    assert 0.05 < found.duration < 0.2713  # what is found


def test_via_points_add_up(double):
    via = [{"name": "a", "q": [0.5, 0.0], "time": "free"}]
    words = {"cost": FASTEST, "limits": {"velocity": 1.0}, "via": via}
    found = bound(reach(double, [0.0, 0.3], {"min": 0.01, "max": 5.0}, **words))
    assert found.duration == pytest.approx(1.0)


def test_ways_through_via_points_cost_what_straight_ways_cost(double):
    """A joint that goes up by 0.5 and down by 0.8 in T at least W 1.3^2 / (2 T)."""
    via = [{"name": "a", "q": [0.5, 0.0], "time": "free"}]
    cost = {"effort": 0.0, "velocity": [2.0, 1e-6]}  # a little for the other, which may whip else
    problem = reach(double, [-0.3, 0.2], 0.5, cost=cost, limits={"effort": 1e4}, via=via)
    found = bound(solved(problem))
    assert found.value == pytest.approx(2.0 * 1.3**2 / (2.0 * 0.5))
    assert 0.0 < found.gap < 0.05


@pytest.mark.parametrize("seed", range(3))
def test_efforts_through_via_points_are_not_beaten(double, seed):
    ways = np.random.default_rng(seed).uniform(-0.3, 0.3, (2, 2))
    via = [{"name": "a", "q": ways[0], "time": "free"}]
    found = bound(solved(reach(double, ways[1], 0.2, limits={"velocity": 5.0}, via=via)))
    assert 0.0 < found.value < found.reached


def test_joints_of_closed_loops_go_their_ways_alone():
    """Those of a parallelogram turn alike, so that all can go straight at once; efforts count zero."""
    problem = load_problem(EXAMPLES / "loops" / "parallelogram_arm.toml").with_(cost={"effort": 1e-9})
    found = bound(solved(problem))
    assert 0.0 <= found.gap < 0.02
    assert found.of == "continuous"
    fast = problem.with_(duration={"min": 0.01, "max": 2.0}, cost=FASTEST, limits={"velocity": 1.0})
    away = np.abs(problem.robot.difference(problem.q_start, problem.goal.q)).max()
    assert bound(fast).duration == pytest.approx(away)


def test_why_there_is_no_bound():
    for example, words in (
        ("loops/four_bar.toml", "close loops"),
        ("loops/polish.toml", "holds"),
        ("paper/elastic_pendulum.toml", "springs"),
        ("optima/free_flyer.toml", "may be negative by fuel"),
    ):
        found = bound(load_problem(EXAMPLES / example))
        assert words in found.reason, example
        assert not found.value > 0.0


@pytest.mark.parametrize("duration", [0.3, {"min": 0.05, "max": 3.0}])
def test_numbers_that_are_found_leave_forces_out_and_count_their_least_cost(duration):
    """The weight of 15 kg where the search begins is no part of the problem: it goes down to nothing."""
    payload = {"name": "weight", "frame": "link2", "mass": 15.0}
    found = {"of": "robot.payload.weight.mass", "min": 0.0, "max": 20.0, "cost": {"linear": 0.1}}
    problem = Problem.create(
        {"name": "double_pendulum", "payload": [payload]},
        duration,
        20,
        goal={"q": [0.5, 0.3], "v": 0},
        limits={"effort": 20.0, "velocity": 3.0},
        cost={"time": 1.0, "effort": 1e-3},
        parameter=[found],
    )
    reached = solved(problem)
    assert bound(problem).value <= reached.cost
    assert bound(problem).duration <= reached.duration
    dear = problem.with_(parameter=[{**found, "min": 5.0}])
    assert bound(dear).value == pytest.approx(bound(problem).value + 0.5)


def test_the_command_prints_it(tmp_path):
    path = EXAMPLES / "optima" / "two_carts.toml"
    done = CliRunner().invoke(app, ["bound", str(path), "--json"])
    found = json.loads(done.stdout)
    assert found["value"] == bound(load_problem(path)).value
    assert found["gap"] is None
    result = solved(load_problem(path)).save(tmp_path / "carts.h5")
    assert "below what was reached" in CliRunner().invoke(app, ["bound", str(result)]).stdout
    page = tmp_path / "carts.html"
    assert CliRunner().invoke(app, ["report", str(result), "-o", str(page)]).exit_code == 0
    assert "below what was reached" in page.read_text(encoding="utf-8")

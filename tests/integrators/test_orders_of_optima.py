"""Costs and adjoints of optima converge with the square of the step: controls are constant in it."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.problem import Problem
from tests.integrators.test_symplecticity import null_space
from tests.mechanics.models import chain
from tests.mechanics.models import robot as robot_of

EXAMPLES = Path(__file__).parents[2] / "examples"


def swing(kinds: str, scheme: str) -> Problem:
    """From rest to rest, with all joints driven."""
    robot = robot_of(chain(kinds)[0])
    rng = np.random.default_rng(3)
    goal = robot.integrate(robot.q0, 0.6 * rng.uniform(-1.0, 1.0, robot.nv))
    return Problem.create(
        robot,
        1.0,
        10,
        goal={"q": goal, "v": 0},
        cost={"effort": 1.0, "velocity": 0.5},
        scheme=scheme,
    )


def ur5(scheme: str) -> Problem:
    return mbocp.load_problem(EXAMPLES / "arms/ur5_reach.toml").with_(scheme=scheme)


def pendulum(scheme: str) -> Problem:
    return mbocp.load_problem(EXAMPLES / "paper/rigid_pendulum.toml").with_(scheme=scheme)


def solved(problem: Problem, steps: tuple[int, ...]) -> tuple[Array, Array]:
    """Costs, and adjoints of the start: derivatives of the cost in the first state."""
    before, costs, adjoints = None, [], []
    for count in steps:
        before = mbocp.solve(problem.with_(num_steps=count), warm_start=before, check=True)
        costs.append(before.cost)
        adjoints.append(before.mus[0])
    return np.array(costs), np.array(adjoints)


def order(values: Array) -> float:
    """From the last three of a row of values with halved steps."""
    first, second = (np.linalg.norm(np.atleast_1d(b - a)) for a, b in pairwise(values[-3:]))
    return float(np.log2(first / second))


CASES = [
    pytest.param("RX RY", "gauss2", (10, 20, 40), id="two hinges, gauss2"),
    pytest.param("RX RY", "gauss3", (10, 20, 40), id="two hinges, gauss3"),
    pytest.param("RX RY", "lobatto3", (20, 40, 80), id="two hinges, lobatto3"),
    pytest.param("RX RY", "lobatto2", (20, 40, 80), id="two hinges, lobatto2"),
    pytest.param("Spherical", "gauss2", (10, 20, 40), id="SO(3), gauss2"),
    pytest.param("Spherical", "lobatto3", (10, 20, 40), id="SO(3), lobatto3"),
    pytest.param("FreeFlyer", "lobatto2", (10, 20, 40), id="SE(3), lobatto2", marks=pytest.mark.slow),
    pytest.param("FreeFlyer", "gauss2", (10, 20, 40), id="SE(3), gauss2", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("kinds", "scheme", "steps"), CASES)
def test_costs_and_adjoints_of_joints(kinds: str, scheme: str, steps: tuple[int, ...]) -> None:
    costs, adjoints = solved(swing(kinds, scheme), steps)
    assert order(costs) == pytest.approx(2.0, abs=0.2)
    assert order(adjoints) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("scheme", ["gauss2", "gauss3"])
def test_costs_and_adjoints_of_the_elastic_pendulum(scheme: str) -> None:
    problem = mbocp.load_problem(EXAMPLES / "paper/elastic_pendulum.toml").with_(scheme=scheme)
    costs, adjoints = solved(problem, (20, 40, 80))
    assert order(costs) == pytest.approx(2.0, abs=0.2)
    assert order(adjoints) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("scheme", ["gauss2", "lobatto3"])
def test_costs_and_adjoints_of_the_double_pendulum(scheme: str) -> None:
    problem = Problem.create(
        "double_pendulum", 1.0, 20, goal={"q": [1.0, 0.5], "v": 0}, cost={"effort": 1.0}, scheme=scheme
    )
    costs, adjoints = solved(problem, (80, 160, 320))
    assert order(costs) == pytest.approx(2.0, abs=0.2)
    assert order(adjoints) == pytest.approx(2.0, abs=0.2)


def light() -> Problem:
    """A mass of 10 g that comes to rest: with these weights its adjoint has a time constant of 1 ms."""
    robot = robot_of(chain("PX", pin.Inertia(0.01, np.zeros(3), np.zeros((3, 3))))[0])
    cost = {"effort": 1.0, "velocity": 100.0}
    start, goal = {"v": [1.0]}, {"v": [0.0]}
    return Problem.create(robot, 0.5, 10, start=start, goal=goal, cost=cost, scheme="gauss2")


def test_adjoints_of_what_is_light_are_of_order_one_until_steps_resolve_it() -> None:
    """Steps of 12 to 50 time constants I sqrt(effort / velocity), and of a fifth of one and less."""
    for steps, expected in (((10, 20, 40), 1.0), ((2500, 5000, 10_000), 2.0)):
        _, adjoints = solved(light(), steps)
        assert order(adjoints[:, 1]) == pytest.approx(expected, abs=0.2)


@pytest.mark.slow
def test_costs_and_adjoints_of_an_arm() -> None:
    """Its light wrist has a time constant of 1.6 ms; steps are 1.2 ms and less."""
    costs, adjoints = solved(ur5("gauss2"), (1600, 3200, 6400))
    assert order(costs) == pytest.approx(2.0, abs=0.2)
    for column in adjoints.T:
        assert order(column) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("scheme", ["lobatto2", "lobatto3"])
def test_costs_and_adjoints_on_a_constraint(scheme: str) -> None:
    """Along states that agree with the constraint: others have no cost."""
    problem = pendulum(scheme)
    q, p = problem.q_start, problem.p_start
    costs, adjoints = solved(problem, (40, 80, 160))
    adjoints = adjoints @ null_space(np.block([[q, np.zeros(3)], [p, q]]))
    assert order(costs) == pytest.approx(2.0, abs=0.2)
    assert order(adjoints) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("scheme", ["lobatto2", pytest.param("lobatto3", marks=pytest.mark.slow)])
def test_costs_and_adjoints_of_a_four_bar_linkage(scheme: str) -> None:
    """At rest momenta change by M dv, and configurations and velocities along the constraints."""
    problem = mbocp.load_problem(EXAMPLES / "loops/four_bar.toml").with_(scheme=scheme)
    costs, adjoints = solved(problem, (40, 80, 160))
    q, robot = problem.q_start, problem.robot
    along = null_space(robot.constraint_jacobian(q))
    still = np.zeros_like(along)
    adjoints = adjoints @ np.block([[along, still], [still, robot.mass_matrix(q) @ along]])
    assert order(costs) == pytest.approx(2.0, abs=0.2)
    assert order(adjoints) == pytest.approx(2.0, abs=0.2)

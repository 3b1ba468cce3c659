"""The cost of accelerations: what is reported is what the motion costs, and what it is for."""

from __future__ import annotations

import numpy as np
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import MbocpError
from mbocp.problem import Problem, parse_problem, problem_to_toml

GOAL = {"q": [0.7, -0.4], "v": [0.0, 0.0]}
WEIGHTS = [0.3, 0.02]


def problem(**changes: object) -> Problem:
    cost = {"effort": 0.5, "velocity": 0.1, "acceleration": WEIGHTS}
    made = Problem.create(
        "double_pendulum", 1.0, 20, start={"q": [0.1, 0.2]}, goal=GOAL, cost=cost, scheme="se1"
    )
    return made.with_(**changes)


def squares(weights: Array, rows: Array) -> float:
    return float(np.einsum("i,ni,ni->", weights, rows, rows) / 2)


@pytest.mark.parametrize("coordinates", ["joint", "natural"])
def test_the_cost_is_that_of_the_motion(coordinates: str) -> None:
    given = problem(coordinates=coordinates)
    solution = mbocp.solve(given, check=True)
    accelerations = np.diff(solution.vs, axis=0) / given.dt
    cost = squares(0.5 * np.ones(2), solution.us) + squares(0.1 * np.ones(2), solution.vs[1:])
    assert solution.cost == pytest.approx(given.dt * (cost + squares(np.array(WEIGHTS), accelerations)))


def test_explicit_schemes_take_the_acceleration_at_the_beginning() -> None:
    given = problem(integrator={"scheme": "euler"})
    solution = mbocp.solve(given, check=True)
    accelerations = np.diff(solution.vs, axis=0) / given.dt  # Euler's are those of the beginning
    cost = squares(0.5 * np.ones(2), solution.us) + squares(0.1 * np.ones(2), solution.vs[:-1])
    assert solution.cost == pytest.approx(given.dt * (cost + squares(np.array(WEIGHTS), accelerations)))


@pytest.mark.parametrize("method", ["monolithic", "ipopt", "fatrop", "fbsm_newton"])
def test_all_solvers_find_the_same(method: str) -> None:
    reference = mbocp.solve(problem(), check=True)
    solution = mbocp.solve(problem(goal={"v": GOAL["v"]}), solver=method, check=True)
    np.testing.assert_allclose(solution.us, reference.us, atol=1e-5)


def test_it_makes_motions_smooth() -> None:
    def largest(weight: float) -> float:
        solution = mbocp.solve(problem(cost={"acceleration": weight}), check=True)
        return float(np.abs(np.diff(solution.vs, axis=0)).max())

    assert largest(10.0) < 0.8 * largest(0.0)


def test_it_reads_back_and_is_checked() -> None:
    again = parse_problem(problem_to_toml(problem()))
    np.testing.assert_array_equal(again.cost.weight("acceleration"), WEIGHTS)
    assert "acceleration" not in problem_to_toml(problem(cost={"acceleration": 0.0}))
    for wrong in (-1.0, [1.0], {"elbow": 1.0}):
        with pytest.raises(MbocpError, match=r"cost\.acceleration"):
            problem(cost={"acceleration": wrong})

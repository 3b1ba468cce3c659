"""Motions of mechanisms with closed loops: strategies agree, coordinates agree, loops stay closed."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mbocp
from benchmarks.loops import simulate
from mbocp.mechanisms.closed_path import find_closed_path, find_driving_joints, path_towards
from mbocp.problem import Problem
from mbocp.robot.loops.projection import follow
from mbocp.solution import Solution

EXAMPLES = Path(__file__).parents[1] / "examples" / "loops"
PLANAR = ("four_bar", "slider_crank", "five_bar", "parallelogram_arm")
TURNING = ("four_bar", "slider_crank")  # whose cranks go all round
SPATIAL = ("delta", "stewart")
METHODS = ("monolithic", "fbsm_newton", "fbsm_bb+fbsm_newton", "fbsm_bb+monolithic")
ORDER = {"se1": 1, "midpoint": 2}
# Stage functions of the large robots take a while to compile.
EVERYWHERE = [(name, coordinates) for name in PLANAR for coordinates in ("joint", "natural")]
EVERYWHERE += [("delta", "joint")]
SLOW = [
    pytest.param(*case, marks=pytest.mark.slow)
    for case in (("delta", "natural"), ("stewart", "joint"), ("stewart", "natural"))
]


def example(name: str, steps: int, coordinates: str = "joint") -> Problem:
    scheme = "midpoint" if name in TURNING else "se1"
    changes = {"horizon.steps": steps, "coordinates": coordinates, "integrator.scheme": scheme}
    return mbocp.load_problem(EXAMPLES / f"{name}.toml", changes)


@cache
def solved(name: str, steps: int, coordinates: str, method: str = "auto") -> Solution:
    solution = mbocp.solve(example(name, steps, coordinates), solver=method)
    assert solution.converged, solution.advice
    return solution


@pytest.mark.parametrize(("name", "coordinates"), [*EVERYWHERE, *SLOW])
def test_strategies_find_the_same_optimum(name: str, coordinates: str) -> None:
    problem = example(name, 60)
    first = solved(name, 60, coordinates, METHODS[0])
    for method in METHODS[1:]:
        other = solved(name, 60, coordinates, method)
        assert other.cost == pytest.approx(first.cost, rel=1e-10), method
        scale = max(1.0, float(np.abs(first.us).max()))
        assert np.abs(other.us - first.us).max() < 1e-9 * scale, method
    for method in METHODS:
        found = solved(name, 60, coordinates, method)
        assert found.residual < 1e-10
        assert found.constraint_violation < 1e-10
        assert np.abs(problem.robot.closure_along(found.qs)[0]).max() < 1e-10
        missing = problem.robot.difference(problem.goal.q, found.qs[-1])
        assert np.abs(missing).max() < 1e-8


@pytest.mark.parametrize("name", [*PLANAR, *(pytest.param(name, marks=pytest.mark.slow) for name in SPATIAL)])
def test_coordinates_agree_to_the_order_of_the_scheme(name: str) -> None:
    gaps, costs = [], []
    for steps in (50, 100) if name in PLANAR else (100, 200):
        joint, natural = solved(name, steps, "joint"), solved(name, steps, "natural")
        gaps.append(np.abs(joint.qs - natural.qs).max())
        costs.append(abs(natural.cost / joint.cost - 1.0))
    expected = 2.0 ** ORDER[example(name, 100).scheme]
    assert 0.75 * expected < gaps[0] / gaps[1] < 1.5 * expected, gaps
    assert costs[1] < 2e-2, costs


@pytest.mark.parametrize("coordinates", ["joint", "natural"])
@pytest.mark.parametrize("name", PLANAR)
def test_loops_stay_closed_without_actuation(name: str, coordinates: str) -> None:
    simulation = simulate(name, coordinates, 500)
    change = simulation.energies - simulation.energies[0]
    assert simulation.closure < 1e-10
    assert change[-1] < 0.0  # dissipated by SE1 ...
    assert change.max() < 0.1 * np.ptp(simulation.energies)  # ... if not at once


@pytest.mark.slow
@pytest.mark.parametrize("coordinates", ["joint", "natural"])
@pytest.mark.parametrize("name", SPATIAL)
def test_loops_in_space_stay_closed_without_actuation(name: str, coordinates: str) -> None:
    simulation = simulate(name, coordinates, 1000)
    assert simulation.closure < 1e-10
    assert simulation.energies[-1] < simulation.energies[0]
    rise = np.max(simulation.energies - simulation.energies[0])
    assert rise < 0.1 * np.ptp(simulation.energies)


def test_increments_of_the_size_of_round_off_end_a_solve() -> None:
    """Short steps on constraints: multipliers are known to more than the tolerance only."""
    solution = solved("four_bar", 200, "joint", "monolithic")
    assert solution.residual < 1e-11
    if "the next increment" not in solution.advice:
        assert solution.increment < 1e-6
    if solution.increment > 1e-9:
        assert "the increments are round-off" in solution.advice or "the next increment" in solution.advice


def test_bodies_do_not_know_how_often_a_joint_has_turned() -> None:
    """A motion by another way round, or a leap within one step, is told."""
    problem = mbocp.load_problem(
        EXAMPLES / "slider_crank.toml", {"coordinates": "natural", "integrator.scheme": "se1"}
    )
    there, elsewhere = mbocp.solve(problem), mbocp.solve(problem, solver="fbsm_newton")
    assert there.converged
    assert "turn" not in there.advice
    if elsewhere.cost < there.cost - 1.0:
        assert "rad in one step" in elsewhere.advice or "whole turns away" in elsewhere.advice


@pytest.mark.parametrize("name", ["four_bar", "five_bar", "slider_crank"])
@pytest.mark.parametrize("seed", range(4))
def test_a_long_way_to_the_next_configuration_leads_where_small_steps_lead(name: str, seed: int) -> None:
    """In one step, in a hundred, and by continuation: the same joints, in the same assembly mode."""
    robot = example(name, 20).robot
    q_start = example(name, 20).q_start
    driving = find_driving_joints(robot, q_start)
    aside = np.random.default_rng(seed).uniform(-0.8, 0.8, robot.nv)
    target = robot.integrate(q_start, np.where(driving, aside, 0.0))
    ends = [path_towards(robot, q_start, target, driving, np.linspace(0.0, 1.0, n + 1)[1:]) for n in (1, 100)]
    followed = follow(robot, q_start, target, driving)
    if np.abs(robot.difference(followed, target)[driving]).max() > 1e-6:
        assert ends[0] is None, "beyond the reach of the loops"
        return
    for end in ends:
        assert end is not None
        np.testing.assert_allclose(end[-1], followed, atol=1e-8)


def test_the_guess_turns_the_crank_with_the_loop_closed() -> None:
    problem = example("four_bar", 100)
    robot, shares = problem.robot, np.linspace(0.0, 1.0, 41)
    way = find_closed_path(robot, problem.q_start, problem.goal.q, shares)
    assert way is not None
    crank = way[:, robot.configuration_indices("crank")].ravel()
    np.testing.assert_allclose(crank, 1.0 + 2.0 * np.pi * shares, atol=1e-9)
    assert np.abs(robot.closure_along(way)[0]).max() < 1e-11
    assert np.abs(np.diff(way, axis=0)).max() < 0.5  # no joint leaps into another assembly mode

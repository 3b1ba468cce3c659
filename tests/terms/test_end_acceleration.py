"""Accelerations at the end: met by every scheme, alike by all solvers, refused where there are none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

import mbocp
from mbocp.exceptions import MbocpError, OverdeterminedGoal, ProblemError
from mbocp.formulation import formulate
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.problem.timeline.via import ViaPoint
from mbocp.solution import Solution

EXAMPLES = Path(__file__).parents[2] / "examples"
GOAL = {"q": [0.6, 0.3], "v": 0.0, "a": 0.0}


def pendulum(goal: dict[str, Any] = GOAL, **words: Any) -> Problem:
    words = {"scheme": "se1", "cost": {"effort": 1e3, "velocity": 10.0}, **words}
    return Problem.create(
        "double_pendulum",
        words.pop("duration", 1.0),
        words.pop("steps", 16),
        goal=goal,
        **{"integrator": {"scheme": "se1"}, **words},
    )


def solved(problem: Problem, method: str = "monolithic") -> Solution:
    solution = mbocp.solve(problem.with_(solver={"method": method}))
    assert solution.converged, solution.advice
    return solution


def last(solution: Solution) -> Any:
    """Mean acceleration of the last step."""
    return (solution.vs[-1] - solution.vs[-2]) / (solution.t[-1] - solution.t[-2])


@pytest.mark.parametrize("scheme", ["se1", "se2", "midpoint", "euler", "rk4"])
def test_it_is_what_was_asked_for(scheme: str) -> None:
    plain = solved(pendulum({"q": GOAL["q"], "v": 0.0}, scheme=scheme))
    assert np.abs(last(plain)).max() > 1.0
    own = solved(pendulum(scheme=scheme))
    assert last(own) == pytest.approx(np.zeros(2), abs=1e-9)
    assert own.qs[-1] == pytest.approx(GOAL["q"], abs=1e-9)
    assert own.cost > plain.cost
    assert own.cost == pytest.approx(solved(pendulum(scheme=scheme), "ipopt").cost, rel=1e-8)


def test_of_one_joint_and_another_value() -> None:
    names = pendulum().robot.joint_names
    problem = pendulum({"q": GOAL["q"], "v": 0.0, "a": {names[1]: 0.7}})
    solution = solved(problem)
    assert last(solution)[1] == pytest.approx(0.7, abs=1e-9)
    assert abs(last(solution)[0]) > 0.1
    again = parse_problem(problem_to_toml(problem)).goal
    assert again.a_active.tolist() == [False, True]
    assert again.a[1] == 0.7


def test_the_one_that_a_motion_has_changes_nothing() -> None:
    plain = solved(pendulum({"q": GOAL["q"], "v": 0.0}))
    asked = solved(pendulum({"q": GOAL["q"], "v": 0.0, "a": last(plain).tolist()}))
    assert asked.cost == pytest.approx(plain.cost, rel=1e-10)
    assert asked.eta[-2:] == pytest.approx(np.zeros(2), abs=1e-5)


@pytest.mark.parametrize("scheme", ["se1", "euler"])
def test_with_limits_of_jerks_and_a_free_duration(scheme: str) -> None:
    words = {"duration": {"min": 0.1, "max": 5.0}, "cost": {"time": 1.0, "effort": 0.1}, "scheme": scheme}
    limits = {"acceleration": 8.0, "jerk": 100.0}
    own, ipopt = (solved(pendulum(limits=limits, **words), m) for m in ("monolithic", "ipopt"))
    assert own.duration == pytest.approx(ipopt.duration, rel=1e-5)
    half = own.duration / own.num_steps / 2.0
    assert np.abs(last(own)).max() <= 100.0 * half * (
        1.0 + 1e-6
    )  # none is left at the end, after half a step
    assert np.abs(last(own)).max() >= 100.0 * half * (1.0 - 1e-4)
    free = solved(pendulum({"q": GOAL["q"], "v": 0.0, "a": "free"}, limits=limits, **words))
    assert free.duration < own.duration


@pytest.mark.parametrize("name", ["loops/four_bar", "free_flyer/drone_flip"])
def test_closed_loops_and_free_flyers(name: str) -> None:
    problem = mbocp.load_problem(EXAMPLES / f"{name}.toml").with_(integrator={"scheme": "se1"}, goal={"a": 0})
    solution = solved(problem)
    assert np.abs(last(solution)).max() < 1e-6
    assert solution.cost == pytest.approx(solved(problem, "ipopt").cost, rel=1e-6)


def test_derivatives_of_the_end() -> None:
    programme = formulate(pendulum(limits={"acceleration": 8.0})).programme
    rng, rho = np.random.default_rng(2), programme.rho_terminal
    x = np.asarray(programme.x_start) + rng.standard_normal(len(programme.x_start))
    eta, d, step = rng.standard_normal(programme.ng), rng.standard_normal(len(x)), 1e-5
    complete = programme.end_functions.function("terminal_complete")

    def values(at: Any) -> list[Any]:
        return [np.asarray(ca.DM(out)) for out in complete(at, eta, rho)]

    _, g, slopes, _, _ = values(x)
    ahead, back = values(x + step * d)[1], values(x - step * d)[1]
    assert g.shape == (6, 1)
    assert np.abs(slopes[-2:]).max() > 0.1
    assert np.allclose(slopes @ d, (ahead - back).ravel() / (2 * step), atol=1e-8)


def test_refusals_say_which_and_why() -> None:
    with pytest.raises(ProblemError, match=r"goal\.a: is an end condition, for enforce"):
        pendulum({**GOAL, "enforce": "penalty"}, cost={"terminal": 1.0, "effort": 1.0})
    with pytest.raises(ProblemError, match=r"goal\.a: natural coordinates have no accelerations"):
        pendulum(coordinates="natural")
    with pytest.raises(OverdeterminedGoal, match="6 independent exact end conditions, but 2 steps"):
        pendulum(steps=2)
    with pytest.raises(MbocpError, match=r"goal\.a"):
        pendulum({**GOAL, "a": [1.0]})
    with pytest.raises(ProblemError, match=r"goal\.a: controls prescribe velocities"):
        mbocp.load_problem(EXAMPLES / "so3" / "unicycle_pendulum.toml").with_(goal={"a": 0})
    with pytest.raises(ProblemError, match="a is for the goal"):
        ViaPoint(name="there", goal=replace(pendulum().goal, enforce="exact", rate="v"), share=0.5)

"""Where effort alone costs, a solve goes on from the optimum with a weight on velocities that fades."""

from __future__ import annotations

import re

import numpy as np
import pytest

import mbocp
from mbocp.formulation import formulate
from mbocp.solvers import Status

ONE_MOTOR = mbocp.load_robot("double_pendulum", actuated=["joint2"], damping=False)


def swing_up(**tables: object) -> mbocp.Problem:
    """From hanging to upright with a motor at the elbow."""
    cost = {"effort": 1.0, "velocity": 0.0}
    return mbocp.Problem.create(
        ONE_MOTOR,
        1.0,
        100,
        start={"q": [np.pi, 0.0]},
        goal={"q": [0.0, 0.0], "v": [0.0, 0.0]},
        **{"integrator": {"scheme": "se1"}, "cost": cost, **tables},
    )


def phases_of(solution: mbocp.Solution) -> list[str]:
    return [phase.name for phase in solution.phases]


def test_a_fading_weight_leads_to_a_cheaper_motion_that_the_steps_resolve(monkeypatch):
    monkeypatch.setattr("mbocp.guesses.eased.can_screen", lambda formulation: False)
    problem = swing_up().with_(duration=1.2, num_steps=120)
    alone = mbocp.solve(problem, solver="monolithic")
    eased = mbocp.solve(problem)
    assert alone.is_stationary
    assert eased.converged
    assert eased.cost < 0.5 * alone.cost
    assert "monolithic (eased)" in phases_of(eased)
    assert "reached while a weight on velocities faded" in eased.advice
    assert eased.iterations == sum(not record.is_guess for record in eased.history)
    numbers = [record.iteration for record in eased.history if not record.is_guess]
    assert numbers == list(range(1, len(numbers) + 1))


def test_the_end_is_an_optimum_of_the_problem_itself():
    eased = mbocp.solve(swing_up())
    again = mbocp.solve(swing_up(), solver="monolithic", warm_start=eased)
    assert again.cost == pytest.approx(eased.cost, rel=1e-8)
    assert np.asarray(again.qs) == pytest.approx(np.asarray(eased.qs), abs=1e-6)
    assert eased.cost == pytest.approx(0.005 * float(np.sum(np.square(eased.us))), rel=1e-9)


def test_the_first_of_several_starts_is_eased_as_if_it_were_alone():
    alone = mbocp.solve(swing_up())
    several = mbocp.solve(swing_up(solver={"starts": 2}))
    assert several.starts[0].cost == pytest.approx(alone.cost, rel=1e-9)
    assert several.starts[0].iterations == alone.iterations
    assert several.cost <= alone.cost * (1.0 + 1e-9)


@pytest.mark.parametrize(
    "tables",
    [
        {"solver": {"method": "monolithic"}},
        {"solver": {"max_iterations": 300}},
        {"cost": {"effort": 1.0, "velocity": "auto"}},
        {"cost": {"effort": 1.0, "velocity": 1e-3}},
        {"limits": {"effort": [50.0]}},
        {"integrator": {"scheme": "midpoint"}, "solver": {"method": "monolithic"}},
    ],
)
def test_what_has_a_weight_limits_or_a_method_of_its_own_is_solved_once(tables):
    assert not any(
        "eased" in name or "weighed" in name for name in phases_of(mbocp.solve(swing_up(**tables)))
    )


def test_an_easy_solve_is_left_as_it_is():
    problem = mbocp.Problem.create(
        "double_pendulum", 1.0, 50, goal={"q": [0.3, 0.2], "v": [0, 0]}, scheme="se1"
    )
    solution = mbocp.solve(problem.with_(cost={"effort": 1.0, "velocity": 0.0}))
    assert solution.converged
    assert phases_of(solution).count("monolithic") == 1
    assert "eased" not in " ".join(phases_of(solution))


@pytest.mark.parametrize("scheme", ["se1", "midpoint", "rk4"])
def test_nothing_compiles_twice(scheme):
    scheme_of = {"integrator": {"scheme": scheme}}
    plain = formulate(swing_up(**scheme_of)).programme
    weighed = formulate(swing_up(cost={"effort": 2.0, "velocity": 0.5}, **scheme_of)).programme
    assert plain.functions.library == weighed.functions.library
    assert not weighed.functions.compiled_now
    assert weighed.easing is None
    assert plain.easing is not None
    added = plain.theta + plain.easing
    auto = formulate(swing_up(cost={"effort": 1.0, "velocity": "auto"}, **scheme_of)).programme
    assert added == pytest.approx(auto.theta, rel=1e-12)


def test_an_interrupted_descent_leaves_the_plain_result():
    def stop(record: mbocp.solvers.IterationRecord) -> None:
        if "weighed" in record.phase:
            raise KeyboardInterrupt

    solution = mbocp.solve(swing_up(), callback=stop)
    assert solution.status is Status.INTERRUPTED
    plain = mbocp.solve(swing_up(), solver="monolithic")
    assert solution.cost == pytest.approx(plain.cost, rel=1e-9)


def test_the_advice_names_a_weight_whose_optimum_the_steps_resolve():
    few = swing_up().with_(num_steps=20)
    solution = mbocp.solve(few)
    assert solution.status is Status.UNDER_RESOLVED
    named = re.search(r"with cost\.velocity = (\S+) the steps resolve the optimum", solution.advice)
    assert named is not None
    weighed = mbocp.solve(few.with_(cost={"effort": 1.0, "velocity": float(named[1])}))
    assert weighed.converged

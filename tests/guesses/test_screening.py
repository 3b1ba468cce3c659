"""Where effort alone costs, ways are tried with few steps, and the best go on with all of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.formulation import Formulation, formulate
from mbocp.guesses.screening import can_screen, finer
from mbocp.guesses.straight_line import line
from mbocp.programme import Iterate
from mbocp.solvers import Outcome, SolverSettings, Start, Status, run_strategy

ONE_MOTOR = mbocp.load_robot("double_pendulum", actuated=["joint2"], damping=False)
FOUR_BAR = Path(__file__).parents[2] / "examples" / "loops" / "four_bar.toml"
REST = {"q": [0.0, 0.0], "v": [0.0, 0.0]}


PHASES = [{"name": name, "steps": 50, "duration": 0.5} for name in ("first", "second")]


def swing_up(**tables: object) -> mbocp.Problem:
    """From hanging to upright with a motor at the elbow; the least effort known before was 0.0193."""
    cost = {"effort": 1.0, "velocity": 0.0}
    given = {"start": {"q": [np.pi, 0.0]}, "goal": REST, "cost": cost, **tables}
    return mbocp.Problem.create(ONE_MOTOR, 1.0, 100, **{"integrator": {"scheme": "se1"}, **given})


def solved(formulation: Formulation, iterate: Iterate) -> Outcome:
    options = replace(formulation.problem.solver, method="monolithic")
    return run_strategy(
        SolverSettings.of(options, formulation.programme), Start(formulation.programme, iterate)
    )


def test_a_way_tried_with_few_steps_leads_to_a_far_cheaper_motion():
    solution = mbocp.solve(swing_up())
    assert solution.converged
    assert solution.cost < 0.0193
    assert "reached by one of the ways tried with fewer steps" in solution.advice
    names = [phase.name for phase in solution.phases]
    assert any("trial 0, velocity weighed 0.01 of auto" in name for name in names)
    numbers = [record.iteration for record in solution.history if not record.is_guess]
    assert numbers == list(range(1, solution.iterations + 1))
    again = mbocp.solve(swing_up(), solver="monolithic", warm_start=solution)
    assert again.cost == pytest.approx(solution.cost, rel=1e-8)
    assert mbocp.solve(swing_up()).cost == solution.cost


def test_an_interrupted_trial_leaves_what_was_known(monkeypatch):
    def stop(record: mbocp.solvers.IterationRecord) -> None:
        if "trial" in record.phase:
            raise KeyboardInterrupt

    interrupted = mbocp.solve(swing_up(), callback=stop)
    monkeypatch.setattr("mbocp.guesses.eased.can_screen", lambda formulation: False)
    assert interrupted.status is Status.INTERRUPTED
    assert interrupted.cost == mbocp.solve(swing_up()).cost


def test_no_trial_begins_after_the_time_limit(monkeypatch):
    monkeypatch.setattr("mbocp.guesses.screening.Screening._is_over", property(lambda screening: True))
    assert not any("trial" in phase.name for phase in mbocp.solve(swing_up()).phases)


@pytest.mark.parametrize(
    ("tables", "may"),
    [
        ({}, True),
        ({"guess": {"kind": "line"}}, True),
        ({"guess": {"kind": "hold"}}, False),
        ({"goal": {"q": {"joint2": 0.0}, "v": [0.0, 0.0]}}, False),
        ({"via": [{"time": 0.5, "q": {"joint1": 1.0}}]}, False),
        ({"phase": PHASES}, False),
    ],
)
def test_ways_are_tried_where_they_lead_to_the_goal(tables, may):
    assert can_screen(formulate(swing_up(**tables))) is may


def test_with_effort_alone_phases_keep_their_steps():
    solution = mbocp.solve(swing_up(phase=PHASES), check=True)
    assert not any("trial" in phase.name for phase in solution.phases)


@pytest.mark.parametrize("scheme", ["se1", "midpoint", "rk4"])
def test_an_optimum_with_few_steps_is_near_that_with_more(scheme):
    problem = mbocp.Problem.create(
        "double_pendulum",
        1.0,
        80,
        goal={"q": [0.5, 0.4], "v": [0.0, 0.0]},
        integrator={"scheme": scheme},
        solver={"method": "monolithic"},
    )
    formulation, coarse = formulate(problem), formulate(problem.with_(num_steps=20))
    few = solved(coarse, line(coarse)).result.iterate
    guess = finer(coarse, few, formulation)
    motion, before = formulation.motion_of(guess), coarse.motion_of(few)
    assert motion.qs[::4] == pytest.approx(before.qs, abs=1e-12)
    assert motion.vs[::4] == pytest.approx(before.vs, abs=1e-12)
    optimum = solved(formulation, guess).result
    assert optimum.status is Status.CONVERGED
    for name in ("ms", "eta", "us"):
        gap = np.linalg.norm(getattr(guess, name) - getattr(optimum.iterate, name))
        assert gap < 0.2 * np.linalg.norm(getattr(optimum.iterate, name)), name


def test_motion_and_impulses_of_loops_are_carried_over():
    problem = mbocp.load_problem(FOUR_BAR).with_(num_steps=100, solver={"method": "monolithic"})
    formulation, coarse = formulate(problem), formulate(problem.with_(num_steps=50))
    few = solved(coarse, line(coarse)).result
    guess = finer(coarse, few.iterate, formulation)
    optimum = solved(formulation, guess).result
    assert few.status is optimum.status is Status.CONVERGED
    for name in ("xs", "ys", "us"):
        gap = np.linalg.norm(getattr(guess, name) - getattr(optimum.iterate, name))
        assert gap < 0.1 * np.linalg.norm(getattr(optimum.iterate, name)), name
    assert not guess.ms.any()

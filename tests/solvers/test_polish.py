"""An interior-point result counts by our own measure; Newton's method polishes what falls short of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.formulation import formulate
from mbocp.guesses import make_guess
from mbocp.problem import Problem
from mbocp.solution import Status
from mbocp.solvers import GlobalisedNewton, SolverSettings, Start, run_strategy
from mbocp.solvers.newton_method.monolithic import judge
from mbocp.solvers.nlp.interior_point import InteriorPoint
from mbocp.solvers.strategies import interior
from mbocp.solvers.strategies.iterating import SolverResult
from tests.campaign.tasks import draw

FILE = Path(__file__).parents[2] / "examples" / "paper" / "elastic_pendulum.toml"
LIMITED = ("horizon.steps=20", "limits={effort=5.3, velocity={y=6.5}}")
TOLERANCE = 1e-9


def load(*settings: str) -> Problem:
    return mbocp.load_problem(FILE, (*LIMITED, *settings))


def result_of(problem: Problem) -> tuple[Any, SolverResult]:
    """Programme, and what the monolithic solver comes to."""
    formulation = formulate(problem)
    programme, (iterate, _) = formulation.programme, make_guess("line", formulation)
    options = replace(problem.solver, method="monolithic")
    settings = SolverSettings.of(options, programme, has_inequalities=True)
    return programme, run_strategy(settings, Start(programme, iterate)).result


@pytest.fixture
def claims(monkeypatch: pytest.MonkeyPatch) -> None:
    """IPOPT and fatrop say that they have converged after three iterations."""
    run = InteriorPoint.run

    def early(self: InteriorPoint, *arguments: Any) -> SolverResult:
        found = run(replace(self, max_iterations=3), *arguments)
        return replace(found, status=Status.CONVERGED, advice="claimed")

    monkeypatch.setattr(InteriorPoint, "run", early)


def test_where_dynamics_amplify_the_residual_meets_the_tolerance(tmp_path: Path) -> None:
    """IPOPT is content with 3e-6 there, by the smaller of multiplier and distance."""
    task = draw("elastic_cart", 26, tmp_path)
    s = mbocp.solve(Problem.create(**task.tables), solver="ipopt")
    assert s.converged
    assert s.residual <= TOLERANCE
    assert s.iterations == len([r for r in s.history if not r.is_guess])


@pytest.mark.usefixtures("claims")
@pytest.mark.parametrize("method", ["ipopt", "fatrop"])
def test_what_is_no_solution_yet_is_solved_from_there(method: str) -> None:
    s = mbocp.solve(load(), solver=method)
    own = mbocp.solve(load(), solver="monolithic")
    assert s.converged
    assert s.residual <= TOLERANCE
    assert s.cost == pytest.approx(own.cost, rel=1e-9)
    assert "the optimality conditions hold" in s.advice


@pytest.mark.usefixtures("claims")
def test_what_newton_cannot_finish_is_not_converged(monkeypatch: pytest.MonkeyPatch) -> None:
    polisher = interior.polisher
    monkeypatch.setattr(interior, "polisher", lambda *a: replace(polisher(*a), max_iterations=1))
    s = mbocp.solve(load(), solver="ipopt")
    assert s.status is Status.STAGNATED
    assert s.residual > TOLERANCE
    assert "IPOPT ends here by its own measure, but the optimality conditions hold to" in s.advice
    assert "Newton's method from there ended as max_iterations after 1 iteration" in s.advice


@pytest.mark.usefixtures("claims")
def test_the_polish_keeps_to_the_limit_of_iterations_and_can_be_interrupted() -> None:
    s = mbocp.solve(load("solver.max_iterations=5"), solver="ipopt")
    assert s.iterations <= 5

    def press(record: mbocp.IterationRecord) -> None:
        if record.phase == "polish" and not record.is_guess:
            raise KeyboardInterrupt

    s = mbocp.solve(load(), solver="ipopt", callback=press)
    assert s.status is Status.INTERRUPTED
    assert np.isfinite(s.qs).all()


def test_a_solution_is_judged_as_its_own_solver_judged_it() -> None:
    programme, result = result_of(load())
    assert result.status is Status.CONVERGED
    assert result.iterate.bounds is not None
    assert np.abs(result.iterate.bounds.us).max() > 1e-3  # something is held
    assert judge(result, programme, TOLERANCE)[1] <= TOLERANCE
    idle = replace(result, iterate=replace(result.iterate, bounds=None))
    assert judge(idle, programme, TOLERANCE)[1] > 1e-4  # the multipliers are missing


def test_a_polish_begins_inside_with_products_that_are_the_barrier_or_more() -> None:
    programme, result = result_of(load())
    state = GlobalisedNewton(TOLERANCE, is_polish=True).init(programme, result.iterate)
    native, b = state.native, programme.bounds
    assert state.evaluation.finite
    assert 0.0 < state.barrier < TOLERANCE
    room = b.upper[b.has_limit] - native.slack
    assert (room > 0.0).all()
    assert (native.z_upper > 0.0).all()
    assert (room * native.z_upper).min() > 0.5 * state.barrier
    assert state.evaluation.residual < 1e-5


def test_a_residual_beside_which_the_cost_does_not_count_is_none_that_holds() -> None:
    programme, result = result_of(load())
    native = GlobalisedNewton(TOLERANCE).judge(programme, result.iterate).native
    before = native.evaluate()
    assert native.has_a_say(before.dual)
    assert native.evaluate().residual == before.residual
    native.m = native.m * 1.5
    assert not native.has_a_say(native.evaluate().dual)

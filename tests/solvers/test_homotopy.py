"""Problems without their limits, and limits brought back: what is widened, when it ends, that it helps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import CompilationTimeout
from mbocp.formulation import formulate
from mbocp.guesses.make import make_guess
from mbocp.problem import Problem
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.solvers.records import IterationRecord, Status
from mbocp.solvers.strategies import within_limits
from mbocp.solvers.strategies.iterating import SolverResult
from mbocp.solvers.strategies.within_limits import (
    bring_limits_back,
    can_leave_out_limits,
    measure_excess,
    widen,
    without_limits,
)


def pendulum() -> tuple[StagewiseProgramme, Iterate]:
    """Limits of every sort, and the straight line, which goes beyond them."""
    problem = mbocp.Problem.create(
        "double_pendulum",
        1.0,
        12,
        goal={"q": [2.0, 0.0], "v": [0.0, 0.0]},
        limits={"effort": 3.0, "velocity": 1.5},
        scheme="se1",
    )
    formulation = formulate(problem)
    return formulation.programme, make_guess("line", formulation)[0]


def falling_cart() -> Problem:
    """A cart with an elastic pendulum that falls: one weak motor, and a goal that asks for its motion."""
    return mbocp.Problem.create(
        "cart_pendulum_elastic",
        2.555404395402060,
        60,
        start={"q": [0.05450243, 0.52702301, 1.06990997]},
        goal={
            "q": [-0.88457869, -0.49790401, -1.06001209],
            "v": [-0.6454818, -2.37517603, -1.30166135],
        },
        cost={"effort": 0.528938079315436},
        limits={"effort": 1.8041020436960162},
        scheme="midpoint",
        guess={"kind": "line"},
    )


def test_limits_are_left_out_and_equations_stay() -> None:
    programme, _ = pendulum()
    assert can_leave_out_limits(programme)
    assert without_limits(programme).bounds.is_empty
    bounds = programme.bounds
    upper = np.array(bounds.u_upper)
    upper[:, 0] = bounds.u_lower[:, 0]
    tied = replace(programme, bounds=replace(bounds, u_upper=upper))
    left = without_limits(tied).bounds
    assert np.array_equal(left.u_lower[:, 0], left.u_upper[:, 0])
    assert np.isinf(left.u_lower[:, 1]).all()
    assert not can_leave_out_limits(without_limits(programme))


def test_limits_widened_by_all_that_a_motion_goes_beyond_them_are_kept_by_it() -> None:
    programme, iterate = pendulum()
    width = measure_excess(programme, iterate)
    wide = widen(programme, width, 1.0).bounds
    values = np.hstack([iterate.xs[1:], iterate.us])
    assert values.max() > programme.bounds.upper[programme.bounds.has_limit].max()
    room = np.where(wide.has_limit, np.minimum(values - wide.lower, wide.upper - values), 0.0)
    assert room.min() > -1e-12
    touched = np.where(wide.has_limit, np.abs(room), np.inf).min(axis=0)
    goes_beyond = (width[0] > 0) | (width[1] > 0)
    assert goes_beyond.any()
    assert np.all(touched[goes_beyond] < 1e-12)  # and no wider than that
    same = widen(programme, width, 0.0).bounds
    assert np.array_equal(same.lower, programme.bounds.lower)
    assert np.array_equal(same.upper, programme.bounds.upper)


@pytest.mark.parametrize("least", [0.0, 0.2, 0.9])
def test_only_a_solution_with_all_limits_is_one(least: float) -> None:
    """Where limits come back to a part of their width alone, there is no solution."""
    programme, iterate = pendulum()
    width, upper, parts = measure_excess(programme, iterate), programme.bounds.upper, []

    def solve(wanted: StagewiseProgramme, start: Iterate) -> SolverResult:
        column = int(np.argmax(width[1]))
        part = float((wanted.bounds.upper[0, column] - upper[0, column]) / width[1][column])
        parts.append(part)
        status = Status.CONVERGED if part >= least else Status.LINE_SEARCH_FAILED
        return SolverResult(status, "", start, IterationRecord(0, 0.0), ())

    found = bring_limits_back(programme, iterate, solve)
    assert (found is not None) == (least == 0.0)
    assert parts[-1] == 0.0 if least == 0.0 else len(parts) <= 8
    assert bring_limits_back(programme, iterate, lambda *_: None) is None  # not allowed to go on


def test_what_is_called_infeasible_from_the_line_is_solved_by_way_of_no_limits() -> None:
    """IPOPT calls this infeasible from the straight line; the motion without limits keeps them."""
    problem = falling_cart()
    assert mbocp.solve(problem, solver="ipopt").status is Status.INFEASIBLE
    s = mbocp.solve(problem)
    assert s.converged, s.advice
    assert np.abs(s.us).max() <= 1.8041020436960162
    assert any(phase.name == "monolithic without limits" for phase in s.phases)
    assert s.iterations == sum(phase.iterations for phase in s.phases)
    numbers = [record.iteration for record in s.history if not record.is_guess]
    assert numbers == list(range(1, s.iterations + 1))


def test_a_limit_of_iterations_holds_for_all_phases_together() -> None:
    for most in (1, 20, 30, 60, 120):
        problem = falling_cart()
        solver = replace(problem.solver, max_iterations=most)
        s = mbocp.solve(problem.with_(solver=solver))
        assert s.iterations <= most + 1
        assert not s.converged or np.abs(s.us).max() <= 1.8041020436960162


def test_what_newton_has_reached_is_kept_where_no_time_is_left_for_ipopt(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def without_time(*_: object) -> None:
        raise CompilationTimeout("IPOPT was to begin")

    monkeypatch.setattr(within_limits, "run_interior", without_time)
    monkeypatch.setattr(within_limits, "can_leave_out_limits", lambda _: False)
    solution = mbocp.solve(falling_cart())
    assert solution.status == "time_limit"
    assert solution.iterations > 0
    assert "no time was left for IPOPT" in solution.advice

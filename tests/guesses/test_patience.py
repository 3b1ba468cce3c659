"""After a first attempt that comes to nothing: what cannot help is not tried, and what is tried ends."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import mbocp
from mbocp.formulation import formulate
from mbocp.guesses.in_turn import _GuessRecord
from mbocp.guesses.make import make_guess
from mbocp.guesses.screening import status_of
from mbocp.job import Job, settings_of
from mbocp.problem import Problem
from mbocp.problem.reasons.cause import Cause
from mbocp.solvers import Start, Status, run_strategy
from mbocp.solvers.strategies import patience
from mbocp.solvers.strategies.patience import Patience, time_of_iteration
from tests.problem.test_causes import floats

PAPER = Path(__file__).parents[2] / "examples" / "paper"


def names(s: mbocp.Solution) -> list[str]:
    return [phase.name for phase in s.phases if phase.name not in ("compile", "guess", "diagnostics")]


def test_a_base_that_nothing_pushes_is_not_tried_elsewhere(tmp_path: Path) -> None:
    there = {"q": {"root_joint": [1, 0, 0, 0, 0, 0, 1]}, "v": 0}
    s = mbocp.solve(Problem.create(floats(tmp_path), 1.0, 20, goal=there))
    assert s.status is Status.INFEASIBLE
    assert names(s) == ["monolithic"]
    assert s.advice.startswith("nothing pushes the base of floater")


def test_nor_are_conditions_that_hold_by_themselves(tmp_path: Path) -> None:
    robot = floats(tmp_path, gravity=[0, 0, 0])
    s = mbocp.solve(Problem.create(robot, 1.0, 20, goal={"q": {"shoulder": 1.0}, "v": 0}))
    assert not s.converged
    assert names(s) == ["monolithic"]
    assert "nothing pushes floater along x, along y, along z, about x, about y and about z" in s.advice


def weak(**more: Any) -> Problem:
    """A pendulum that cannot get there with so little effort, of which no arithmetic knows."""
    return mbocp.load_problem(
        PAPER / "rigid_pendulum.toml", {"horizon.steps": 20, "limits.effort": 0.5, **more}
    )


@pytest.fixture(params=[0.0, 1e3], ids=["none", "much"])
def left(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> float:
    """How much is left after a first failure, in the time that it is reckoned to take [s]."""
    monkeypatch.setattr(patience, "_TIMES", 0.0)
    monkeypatch.setattr(patience, "_LEAST", request.param)
    return float(request.param)


def test_further_attempts_have_a_budget(left: float) -> None:
    s = mbocp.solve(weak())
    assert not s.converged
    assert (names(s) == ["monolithic"]) is (left == 0.0)
    remedies = "`mbocp explain FILE` looks for the limit that excludes it; else solver.time_limit gives more"
    assert (remedies in s.advice) is (left == 0.0)


def test_a_budget_ends_an_attempt_on_its_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which says so, and keeps the status of what came nearest."""
    monkeypatch.setattr(patience, "_TIMES", 0.0)
    monkeypatch.setattr(patience, "_LEAST", 1e-6)
    s = mbocp.solve(weak())
    assert len(names(s)) == 2
    assert s.status not in (Status.CONVERGED, Status.TIME_LIMIT)
    assert "further attempts ended after as many iterations as take about 1e-06 s" in s.advice
    assert "within solver.time_limit" not in s.advice


def test_a_limit_of_the_users_stands_for_the_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patience, "_TIMES", 0.0)
    monkeypatch.setattr(patience, "_LEAST", 0.0)
    assert len(names(mbocp.solve(weak(**{"solver.time_limit": 600})))) > 1


def phase(status: Status, iterations: int) -> Any:
    history = [SimpleNamespace(wall_time_s=9.0, is_guess=n == 0) for n in range(iterations + 1)]
    return SimpleNamespace(status=status, history=history)


@pytest.mark.parametrize(("each", "given"), [(1e-4, 2.0), (0.05, 20.0)])
def test_twenty_times_the_first_attempt_are_left_or_two_seconds(each: float, given: float) -> None:
    """By the iterations and their size: how long they take on a machine does not count."""
    own = Patience()
    own.count(phase(Status.SWITCHED, 10), each)
    assert own.iterations(each) is None
    own.count(phase(Status.STAGNATED, 10), each)
    assert own.left == pytest.approx(given)
    own.count(phase(Status.STAGNATED, 3), (given - 0.5) / 3)
    assert own.left == pytest.approx(0.5)
    assert own.iterations(0.2) == 3
    assert not own.is_over
    own.count(phase(Status.STAGNATED, 3), 0.2)
    assert own.is_over
    assert own.iterations(0.2) == 0


@pytest.mark.parametrize("method", ["monolithic", "ipopt"])
def test_a_phase_takes_the_iterations_that_are_left(method: str) -> None:
    """Whatever it takes: its own limit is the user's, and this one ends it as stagnated."""
    formulation, own = formulate(weak().with_(solver={"method": method})), Patience()
    programme, guess = formulation.programme, make_guess("line", formulation)[0]
    own.count(phase(Status.STAGNATED, 1), 1.0)
    own.left = 7 * time_of_iteration(programme, is_interior=method == "ipopt")
    outcome = run_strategy(settings_of(formulation), Start(programme, guess, patience=own))
    assert outcome.iterations == 7
    assert outcome.result.status is Status.STAGNATED
    assert outcome.result.advice.startswith("broken off after 7 iterations")
    assert own.is_over


def test_an_attempt_in_other_units_shares_it() -> None:
    """As one does whose cost is tiny, or whose forces are."""
    formulation, own = formulate(weak(**{"cost.effort": 1e-9, "solver.method": "monolithic"})), Patience()
    assert not formulation.programme.units.are_users
    guess = make_guess("line", formulation)[0]
    outcome = run_strategy(settings_of(formulation), Start(formulation.programme, guess, patience=own))
    assert outcome.result.status is not Status.CONVERGED
    assert own.left < math.inf


def test_what_steps_do_not_resolve_is_kept_and_does_not_end_the_search() -> None:
    """After another guess has failed; the first one's end is the problem's own."""
    goal = {"q": [0.5, 0.0], "v": 0}
    formulation = formulate(Problem.create("double_pendulum", 1.0, 20, goal=goal, scheme="se1"))
    job = Job.of(formulation.problem)
    start = Start(formulation.programme, make_guess("line", formulation)[0])
    fine = run_strategy(settings_of(formulation), start)
    assert status_of(formulation, fine) is Status.CONVERGED
    fast = replace(fine.result.iterate, xs=100.0 * fine.result.iterate.xs)
    coarse = replace(fine, result=replace(fine.result, iterate=fast))
    failed = replace(fine, result=replace(fine.result, status=Status.STAGNATED))
    assert status_of(formulation, coarse) is Status.UNDER_RESOLVED
    for first, ends in ((coarse, True), (failed, False)):
        tried = _GuessRecord()
        assert tried.ends_with(formulation, first, "first", job) is ends
    assert not tried.ends_with(formulation, coarse, "second", job)
    assert not tried.ends_with(formulation, failed, "third", job)
    assert tried.end()[1] == "second"
    assert tried.ends_with(formulation, fine, "fourth", job)
    assert tried.end()[1] == "fourth"


def test_causes_are_asked_once_and_after_failures_alone() -> None:
    asked = []

    def why(cause: Cause | None) -> Callable[[Status], Cause | None]:
        return lambda status: asked.append(status) or cause  # type: ignore[func-returns-value]

    own = Patience(why_in_vain=why(None))
    own.count(phase(Status.CONVERGED, 1), 0.1)
    assert not asked
    for _ in range(2):
        own.count(phase(Status.SINGULAR, 1), 0.1)
    assert asked == [Status.SINGULAR]
    assert not own.is_over
    moon = Cause("reach", "tool0", "the goal is on the moon", is_certain=True, excess=9.0)
    vain = Patience(why_in_vain=why(moon), is_limited=False)
    vain.count(phase(Status.SINGULAR, 1), 0.1)
    assert vain.is_over
    assert vain.words.endswith("none can help: the goal is on the moon")
    assert vain.status_of(Status.SINGULAR) is Status.INFEASIBLE
    assert vain.status_of(Status.TIME_LIMIT) is Status.TIME_LIMIT
    guess = Patience(why_in_vain=why(replace(moon, is_certain=False)))
    guess.count(phase(Status.SINGULAR, 1), 0.1)
    assert guess.status_of(Status.SINGULAR) is Status.SINGULAR

"""After a first attempt that comes to nothing: what cannot help is not tried, and what is tried ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import mbocp
from mbocp.problem import Problem
from mbocp.problem.reasons.cause import Cause
from mbocp.solvers import Status
from mbocp.solvers.strategies import patience
from mbocp.solvers.strategies.patience import Patience
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
    """How much time is left after a first failure [s]."""
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
    assert "further attempts ended after 1e-06 s" in s.advice
    assert "within solver.time_limit" not in s.advice


def test_a_limit_of_the_users_stands_for_the_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(patience, "_TIMES", 0.0)
    monkeypatch.setattr(patience, "_LEAST", 0.0)
    assert len(names(mbocp.solve(weak(**{"solver.time_limit": 600})))) > 1


def phase(status: Status, *seconds: float) -> Any:
    history = [SimpleNamespace(wall_time_s=9.0, is_guess=True)]
    history += [SimpleNamespace(wall_time_s=s, is_guess=False) for s in seconds]
    return SimpleNamespace(status=status, history=history)


@pytest.mark.parametrize(("first", "given"), [(0.001, 2.0), (0.5, 20.0)])
def test_twenty_times_the_first_attempt_are_left_or_two_seconds(first: float, given: float) -> None:
    """Of iterations alone: what came before the first one compiles, and does not count."""
    own = Patience()
    own.count(phase(Status.SWITCHED, first))
    own.count(phase(Status.STAGNATED, first))
    assert own.left == pytest.approx(given)
    own.count(phase(Status.STAGNATED, given - 0.5))
    assert own.left == pytest.approx(0.5)
    assert not own.is_over
    own.count(phase(Status.STAGNATED, 0.6))
    assert own.is_over


def test_causes_are_asked_once_and_after_failures_alone() -> None:
    asked = []

    def why(cause: Cause | None) -> Callable[[Status], Cause | None]:
        return lambda status: asked.append(status) or cause  # type: ignore[func-returns-value]

    own = Patience(why_in_vain=why(None))
    own.count(phase(Status.CONVERGED, 0.1))
    assert not asked
    for _ in range(2):
        own.count(phase(Status.SINGULAR, 0.1))
    assert asked == [Status.SINGULAR]
    assert not own.is_over
    moon = Cause("reach", "tool0", "the goal is on the moon", is_certain=True, excess=9.0)
    vain = Patience(why_in_vain=why(moon), is_limited=False)
    vain.count(phase(Status.SINGULAR, 0.1))
    assert vain.is_over
    assert vain.words.endswith("none can help: the goal is on the moon")
    assert vain.status_of(Status.SINGULAR) is Status.INFEASIBLE
    assert vain.status_of(Status.TIME_LIMIT) is Status.TIME_LIMIT
    guess = Patience(why_in_vain=why(replace(moon, is_certain=False)))
    guess.count(phase(Status.SINGULAR, 0.1))
    assert guess.status_of(Status.SINGULAR) is Status.SINGULAR

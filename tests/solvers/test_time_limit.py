"""`solver.time_limit` ends every method, and counts for all guesses and phases together."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import CompilationTimeout
from mbocp.formulation import formulate, transcribe
from mbocp.guesses import in_turn
from mbocp.guesses.make import make_guess
from mbocp.problem import Problem
from mbocp.solution import IterationRecord, Status

EXAMPLES = Path(__file__).parents[2] / "examples"
METHODS = ("monolithic", "fbsm_newton", "fbsm_bb", "auto", "ipopt", "fatrop")


def pendulum(*settings: str) -> Problem:
    return mbocp.load_problem(EXAMPLES / "paper" / "rigid_pendulum.toml", ["horizon.steps=20", *settings])


def build(problem: Problem) -> None:
    """See to it that all is compiled."""
    transcribe(problem)


def wait_at(number: int, seconds: float) -> Callable[[IterationRecord], None]:
    def callback(record: IterationRecord) -> None:
        if record.iteration == number:
            time.sleep(seconds)

    return callback


@pytest.mark.parametrize("method", METHODS)
def test_every_method_ends_with_what_it_has(method: str) -> None:
    mbocp.solve(pendulum(), solver=method)  # whatever has to be built is there
    s = mbocp.solve(pendulum("solver.time_limit=0.25"), solver=method, callback=wait_at(2, 0.5))
    assert s.status is Status.TIME_LIMIT
    assert not s.converged
    assert s.iterations == 2
    assert "not converged within solver.time_limit, after 2 iterations" in s.advice
    assert "raise it" in s.advice
    assert np.isfinite(s.us).all()
    assert mbocp.solve(pendulum("solver.time_limit=60"), solver=method).converged


@pytest.mark.parametrize("method", ["monolithic", "ipopt"])
def test_other_guesses_get_what_is_left(method: str) -> None:
    """The first guess runs into its limit of iterations; the second is not made any more."""
    problem = mbocp.load_problem(
        EXAMPLES / "arms" / "ur5_reach.toml",
        ["integrator.scheme=se1", "horizon.steps=20", "solver.max_iterations=3", "solver.time_limit=0.4"],
    )
    mbocp.solve(problem.with_(solver=replace(problem.solver, time_limit=None)), solver=method)
    s = mbocp.solve(problem, solver=method, callback=wait_at(3, 0.6))
    assert not s.converged
    assert {r.phase for r in s.history} == {method}
    assert s.iterations == 3  # and none from another


def test_phases_share_it() -> None:
    problem = mbocp.load_problem(
        EXAMPLES / "paper" / "cart_pendulum_elastic.toml",
        ["horizon.steps=200", "solver.globalisation=none", "solver.time_limit=1.5"],
    )
    build(problem)
    s = mbocp.solve(problem, solver="auto", callback=wait_at(45, 1.6))
    assert s.status is Status.TIME_LIMIT
    assert [p.name for p in s.phases if p.name not in ("compile", "guess", "diagnostics")] == [
        "monolithic",
        "fbsm_bb",
    ]
    assert "fbsm_bb ran out of time after" in s.advice


@pytest.mark.usefixtures("compiled")
def test_compiling_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = tmp_path / "cc"
    script.write_text(f"#!/bin/sh\nexec {shutil.which('sleep')} 60\n")
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path))
    clock = time.perf_counter()
    with pytest.raises(CompilationTimeout, match="time_limit passed while the C compiler ran"):
        mbocp.solve(pendulum("solver.time_limit=1"))
    assert time.perf_counter() - clock < 30


def test_a_guess_of_many_steps_looks_at_the_clock() -> None:
    """A horizon of 20,000 steps takes seconds for it."""
    formulation = formulate(pendulum())
    for kind in ("line", "hold"):
        assert make_guess(kind, formulation, time.perf_counter() + 60.0)
        with pytest.raises(CompilationTimeout, match="passed while the guess was made"):
            make_guess(kind, formulation, time.perf_counter() - 1.0)


def test_a_later_guess_without_time_does_not_lose_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    def late(*_: object) -> None:
        raise CompilationTimeout("the guess was made")

    problem = mbocp.load_problem(
        EXAMPLES / "arms" / "ur5_reach.toml",
        ["integrator.scheme=se1", "horizon.steps=20", "solver.max_iterations=3", "solver.method=monolithic"],
    )
    real = in_turn.guesses_in_turn
    monkeypatch.setattr(in_turn, "guesses_in_turn", lambda *given: [next(real(*given)), ("late", late)])
    s = mbocp.solve(problem)
    assert s.status is Status.MAX_ITERATIONS
    assert s.iterations == 3


def test_a_long_compilation_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is left is not enough: a result, and the reason."""
    build = in_turn.formulate_with_independent_ends

    def slow(*args: object, **kwargs: object) -> object:
        time.sleep(0.4)
        return build(*args, **kwargs)

    mbocp.solve(pendulum("solver.max_iterations=1"))
    monkeypatch.setattr(in_turn, "formulate_with_independent_ends", slow)
    s = mbocp.solve(pendulum("solver.time_limit=0.3"))
    assert s.status is Status.TIME_LIMIT
    assert s.iterations == 0
    assert "compiling took 0." in s.advice

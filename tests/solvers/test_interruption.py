"""Ctrl-C in every phase of every method: the best iterate so far, said to be interrupted."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp.cli.app import app
from mbocp.cli.progress_table import ProgressCallback
from mbocp.problem import Problem
from mbocp.solution import IterationRecord, Solution, Status
from mbocp.solvers.staggered.fbsm_newton import FBSMNewton

EXAMPLES = Path(__file__).parents[2] / "examples"
FILE = str(EXAMPLES / "paper" / "rigid_pendulum.toml")
# Hybrids take ten gradient steps.
SETTINGS = (
    "horizon.steps=20",
    "solver.switch_residual=0",
    "solver.switch_cost=0",
    "solver.switch_iterations=10",
)
PHASES = (
    ("monolithic", "monolithic"),
    ("fbsm_newton", "fbsm_newton"),
    ("fbsm_bb", "fbsm_bb"),
    ("fbsm_bb+monolithic", "fbsm_bb"),
    ("fbsm_bb+monolithic", "monolithic"),
    ("fbsm_bb+fbsm_newton", "fbsm_bb"),
    ("fbsm_bb+fbsm_newton", "fbsm_newton"),
    ("auto", "monolithic"),
)


def load(*settings: str) -> Problem:
    return mbocp.load_problem(FILE, (*SETTINGS, *settings))


def cart() -> Problem:
    """Where pure Newton goes nowhere, and `auto` through three phases."""
    path = EXAMPLES / "paper" / "cart_pendulum_elastic.toml"
    return mbocp.load_problem(path, ["horizon.steps=200", 'solver.globalisation="none"'])


def stop_at(phase: str, count: int) -> Callable[[IterationRecord], None]:
    """Press Ctrl-C at the record number `count` of a phase; 0 is where it begins."""
    seen: list[IterationRecord] = []

    def callback(record: IterationRecord) -> None:
        if record.phase == phase:
            seen.append(record)
            if len(seen) == count + 1:
                raise KeyboardInterrupt

    return callback


def check_interrupted(s: Solution) -> None:
    assert s.status is Status.INTERRUPTED
    assert not s.converged
    assert s.advice.startswith("interrupted")
    assert "best iterate" in s.advice
    for name in ("qs", "vs", "us", "mus", "lams", "control_momenta"):
        assert np.isfinite(getattr(s, name)).all(), name
    assert math.isfinite(s.residual)
    assert any(record.residual == s.residual and record.cost == s.cost for record in s.history)


@pytest.mark.parametrize("count", [0, 2])
@pytest.mark.parametrize(("method", "phase"), PHASES)
def test_every_phase_returns_its_best_iterate(method: str, phase: str, count: int) -> None:
    s = mbocp.solve(load(), solver=method, callback=stop_at(phase, count))
    check_interrupted(s)
    steps = [r for r in s.history if r.phase == phase and not r.is_guess]
    assert len(steps) == count
    assert f"interrupted after {count} iteration" in s.advice
    began = next(r for r in s.history if r.phase == phase)
    assert s.residual <= began.residual
    assert [p.name for p in s.phases if p.name.startswith(("fbsm", "mono"))] == (
        ["fbsm_bb", phase] if "+" in method and phase != "fbsm_bb" else [phase]
    )


@pytest.mark.parametrize("phase", ["fbsm_bb", "fbsm_newton"])
def test_auto_returns_the_best_of_all_phases(phase: str) -> None:
    s = mbocp.solve(cart(), solver="auto", callback=stop_at(phase, 2))
    check_interrupted(s)
    assert s.history[-1].phase == phase
    begun = [r.residual for r in s.history if r.is_guess]
    assert s.residual <= min(begun)
    assert f"{phase} was interrupted after 2 iterations" in s.advice


def test_interruption_before_the_first_iterate_of_a_phase(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first sweep of Newton's method takes its time, too: what the gradient steps came to is kept."""

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(FBSMNewton, "init", interrupted)
    s = mbocp.solve(load(), solver="fbsm_bb+fbsm_newton")
    check_interrupted(s)
    assert s.iterations == 10
    assert s.residual == s.history[-1].residual
    with pytest.raises(KeyboardInterrupt):  # nothing to return: the command line says so, with status 130
        mbocp.solve(load(), solver="fbsm_newton")


def test_interruption_after_a_guess_that_failed() -> None:
    """A later guess is worse where it is interrupted: the result is the first one's, and says interrupted."""
    path = EXAMPLES / "arms" / "ur5_reach.toml"
    problem = mbocp.load_problem(
        path, ["integrator.scheme=se1", "horizon.steps=100", "solver.max_iterations=5"]
    )
    s = mbocp.solve(problem, solver="monolithic", callback=stop_at("monolithic (guess: control)", 1))
    check_interrupted(s)
    first = [r.residual for r in s.history if r.phase == "monolithic"]
    assert s.residual == first[-1]


@pytest.mark.parametrize(("method", "phase"), PHASES[:-1])
def test_the_command_line_saves_it_and_exits_with_130(
    method: str, phase: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stop = stop_at(phase, 2)
    monkeypatch.setattr(ProgressCallback, "__call__", lambda _, record: stop(record))
    saved = tmp_path / "swing.h5"
    settings = [part for setting in SETTINGS for part in ("--set", setting)]
    done = CliRunner(env={"COLUMNS": "80", "TERM": "dumb"}).invoke(
        app, ["solve", FILE, *settings, "--solver", method, "-o", str(saved)]
    )
    assert done.exit_code == 130
    assert "interrupted: interrupted after 2 iterations; the best iterate so far" in " ".join(
        done.stdout.split()
    )
    assert Solution.load(saved).status is Status.INTERRUPTED


@pytest.mark.parametrize("name", ["feedback_gains", "keeps_clear"])
def test_what_a_solver_found_is_kept_while_it_is_read(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(f"mbocp.solution.read_solution.{name}", interrupted)
    ball = {"shape": "sphere", "radius": 0.1, "position": [3, 3, 3], "margin": 0.02}
    problem = mbocp.Problem.create(
        "double_pendulum", 1.0, 10, goal={"q": [0.5, 0.2], "v": 0}, obstacle=[ball]
    )
    s = mbocp.solve(problem, gains=True)
    assert s.status == "interrupted"
    assert s.advice.startswith("interrupted before its gains or clearance were known; ")
    assert s.residual < 1e-6

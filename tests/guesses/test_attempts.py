"""A guess that cannot be made is followed by the next one; an error says why each of them failed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import ProblemError
from mbocp.formulation import formulate
from mbocp.guesses import guess_candidates, starts
from mbocp.guesses.make import can_hold, hold
from tests.phases.test_partings import cell

COARSE: dict[str, Any] = {"duration": 4.0, "steps": 10}  # a fall that no simulation with such steps follows


def walker(**more: Any) -> mbocp.Problem:
    """A biped whose foot is held by a constraint of its own, and that cannot stand still."""
    words: dict[str, Any] = {"goal": {"q": {"hip": -0.5}}, "cost": {"effort": 1.0, "velocity": 10.0}}
    return mbocp.Problem.create("compass_gait", **{**COARSE, "scheme": "midpoint", **words, **more})


def test_where_no_guess_can_be_made_the_robot_stays_at_its_start() -> None:
    assert guess_candidates(walker()) == ("control",)
    with pytest.raises(ProblemError, match="forward simulation with constant control fails"):
        mbocp.solve(walker(guess={"kind": "control", "u": [0.0]}))
    solution = mbocp.solve(walker())
    assert solution.residual < 1e-6
    assert solution.guess_used.startswith("hold the start, gravity compensated as far as the controls can")
    assert solution.guess_used.endswith("'control' could not be made")


def test_an_error_says_why_each_guess_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(kind: str, *_: object) -> None:
        raise ProblemError(f"guess: no {kind} here")

    monkeypatch.setattr(starts, "make_guess", fail)
    with pytest.raises(ProblemError) as error:
        mbocp.solve(walker())
    assert str(error.value) == "guess: none could be made; control: no control here; hold: no hold here"


def test_what_is_held_from_the_start_carries_the_robot() -> None:
    """A ball without motors falls unless it is held."""
    robot = cell()
    phase = {"name": "all", "steps": 4, "duration": 0.2}
    words: dict[str, Any] = {"goal": {"v": {"arm": [0.0, 0.0]}}, "scheme": "midpoint"}
    falls = mbocp.Problem.create(robot, phase=[phase], **words)
    place = {"name": "place", "frame": "ball/body"}
    stays = mbocp.Problem.create(robot, phase=[{**phase, "hold": [place]}], **words)
    assert not can_hold(falls)
    assert can_hold(stays)
    assert guess_candidates(stays)[0] == "hold"
    impulses = hold(formulate(stays)).ys  # of each step, 0.05 s: those of the place carry the ball, 0.3 kg
    assert np.abs(impulses).max(axis=1) == pytest.approx(0.3 * 9.81 * 0.05)


def test_newton_from_another_guess_comes_before_ipopt(monkeypatch: pytest.MonkeyPatch) -> None:
    """Too fast for its limit, which arithmetic would say."""
    monkeypatch.setattr("mbocp.problem.reasons.causes.why_in_vain", lambda *_: None)
    words: dict[str, Any] = {"goal": {"q": [2.0, 0.0], "v": [0.0, 0.0]}, "limits": {"velocity": 1.0}}
    duration = {"min": 0.9, "max": 1.1, "guess": 1.0}
    solution = mbocp.solve(mbocp.Problem.create("double_pendulum", duration, 12, **words))
    names = [phase.name for phase in solution.phases]
    assert not solution.converged
    assert names.index("monolithic (guess: hold)") < names.index("ipopt")

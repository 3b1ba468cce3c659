"""Other solvers, where they ask for nothing any more, are ended: by the time limit, Ctrl-C, a callback."""

from __future__ import annotations

import math
import os
import signal
import threading
import time

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import CompilationTimeout, ProblemError
from mbocp.problem import Problem
from mbocp.solution import IterationRecord, Solution, Status
from mbocp.solvers.strategies.elsewhere import Elsewhere


def endless(power: float = 1e-300, **solver: object) -> Problem:
    """Joints that no power may drive: fatrop's loop over ever larger shifts does not end."""
    return Problem.create(
        "double_pendulum",
        1.0,
        10,
        goal={"q": [1.0, 0.5], "v": 0},
        cost={"effort": 1e-9, "velocity": 0.1},
        limits={"power": power},
        solver={"method": "fatrop", **solver},
    )


def check_last_told(s: Solution) -> None:
    assert "did not answer any more" in s.advice
    assert s.history
    assert s.residual == s.history[-1].residual
    assert math.isfinite(s.cost)
    assert all(np.isfinite(values).all() for values in (s.qs, s.vs, s.us))


def test_the_time_limit_ends_it() -> None:
    assert mbocp.solve(endless(power=10.0)).converged  # the process has begun
    s = mbocp.solve(endless(time_limit=1.5))
    assert s.status is Status.TIME_LIMIT
    check_last_told(s)
    after = mbocp.solve(endless(power=10.0, time_limit=60.0))
    assert after.converged  # in another process


def test_ctrl_c_ends_it() -> None:
    def press_later(record: IterationRecord) -> None:
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()

    s = mbocp.solve(endless(), callback=press_later)
    assert s.status is Status.INTERRUPTED
    check_last_told(s)


def test_ctrl_c_between_two_messages_leaves_none_of_them_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    say = Elsewhere._say

    def say_and_press(process: Elsewhere, value: object) -> None:
        say(process, value)
        if value is True:
            raise KeyboardInterrupt

    with monkeypatch.context() as pressed:
        pressed.setattr(Elsewhere, "_say", say_and_press)
        assert mbocp.solve(endless(power=10.0)).status is Status.INTERRUPTED
    heard: list[int] = []
    s = mbocp.solve(endless(power=11.0), callback=lambda record: heard.append(record.iteration))
    assert s.converged
    assert heard == list(range(s.iterations + 1))


def test_what_a_callback_raises_ends_it() -> None:
    def fail(record: IterationRecord) -> None:
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        mbocp.solve(endless(), callback=fail)


def test_a_range_narrower_than_what_fatrop_relaxes_is_refused() -> None:
    narrow = Problem.create(
        "double_pendulum",
        1.0,
        10,
        goal={"q": [1.0, 0.5], "v": 0},
        limits={"effort": {"joint1": 1e-9}},
        solver={"method": "fatrop"},
    )
    with pytest.raises(ProblemError, match=r"relaxes limits by 1e-08, and control 0 may vary by 2e-09 alone"):
        mbocp.solve(narrow)


def test_a_time_limit_ends_ipopt_within_an_iteration() -> None:
    """A horizon of which one iteration takes longer than there is time."""
    long = Problem.create(
        "ur5", 2.0, 8000, goal={"q": [0.5, -1, 1, 0, 0.5, 0], "v": [0] * 6}, solver={"method": "ipopt"}
    )
    begun, words = time.perf_counter(), ""
    try:
        check_last_told(s := mbocp.solve(long, time_limit=4.0))
        words = str(s.status)
    except CompilationTimeout as error:  # on a slow machine it does not even begin
        words = str(error)
    assert "time_limit" in words
    assert time.perf_counter() - begun < 15.0

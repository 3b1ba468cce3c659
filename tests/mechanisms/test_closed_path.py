"""Paths on which loops stay closed: where they lead, and what they do not try."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import mbocp
from mbocp.mechanisms import closed_path as module
from mbocp.mechanisms.closed_path import find_closed_path

PROBLEM = mbocp.load_problem("examples/loops/four_bar.toml")


@given(shares=st.lists(st.floats(0.01, 0.99), max_size=6))
def test_the_way_does_not_depend_on_where_one_looks(shares) -> None:
    """A full turn of the crank, in long steps or short ones: the same configuration at the same share."""
    robot, begin, end = PROBLEM.robot, PROBLEM.q_start, np.asarray(PROBLEM.goal.q)
    fine = np.linspace(0.0, 1.0, 41)
    chosen = np.unique([*shares, 0.5, 1.0])
    found = find_closed_path(robot, begin, end, chosen)
    every = find_closed_path(robot, begin, end, np.union1d(fine, chosen))
    assert found is not None
    assert every is not None
    assert np.abs(found - every[np.isin(np.union1d(fine, chosen), chosen)]).max() < 1e-9
    assert max(np.abs(robot.constraint_residual(q)).max() for q in found) < 1e-9


def test_steps_that_leap_are_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """A crank that is led over more than a step may be long need not have its loop closed to know that."""
    robot, longest = PROBLEM.robot, list[float]()
    closed = module._Loops._close

    def recorded(loops, q, ahead):
        longest.append(float(np.abs(ahead[loops._led]).max()))
        return closed(loops, q, ahead)

    monkeypatch.setattr(module._Loops, "_close", recorded)
    path = find_closed_path(robot, PROBLEM.q_start, np.asarray(PROBLEM.goal.q), np.array([0.0, 0.5, 1.0]))
    assert path is not None
    assert len(longest) >= 2 * np.pi / module._MAX_LEAP
    assert max(longest) < module._MAX_LEAP

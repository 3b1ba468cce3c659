"""Arms by the scheme that problems get which name none: a robot can follow the motion."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import mbocp
from mbocp.problem import parse_problem

ARMS = Path(__file__).parents[2] / "examples" / "arms"


@pytest.mark.parametrize("name", ["ur5_reach", "panda_reach"])
def test_feedback_ends_at_the_goal_and_steps_are_right(name: str) -> None:
    file = ARMS / f"{name}.toml"
    unnamed = re.sub(r"^scheme = .*$", "", file.read_text(encoding="utf-8"), flags=re.MULTILINE)
    problem = parse_problem(unnamed, source=file)
    assert problem.chooses_scheme
    found = mbocp.solve(problem, check=True, accuracy=True).accuracy
    assert found.local_error < 1e-5  # [rad] in a step
    assert found.tracked_error < 1e-3  # [rad] at the end, with the feedback of the optimum
    assert found.own_error < 0.01 * found.local_error

"""Degrees and millimetres in the place of radians and metres are asked about."""

from __future__ import annotations

import math
import warnings
from typing import Any

import pytest

from mbocp.exceptions import ProblemError, UnreachablePose
from mbocp.problem.file.load import parse_problem
from mbocp.problem.limits import ask_degrees, ask_millimetres

ARM = """
robot = "ur5"
horizon = { duration = 1.0, steps = 10 }
goal = { v = 0, q = [0.5, -1.2, 0.5, -0.3, 0.4, 0.2] }
"""
SWING = """
robot = "double_pendulum"
horizon = { duration = 1.0, steps = 10 }
goal = { q = [1.0, 0.5], v = 0 }
"""


def load(text: str, *settings: str) -> Any:
    return parse_problem(text, settings)


def test_angles_beyond_the_limits_are_asked_about() -> None:
    with pytest.warns(UserWarning, match=r"goal\.q: outside .*enforced; elbow_joint: is it in degrees"):
        load(ARM, "goal.q={elbow_joint=90}")
    with pytest.raises(
        ProblemError, match=r"is 90 rad, above .*; is it in degrees\? .90 deg. is 1\.5708 rad"
    ):
        load(ARM, "goal.q={elbow_joint=90}", "limits.position=true")


def test_angles_of_joints_without_limits_are_asked_about() -> None:
    with pytest.warns(UserWarning, match=r"^goal\.q: \w+: is it in degrees\? .-90 deg. is -1\.5708 rad"):
        load(SWING, "goal.q=[-90, 0]")


def test_positions_out_of_reach_are_asked_about() -> None:
    pose = "goal={{v=0, frame={{name='tool0', position={}}}}}"
    with pytest.raises(UnreachablePose, match=r"is it in millimetres\? .-450 mm. is -0\.45 m"):
        load(ARM, pose.format([350, -450, 250]))
    with pytest.raises(UnreachablePose) as refused:
        load(ARM, pose.format([3.5, -4.5, 2.5]))
    assert "millimetres" not in str(refused.value)


def test_other_numbers_are_left_alone() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(SWING, "goal.q=[6.0, -12.0]")
        load(SWING, f"goal.q=[{20 * math.pi}, 0]")  # turns
    assert ask_degrees(3.5, -3.0, 3.0, "rad") == ""  # a little too far
    assert ask_degrees(400.0, -3.0, 3.0, "rad") == ""  # wrong as degrees, too
    assert ask_degrees(90.0, -1.0, 1.0, "m") == ""
    assert ask_millimetres([math.nan, 4.0, -19.0], 15.0) == ask_millimetres([], 0.0) == ""  # a tall crane
    assert ask_millimetres([0.0, 0.1, 0.0], 0.5) == ""  # in the base of the robot
    assert ask_millimetres([0.0, 15.0, 0.0], 14.5) == 'is it in millimetres? "15 mm" is 0.015 m'

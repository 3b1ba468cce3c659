"""What mechanisms with closed loops can get to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mbocp.mechanisms.consistent_states import search
from mbocp.robot import load_robot
from tests.robot.loops import builders as loops


def test_two_degrees_of_freedom_are_led_to_and_fro() -> None:
    robot = load_robot("five_bar")
    rng, everything = np.random.default_rng(3), np.ones(robot.nv, dtype=np.bool_)
    for _ in range(3):
        target = robot.assemble(robot.q0 + rng.uniform(-0.8, 0.8, robot.nv))
        found = search(robot, robot.q0, target, everything)
        assert found is not None
        np.testing.assert_allclose(found, target, atol=1e-6)
        np.testing.assert_allclose(robot.closure_residual(found), 0.0, atol=1e-10)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_one_degree_of_freedom_is_followed_both_ways(tmp_path: Path, side: float) -> None:
    """A rocker swings; its crank passes each of its positions twice a turn."""
    robot = loops.load(tmp_path, loops.four_bar(), loops.MOTOR + loops.OPEN_POSE + loops.HINGE)
    rocker = np.zeros(3, dtype=np.bool_)
    rocker[robot.velocity_indices("rocker")] = True
    q = robot.assemble(robot.q0 + np.array([side, 0.0, 0.0]), fixed=["crank"])
    found = search(robot, robot.q0, q, rocker)
    assert found is not None
    np.testing.assert_allclose(found[2], q[2], atol=1e-6)
    mirrored = robot.q0.copy()
    about = np.arctan2(-loops.CRANK * np.sin(1.0), loops.GROUND - loops.CRANK * np.cos(1.0))
    mirrored[1:] = 2 * about - robot.q0[0] - robot.q0[1] - 1.0, 2 * about - robot.q0[2]
    np.testing.assert_allclose(robot.closure_residual(mirrored), 0.0, atol=1e-12)
    if side > 0:
        assert search(robot, robot.q0, mirrored, np.ones(3, dtype=np.bool_)) is None

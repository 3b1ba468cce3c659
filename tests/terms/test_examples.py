"""The examples of terms of one's own run, and do what they say."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

EXAMPLES = Path(__file__).parents[2] / "examples" / "terms"


def run(name: str) -> dict[str, Any]:
    path = EXAMPLES / f"{name}.py"
    assert len(path.read_text(encoding="utf-8").splitlines()) < 30
    return runpy.run_path(str(path))


def placements(found: dict[str, Any], name: str) -> list[pin.SE3]:
    robot = found["problem"].robot
    data, placed = robot.model.createData(), []
    for q in found[name].qs:
        pin.framesForwardKinematics(robot.model, data, q)
        placed.append(data.oMf[robot.frame_id("tool0")].copy())
    return placed


def test_manipulability_is_gained() -> None:
    found = run("manipulability")
    robot, least = found["problem"].robot, {}
    for name in ("free", "solution"):
        data = robot.model.createData()
        frame = robot.frame_id("tool0")
        values = [
            np.linalg.det(pin.computeFrameJacobian(robot.model, data, q, frame)) for q in found[name].qs
        ]
        least[name] = np.mean(np.abs(values))
    assert least["solution"] > 1.02 * least["free"]


def test_the_tool_stays_upright() -> None:
    found = run("upright")
    angles = {
        name: max(np.rad2deg(np.arccos(-placed.rotation[2, 2])) for placed in placements(found, name))
        for name in ("free", "solution")
    }
    assert angles["free"] > 6.0
    assert angles["solution"] < 5.0 + 1e-5


def test_the_tool_is_at_the_point() -> None:
    found = run("reach_point")
    np.testing.assert_allclose(placements(found, "solution")[-1].translation, [0.4, 0.3, 0.5], atol=1e-9)
    np.testing.assert_allclose(found["solution"].vs[-1], 0.0, atol=1e-9)

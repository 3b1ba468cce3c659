"""Momenta of two robots in one world: each keeps its own, in joint and in natural coordinates."""

from __future__ import annotations

import numpy as np
import pytest

import mbocp
from mbocp.problem import Problem

HELD = ["elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint"]
WORLD = {
    "part": [
        {"name": "left", "robot": "ur5", "position": [0, 0.7, 0], "lock": HELD},
        {"name": "right", "robot": "ur5", "position": [0, -0.7, 0], "lock": HELD},
    ]
}


@pytest.mark.parametrize("coordinates", ["joint", "natural"])
def test_each_keeps_its_own(coordinates: str) -> None:
    goal = {"q": [0.5, -1.0, -0.4, -1.3], "v": 0}
    start = {"q": [0.0, -1.5, 0.0, -1.5]}
    problem = Problem.create(
        WORLD, 1.0, 12, start=start, goal=goal, cost={"effort": 1.0}, coordinates=coordinates, scheme="se1"
    )
    solution = mbocp.solve(problem, check=True)
    kept = solution.conserved
    names = [quantity.name for quantity in kept]
    assert names == [
        "rotation about z through (0, 0.7, 0) of left",
        "rotation about z through (0, -0.7, 0) of right",
    ]
    values = np.array([quantity.value for quantity in kept])
    assert np.abs(values).min() > 1.0
    assert max(quantity.drift for quantity in kept) < 1e-9 * np.abs(values).max()

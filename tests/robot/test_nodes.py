"""Configurations of many nodes at once are those of Pinocchio, one after the other, to the last bit."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.robot.nodes import interpolate, move, steps_between


@pytest.mark.parametrize("name", ["ur5", "panda", "hector"])
@pytest.mark.parametrize("seed", range(3))
def test_nodes_are_pinocchios(name: str, seed: int) -> None:
    robot, rng = mbocp.load_robot(name), np.random.default_rng(seed)
    model, velocities = robot.model, rng.normal(size=(40, robot.nv))
    qs = np.array([pin.integrate(model, pin.neutral(model), v) for v in velocities])
    shares = np.concatenate([[0.0, 1.0], rng.random(38)])
    on_the_way = [pin.interpolate(model, qs[0], qs[1], share) for share in shares]
    assert interpolate(robot, qs[0], qs[1], shares).tobytes() == np.array(on_the_way).tobytes()
    further = [pin.integrate(model, q, v) for q, v in zip(qs, velocities, strict=True)]
    assert move(robot, qs, velocities).tobytes() == np.array(further).tobytes()
    between = [pin.difference(model, a, b) for a, b in pairwise(qs)]
    assert steps_between(robot, qs).tobytes() == np.array(between).tobytes()
    assert steps_between(robot, qs[:1]).shape == (0, robot.nv)

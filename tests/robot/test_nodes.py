"""Configurations of many nodes at once are those of Pinocchio, one after the other, to round-off."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.lie import ConfigurationSpace
from mbocp.robot.kinematics import difference
from mbocp.robot.nodes import interpolate, move, steps_between

ROUND_OFF = 4 * np.finfo(float).eps  # compilers fuse products and sums, each in its own way


def assert_alike(found: Array, wanted: list[Array]) -> None:
    np.testing.assert_allclose(found, wanted, rtol=0, atol=ROUND_OFF * np.abs(wanted).max())


@pytest.mark.parametrize("name", ["ur5", "panda", "hector"])
@pytest.mark.parametrize("seed", range(3))
def test_nodes_are_pinocchios(name: str, seed: int) -> None:
    robot, rng = mbocp.load_robot(name), np.random.default_rng(seed)
    model, velocities = robot.model, rng.normal(size=(40, robot.nv))
    qs = np.array([pin.integrate(model, pin.neutral(model), v) for v in velocities])
    shares = np.concatenate([[0.0, 1.0], rng.random(38)])
    on_the_way = [pin.interpolate(model, qs[0], qs[1], share) for share in shares]
    assert_alike(interpolate(robot, qs[0], qs[1], shares), on_the_way)
    further = [pin.integrate(model, q, v) for q, v in zip(qs, velocities, strict=True)]
    assert_alike(move(robot, qs, velocities), further)
    between = [pin.difference(model, a, b) for a, b in pairwise(qs)]
    assert_alike(steps_between(robot, qs), between)
    assert steps_between(robot, qs[:1]).shape == (0, robot.nv)


@pytest.mark.parametrize(
    "joint",
    [pin.JointModelRUBX(), pin.JointModelRUBZ(), pin.JointModelPlanar()],
)
def test_differences_have_all_digits(joint: pin.JointModel) -> None:
    """Also where Pinocchio's have half of them, of angles near zero; in symbols likewise."""
    model, rng = pin.Model(), np.random.default_rng(0)
    model.addJoint(0, joint, pin.SE3.Identity(), "joint")
    space = ConfigurationSpace(model)
    a, b, w = (ca.SX.sym(*named) for named in (("a", model.nq), ("b", model.nq), ("w", model.nv)))
    move = ca.Function("move", [a, w], [space.integrate(a, w)])
    symbolic = ca.Function("symbolic", [a, b], [space.difference(a, b)])
    for exponent in np.linspace(-12, 0, 60):
        moved = 10.0**exponent * rng.uniform(-1.0, 1.0, size=model.nv)
        q0 = pin.integrate(model, pin.neutral(model), 3.0 * rng.uniform(-1.0, 1.0, size=model.nv))
        q0[-2:] /= np.hypot(*q0[-2:])
        q1 = np.asarray(move(q0, moved)).ravel()
        assert difference(model, q0, q1) == pytest.approx(moved, rel=0, abs=1e-15)
        assert np.asarray(symbolic(q0, q1)).ravel() == pytest.approx(moved, rel=0, abs=1e-15)
        assert (difference(model, q0, q0) == 0.0).all()

"""Configurations of many nodes at once are those of Pinocchio, one after the other, to round-off."""

from __future__ import annotations

from itertools import pairwise

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import CubicHermiteSpline

import mbocp
from mbocp._arrays import Array
from mbocp.lie import ConfigurationSpace
from mbocp.robot.kinematics import difference
from mbocp.robot.nodes import along, along_with_velocities, interpolate, move, steps_between

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


def test_cubics_of_plain_joints_are_those_of_scipy() -> None:
    robot, rng = mbocp.load_robot("ur5"), np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.1, 0.3, 8))
    qs, vs = rng.normal(size=(2, 8, 6))
    times = np.sort(np.append(rng.uniform(t[0], t[-1], 100), t))
    expected = CubicHermiteSpline(t, qs, vs)(times)
    assert along(robot, t, qs, vs, times) == pytest.approx(expected, abs=1e-13)
    _, rates = along_with_velocities(robot, t, qs, vs, times)
    assert rates == pytest.approx(CubicHermiteSpline(t, qs, vs)(times, 1), abs=1e-12)


def test_cubics_of_a_body_in_space_are_of_order_four() -> None:
    """Of a body whose angular velocity turns; chords are geodesics."""
    robot, errors = mbocp.load_robot("hector"), []
    model = robot.model
    start = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))

    def velocity(time: float) -> np.ndarray:
        return np.array([0.3, time, -0.2, np.cos(3.0 * time), 1.0 + time**2, np.sin(2.0 * time)])

    fine = [start]
    for k in range(3200):  # of order two, by its middles
        fine.append(pin.integrate(model, fine[-1], velocity((k + 0.5) / 3200) / 3200))
    for steps in (4, 8, 16):
        t, apart = np.linspace(0.0, 1.0, steps + 1), 3200 // steps
        qs, vs = np.array(fine[::apart]), np.array([velocity(time) for time in t])
        middles = along(robot, t, qs, vs, (t[:-1] + t[1:]) / 2.0)
        exact = fine[apart // 2 :: apart]
        apart_by = [pin.difference(model, *two) for two in zip(exact, middles, strict=True)]
        errors.append(np.abs(apart_by).max())
    assert np.log2(np.divide(errors[:-1], errors[1:])).min() > 3.5
    times, later = np.linspace(0.0, 0.99, 50), 1e-6
    begins, ends = (along(robot, t, qs, vs, times + at) for at in (-later, later))
    rates = along_with_velocities(robot, t, qs, vs, times)[1]
    moved = [pin.difference(model, *two) for two in zip(begins, ends, strict=True)]
    assert rates == pytest.approx(np.array(moved) / (2.0 * later), abs=1e-8)
    assert along_with_velocities(robot, t, qs, vs, t)[1] == pytest.approx(vs, abs=1e-12)
    chords = np.vstack([vs[:1], steps_between(robot, qs) * steps])
    halves = [pin.interpolate(model, a, b, 0.5) for a, b in pairwise(qs)]
    assert along(robot, t, qs, chords, (t[:-1] + t[1:]) / 2.0) == pytest.approx(np.array(halves), abs=1e-15)


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

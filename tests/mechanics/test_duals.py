"""Adjoints in (q, v) and in (q, p): the same covector."""

from __future__ import annotations

import numpy as np
import pytest

from mbocp.mechanics import dual_of_momentum, dual_of_velocity, duals_of_momenta
from mbocp.mechanics.duals import momentum_derivative
from mbocp.robot import Robot, load_robot

from .models import chain
from .models import robot as robot_of


@pytest.fixture(scope="module", params=["ur5", "kinova", "solo12", "rigid_pendulum", "Spherical PX RUBY"])
def robot(request: pytest.FixtureRequest) -> Robot:
    return robot_of(chain(request.param)[0]) if " " in request.param else load_robot(request.param)


def test_momentum_derivative_matches_differences_on_the_manifold(robot: Robot) -> None:
    rng = np.random.default_rng(0)
    q, v = robot.integrate(robot.q0, rng.standard_normal(robot.nv)), rng.standard_normal(robot.nv)
    derivative, h = momentum_derivative(robot, q, v), 1e-5
    for e, column in zip(np.eye(robot.nv), derivative.T, strict=True):
        ahead, behind = (robot.momentum(robot.integrate(q, sign * h * e), v) for sign in (1, -1))
        np.testing.assert_allclose(column, (ahead - behind) / (2 * h), atol=1e-8 * (1 + np.abs(column).max()))


def test_the_covector_is_the_same(robot: Robot) -> None:
    """c_q . dq + c_v . dv = mu_q . dq + mu_p . dp for every motion (dq, dv)."""
    rng = np.random.default_rng(1)
    nv, q = robot.nv, robot.integrate(robot.q0, rng.standard_normal(robot.nv))
    v, mu, (dq, dv) = rng.standard_normal(nv), rng.standard_normal(2 * nv), rng.standard_normal((2, nv))
    costate = dual_of_velocity(robot, q, v, mu)
    dp = momentum_derivative(robot, q, v) @ dq + robot.mass_matrix(q) @ dv
    assert costate @ np.r_[dq, dv] == pytest.approx(mu @ np.r_[dq, dp], rel=1e-11)
    np.testing.assert_allclose(dual_of_momentum(robot, q, v, costate), mu, atol=1e-10)


def test_many_nodes_at_once(robot: Robot) -> None:
    rng = np.random.default_rng(2)
    moves = rng.standard_normal((3, robot.nv))
    qs = np.array([robot.integrate(robot.q0, move) for move in moves])
    vs, costates = rng.standard_normal((3, robot.nv)), rng.standard_normal((3, 2 * robot.nv))
    one_by_one = [dual_of_momentum(robot, *node) for node in zip(qs, vs, costates, strict=True)]
    np.testing.assert_allclose(duals_of_momenta(robot, qs, vs, costates), one_by_one, rtol=1e-10, atol=1e-12)

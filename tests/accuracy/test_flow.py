"""The flow of a robot against scipy on Pinocchio's own numbers."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import DOP853, solve_ivp

import mbocp
from mbocp._arrays import Array
from mbocp.accuracy.dop853 import NODES, SLOPES, WEIGHTS
from mbocp.accuracy.flow import Flow
from mbocp.robot import Robot

TREES = ["double_pendulum", "ur5", "hector", "solo12"]
H = 0.02


def loaded(name: str) -> Robot:
    return mbocp.load_robot(name, actuated=["root_joint"]) if name == "hector" else mbocp.load_robot(name)


def states(robot: Robot, count: int, seed: int = 3) -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(seed)
    qs = [pin.integrate(robot.model, robot.q0, 0.5 * rng.standard_normal(robot.nv)) for _ in range(count)]
    return np.array(qs), rng.standard_normal((count, robot.nv)), rng.standard_normal((count, robot.nu))


def followed(robot: Robot, q: Array, v: Array, u: Array) -> Array:
    """End of the flow, by scipy and Pinocchio, in the tangent space of q."""

    def rate(_: float, x: Array) -> Array:
        at, speed = pin.integrate(robot.model, q, x[: robot.nv]), x[robot.nv :]
        force = robot.actuation_matrix(at) @ u + robot.force_elements(at, speed)
        acceleration = pin.aba(robot.model, data, at, speed, force)
        back = pin.dDifference(robot.model, q, at, pin.ArgumentPosition.ARG1)
        return np.concatenate([back @ speed, acceleration])

    data = robot.model.createData()
    start = np.concatenate([np.zeros(robot.nv), v])
    return np.asarray(solve_ivp(rate, (0.0, H), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1])


@pytest.mark.parametrize("name", TREES)
def test_the_flow_is_that_of_pinocchio(name: str) -> None:
    robot = loaded(name)
    qs, vs, us = states(robot, 4)
    flow = Flow.of(robot)
    ends, end_vs = flow.ends(qs, vs, us, np.full(4, H), 16)
    for q, v, u, end, end_v in zip(qs, vs, us, ends, end_vs, strict=True):
        wanted = followed(robot, q, v, u)
        assert np.allclose(pin.difference(robot.model, q, end), wanted[: robot.nv], atol=1e-10)
        assert np.allclose(end_v, wanted[robot.nv :], rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", TREES)
def test_energies_are_those_of_pinocchio(name: str) -> None:
    robot = loaded(name)
    qs, vs, _ = states(robot, 3)
    data = robot.model.createData()
    wanted = [
        pin.computeKineticEnergy(robot.model, data, q, v) + pin.computePotentialEnergy(robot.model, data, q)
        for q, v in zip(qs, vs, strict=True)
    ]
    assert np.allclose(Flow.of(robot).energies(qs, vs), wanted, rtol=1e-12)


def test_the_method_is_of_order_eight() -> None:
    robot = mbocp.load_robot("double_pendulum")
    qs, vs, us = states(robot, 1)
    flow, long = Flow.of(robot), np.array([0.1])
    exact = flow.ends(qs, vs, us, long, 64)[0]
    errors = [np.abs(flow.ends(qs, vs, us, long, parts)[0] - exact).max() for parts in (4, 8)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(8.0, abs=1.0)


def test_a_replay_is_one_flow_after_the_other() -> None:
    robot = mbocp.load_robot("ur5")
    qs, vs, us = states(robot, 3)
    flow, dts = Flow.of(robot), np.array([0.01, 0.02, 0.03])
    nodes, speeds = flow.replay(qs[0], vs[0], us, dts, 2)
    assert np.array_equal(nodes[0], qs[0])
    ends, end_speeds = flow.ends(nodes[:-1], speeds[:-1], us, dts, 2)
    assert np.allclose(ends, nodes[1:], atol=1e-14)
    assert np.allclose(end_speeds, speeds[1:], atol=1e-13)


@pytest.mark.parametrize("remembers", [False, True])
@pytest.mark.parametrize("blocks", [1, 2])
def test_feedback_changes_the_controls_of_each_step(blocks: int, remembers: bool) -> None:
    """Step after step by `ends`, whose controls answer what the state is away from its plan."""
    robot, N = loaded("hector"), 4
    nv, nu = robot.nv, robot.nu
    qs, vs, _ = states(robot, N)
    rng = np.random.default_rng(5)
    us, gains = (
        rng.standard_normal((N, blocks * nu)),
        rng.standard_normal((N, blocks * nu, 2 * nv + (nu if remembers else 0))),
    )
    flow, dts = Flow.of(robot), np.array([0.01, 0.02, 0.01, 0.03])
    q, v, away = (
        pin.integrate(robot.model, qs[0], 0.1 * rng.standard_normal(nv)),
        vs[0] + 0.1,
        0.2 * np.ones(nu),
    )
    found = flow.track(np.concatenate([q, v, away]), (qs, vs), us, dts, 2, gains)
    for n in range(N):
        deviation = np.concatenate([pin.difference(robot.model, qs[n], q), v - vs[n]])
        moved = gains[n] @ (np.append(deviation, away) if remembers else deviation)
        (q,), (v,) = flow.ends(q[None], v[None], (us[n] + moved)[None], dts[n : n + 1], 2)
        away = moved.reshape(blocks, nu).sum(axis=0)
    np.testing.assert_allclose(found, np.concatenate([q, v, away]), rtol=1e-9, atol=1e-9)


def test_states_that_are_no_numbers_come_back() -> None:
    robot = mbocp.load_robot("double_pendulum")
    qs, vs, us = states(robot, 3)
    qs[1] = np.nan
    ends, speeds = Flow.of(robot).ends(qs, vs, us, np.full(3, H), 2)
    assert np.isnan(ends[1]).all()
    assert np.isnan(speeds[1]).all()
    assert np.isfinite(ends[[0, 2]]).all()
    assert np.isfinite(speeds[[0, 2]]).all()


def test_loops_stay_closed_and_energy_stays() -> None:
    """A four-bar without motors: the flow from velocities on the constraints."""
    robot = mbocp.load_robot("four_bar")
    flow, q = Flow.of(robot), np.asarray(robot.q0)
    v = flow.consistent(q[None], np.ones((1, robot.nv)))
    jacobian = robot.constraint_jacobian(q)
    assert np.abs(jacobian @ v[0]).max() < 1e-13
    assert np.allclose(flow.consistent(q[None], v), v, atol=1e-13)
    nodes, speeds = flow.replay(q, v[0], np.zeros((50, robot.nu)), np.full(50, 0.01), 2)
    residuals, jacobians = robot.closure_along(nodes)
    assert np.abs(residuals).max() < 1e-9
    assert np.abs(np.einsum("nij,nj->ni", jacobians, speeds)).max() < 1e-9
    if not robot.resistances and not robot.forces:
        assert np.ptp(flow.energies(nodes, speeds)) < 1e-9


def test_the_method_has_the_numbers_of_scipy() -> None:
    np.testing.assert_array_equal(SLOPES, DOP853.A[:12, :12])
    np.testing.assert_array_equal(WEIGHTS, DOP853.B)
    np.testing.assert_allclose(NODES, DOP853.C[:12], rtol=0.0, atol=1e-15)  # sums of rows

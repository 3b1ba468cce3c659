"""Boxes hold what is within them: numbers, mass matrices, gravity, momenta, speeds."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
import ruckig
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from mbocp.bounds.intervals import Box, cosine, sine
from mbocp.bounds.momenta import gravity_by_lines, momenta_over, why_no_momenta
from mbocp.bounds.slope_bounds import slopes_of
from mbocp.bounds.speeds import Forces, speeds_after
from mbocp.problem.reasons.least_time import least_time
from mbocp.robot import Robot, load_robot
from tests.robot.urdfs import chain, write

KINDS = [("revolute",), ("prismatic", "revolute"), ("revolute", "revolute", "prismatic", "revolute")]
ANGLES = st.floats(-20.0, 20.0)


@pytest.fixture(params=[*KINDS, "ur5", "kinova"], ids=str)
def robot(request: pytest.FixtureRequest, tmp_path) -> Robot:
    if isinstance(request.param, str):
        return load_robot(request.param)
    return load_robot(write(tmp_path, chain(*request.param)), damping=False)


def mass_matrix(model: pin.Model, q: np.ndarray) -> np.ndarray:
    upper = np.triu(pin.crba(model, model.createData(), q))
    return upper + np.triu(upper, 1).T


def configuration(model: pin.Model, at: np.ndarray) -> np.ndarray:
    """Numbers of q from displacements."""
    q = np.zeros(model.nq)
    for joint in model.joints[1:]:
        x = at[joint.idx_v]
        q[joint.idx_q : joint.idx_q + joint.nq] = x if joint.nq == 1 else (math.cos(x), math.sin(x))
    return q


@given(low=ANGLES, width=st.floats(0.0, 7.0), share=st.floats(0.0, 1.0))
def test_sines_are_enclosed(low, width, share):
    box, x = Box.of([low], [low + width]), low + share * width
    for function, exact in ((sine, math.sin), (cosine, math.cos)):
        found = function(box)
        assert found.lower[0] <= exact(x) <= found.upper[0]
        assert found.size[0] <= 1.0 + 1e-12
        ends = sorted(exact(z) for z in np.linspace(low, low + width, 200))
        assert found.lower[0] >= ends[0] - 1e-3 - (width / 200.0) ** 2  # and not by much more


@given(st.integers(0, 10**6))
def test_products_and_sums_are_enclosed(seed):
    rng = np.random.default_rng(seed)
    a, b = (
        Box.of(c - r, c + r)
        for c, r in zip(rng.normal(size=(2, 1, 3, 3)), rng.uniform(size=(2, 1, 3, 3)), strict=True)
    )
    x, y = (one.centre + one.radius * rng.uniform(-1.0, 1.0, (1, 3, 3)) for one in (a, b))
    for box, value in (
        (a @ b, x @ y),
        (a * b, x * y),
        (a + b, x + y),
        (a - b, x - y),
        (a.T, np.swapaxes(x, 1, 2)),
    ):
        assert (box.lower <= value).all()
        assert (value <= box.upper).all()


@pytest.mark.parametrize("width", [0.0, 0.1, 1.0])
def test_momenta_are_enclosed(robot, width):
    """M, g and what changes momenta, M' v - dT/dq + g, by derivatives of Pinocchio's own."""
    model, rng = robot.model, np.random.default_rng(1)
    middle = rng.uniform(-1.0, 1.0, model.nv)
    found = momenta_over(robot, Box.of([middle - width], [middle + width]))
    for _ in range(20):
        at, v = middle + width * rng.uniform(-1.0, 1.0, model.nv), rng.normal(size=model.nv)
        q = configuration(model, at)
        M, g = mass_matrix(model, q), pin.computeGeneralizedGravity(model, model.createData(), q)
        rates = [
            (
                mass_matrix(model, configuration(model, at + h))
                - mass_matrix(model, configuration(model, at - h))
            )
            / 2e-5
            for h in 1e-5 * np.eye(model.nv)
        ]
        w = g - 0.5 * np.array([v @ rate @ v for rate in rates])
        opposing = found.enclose_opposing(Box.of([v], [v]))
        for box, value, slack in ((found.M, M, 1e-12), (found.gravity, g, 1e-10), (opposing, w, 1e-6)):
            assert (box.lower[0] - slack <= value).all()
            assert (value <= box.upper[0] + slack).all()
    if width == 0.0:
        assert found.M.radius.max() < 1e-9
        assert opposing.radius.max() > 0.0


@pytest.mark.parametrize("width", [0.01, 0.2, 3.0])
def test_gravity_is_enclosed_by_lines(robot, width):
    model, rng = robot.model, np.random.default_rng(3)
    middle = rng.uniform(-1.0, 1.0, model.nv)
    q = Box.of([middle - width], [middle + width])
    gravity = momenta_over(robot, q).gravity
    G, rest = gravity_by_lines(robot, q, gravity)
    assert (rest.radius <= gravity.radius * (1.0 + 1e-9) + 1e-9).all()
    if width == 0.01:
        assert rest.radius.sum() <= 0.2 * gravity.radius.sum()
    for _ in range(50):
        at = middle + width * rng.uniform(-1.0, 1.0, model.nv)
        left = pin.computeGeneralizedGravity(model, model.createData(), configuration(model, at)) - G[0] @ at
        assert (rest.lower[0] - 1e-10 <= left).all()
        assert (left <= rest.upper[0] + 1e-10).all()


def test_slopes_hold(robot):
    model, rng = robot.model, np.random.default_rng(2)
    found = slopes_of(model, np.full(model.nv, 2.0))
    for _ in range(30):
        at = rng.uniform(-2.0, 2.0, model.nv)
        M, g = (
            mass_matrix(model, configuration(model, at)),
            pin.computeGeneralizedGravity(model, model.createData(), configuration(model, at)),
        )
        assert (np.abs(M - np.diag(model.armature)) <= found.M + 1e-12).all()
        assert (np.abs(g) <= found.gravity + 1e-10).all()
        for i, h in enumerate(1e-5 * np.eye(model.nv)):
            q0, q1 = configuration(model, at - h), configuration(model, at + h)
            assert (
                np.abs(mass_matrix(model, q1) - mass_matrix(model, q0)) / 2e-5
                <= found.of_inertia[:, :, i] + 1e-6
            ).all()
            change = pin.computeGeneralizedGravity(
                model, model.createData(), q1
            ) - pin.computeGeneralizedGravity(model, model.createData(), q0)
            assert (np.abs(change) / 2e-5 <= found.of_gravity[:, i] + 1e-6).all()


@pytest.mark.parametrize("seed", range(4))
def test_no_simulated_motion_is_faster(robot, seed):
    """Random torques within their limits, as long as speeds stay within theirs."""
    model, rng, dt = robot.model, np.random.default_rng(seed), 1e-4
    at, n = rng.uniform(-1.0, 1.0, model.nv), model.nv
    most = 20.0 * np.diag(mass_matrix(model, configuration(model, at)))
    fastest = np.full(n, 3.0)
    inf, edges = np.full(n, np.inf), np.append(0.0, np.geomspace(2e-3, 0.3, 40))
    forces = Forces(robot, -most, most, np.zeros(n), np.zeros(n), inf)
    found = speeds_after(edges, at, np.zeros(n), (-fastest, fastest), (-inf, inf), forces)
    assert (found.upper[0] < fastest).any()
    low, high = found.tube(at)
    data, v, t, tau = model.createData(), np.zeros(n), 0.0, rng.uniform(-most, most)
    while t < 0.3:
        if rng.uniform() < 0.01:
            tau = most * rng.choice([-1.0, 1.0], n)
        v = v + dt * pin.aba(model, data, configuration(model, at), v, tau)
        at, t = at + dt * v, t + dt
        if (np.abs(v) > fastest).any():
            break
        k = int(np.searchsorted(edges, t)) - 1
        assert (found.lower[min(k, 39)] - 0.01 <= v).all()  # the simulation is of first order
        assert (v <= found.upper[min(k, 39)] + 0.01).all()
        assert (low[min(k, 39)] - 1e-3 <= at).all()
        assert (at <= high[min(k, 39)] + 1e-3).all()
    assert t > 1e-3


@settings(max_examples=200)
@given(
    d=st.floats(-3.0, 3.0),
    v=st.floats(0.1, 10.0),
    a=st.floats(0.1, 30.0),
    j=st.floats(0.5, 500.0),
    shares=st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)),
)
def test_one_joint_is_as_fast_as_ruckig(d, v, a, j, shares):
    """From rest to rest within jerks; with rates at both ends within accelerations."""
    if abs(d) > 1e-3:
        exact = of_ruckig(d, v, a, j, 0.0, 0.0)
        assert least_time(d, v, a, j, to_rate=0.0, still_ends=2) == pytest.approx(exact, rel=1e-9)
        for ends in (0, 1):
            assert least_time(d, v, a, j, to_rate=0.0, still_ends=ends) <= exact * (1.0 + 1e-12)
    v0, v1 = (v * share for share in shares)
    assume(
        abs(d - (v0 + v1) * abs(v1 - v0) / (2.0 * a)) > 1e-6 * (1.0 + abs(d))
    )  # else on the way, within rounding
    exact = of_ruckig(d, v, a, math.inf, v0, v1)
    assert least_time(d, v, a, from_rate=v0, to_rate=v1) == pytest.approx(exact, rel=1e-6, abs=1e-9)


def of_ruckig(d: float, v: float, a: float, j: float, v0: float, v1: float) -> float:
    asked, found = ruckig.InputParameter(1), ruckig.Trajectory(1)
    asked.current_velocity, asked.target_position, asked.target_velocity = [v0], [d], [v1]
    asked.max_velocity, asked.max_acceleration, asked.max_jerk = [v], [a], [j]
    ruckig.Ruckig(1).calculate(asked, found)
    return float(found.duration)


def test_what_is_not_enclosed_is_named():
    assert why_no_momenta(load_robot("ur5")) == ""
    assert "floating" in why_no_momenta(load_robot("iris"))

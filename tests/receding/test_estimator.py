"""An estimator: beside all samples at once, on manifolds, its deviations, and what it says of itself."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.programme.compilation import load_functions
from mbocp.programme.compiler import compiler
from mbocp.receding import MovingHorizonEstimator, estimator_functions
from mbocp.receding.estimator_functions import EstimatorLayout, load_estimator_functions
from mbocp.receding.unknowns import unknowns_of
from mbocp.robot import Payload, Robot
from tests.mechanics.models import chain, point_mass, robot, weightless

HERE = Path(__file__).parent
LOAD = {"frame": "tool0", "name": "load", "com": [0.0, 0.0, 0.05]}
PERIOD = 1e-3  # [s]


def simulate(own: Robot, q, v, forces, rng, sigma, substeps=2, friction=0.0):
    """Samples (q, v, noisy q) of a motion under forces that hold for a period each, by Heun's method."""
    model, data = own.model, own.model.createData()
    h = PERIOD / substeps
    for force in forces:
        for _ in range(substeps):
            middle = v + h / 2 * pin.aba(model, data, q, v, force - friction * v)
            at_middle = pin.integrate(model, q, h / 2 * v)
            v = v + h * pin.aba(model, data, at_middle, middle, force - friction * middle)
            q = pin.integrate(model, q, h * middle)
        yield q, v, pin.integrate(model, q, sigma * rng.standard_normal(own.nv))


@pytest.fixture(scope="module")
def arm() -> Robot:
    return mbocp.load_robot("ur5", payload=[{**LOAD, "mass": 0.0}])


def of_arm(arm: Robot, **changes) -> MovingHorizonEstimator:
    said = {
        "measured": {"q": 1e-4},
        "unknowns": {"robot.payload.load.mass": 3.0},
        "disturbance": 0.3 * math.sqrt(PERIOD),
        **changes,
    }
    return MovingHorizonEstimator(arm, **said)


@pytest.mark.parametrize("samples", [1, 4])
def test_what_falls_out_of_the_horizon_is_remembered(samples):
    """Of a linear robot nothing is lost: a short horizon says what one over all samples does."""
    own, rng = point_mass(), np.random.default_rng(1)
    said = {"measured": {"q": [1e-3, 2e-3, math.inf]}, "disturbance": 0.05}
    length = samples * PERIOD
    short = MovingHorizonEstimator(own, horizon=3 * length, steps=3, **said)
    whole = MovingHorizonEstimator(own, horizon=60 * length, steps=60, **said)
    forces = 3.0 * rng.standard_normal((50, 3))
    motion = simulate(own, np.zeros(3), np.zeros(3), forces, rng, 1e-3)
    for estimator in (short, whole):
        estimator.update(np.zeros(3))
    for force, (_, _, y) in zip(forces, motion, strict=True):
        found, expected = (one.update(y, force, dt=PERIOD) for one in (short, whole))
    np.testing.assert_allclose(found.q, expected.q, atol=1e-10)
    np.testing.assert_allclose(found.v, expected.v, atol=1e-8)
    np.testing.assert_allclose(found.standard_deviations, expected.standard_deviations, rtol=1e-7)


def test_samples_of_a_linear_robot_are_filtered_as_by_least_squares():
    """One step for each sample: the mean is that of all samples, noise and first state at once."""
    own, rng, sigma, density = point_mass(), np.random.default_rng(2), 1e-3, 0.05
    estimator = MovingHorizonEstimator(
        own, horizon=5 * PERIOD, steps=5, measured={"q": sigma}, disturbance=density, speed=0.5
    )
    n, first = 30, np.array([0.1, -0.2, 0.3])
    samples = first + 1e-2 * rng.standard_normal((n, 3))
    found = estimator.update(first)
    for sample in samples:
        found = estimator.update(sample, np.zeros(3), dt=PERIOD)
    gravity = own.model.gravity.linear
    A = np.array([[1.0, PERIOD], [0.0, 1.0]])
    B = np.array([PERIOD / 2, 1.0])  # of a change of velocity, which is even over the step
    for axis in range(3):
        rows, values = [np.eye(n + 2)[0] / sigma, np.eye(n + 2)[1] / 0.5], [first[axis] / sigma, 0.0]
        state, given = np.eye(2, n + 2), np.zeros(2)
        for k in range(n):
            state, given = A @ state, A @ given + B * gravity[axis] * PERIOD
            state[:, k + 2] += B * density * math.sqrt(PERIOD)  # unit mass
            rows += [np.eye(n + 2)[k + 2], state[0] / sigma]
            values += [0.0, (samples[k, axis] - given[0]) / sigma]
        solved = np.linalg.lstsq(np.array(rows), np.array(values), rcond=None)[0]
        covariance = state @ np.linalg.inv(np.array(rows).T @ np.array(rows)) @ state.T
        np.testing.assert_allclose([found.q[axis], found.v[axis]], state @ solved + given, atol=1e-8)
        deviations = found.standard_deviations[[axis, axis + 3]]
        np.testing.assert_allclose(deviations, np.sqrt(np.diag(covariance)), rtol=1e-6)


def test_measured_velocities_count():
    own, rng = point_mass(), np.random.default_rng(3)
    without = MovingHorizonEstimator(own, measured={"q": 1e-3}, disturbance=0.05)
    with_v = MovingHorizonEstimator(own, measured={"q": 1e-3, "v": 1e-2}, disturbance=0.05)
    forces = np.zeros((60, 3))
    without.update(np.zeros(3)), with_v.update(np.zeros(3), v=np.zeros(3))
    for *truth, y in simulate(own, np.zeros(3), np.zeros(3), forces, rng, 1e-3):
        coarse = without.update(y, dt=PERIOD)
        fine = with_v.update(y, v=truth[1] + 1e-2 * rng.standard_normal(3), dt=PERIOD)
    assert (fine.standard_deviations < coarse.standard_deviations).all()
    off = np.concatenate([fine.q, fine.v]) - np.concatenate(truth)
    assert (np.abs(off) < 4.0 * fine.standard_deviations).all()


def test_an_arm_tells_its_payload_and_friction(arm):
    """A payload of 2 kg that is taken up after 0.2 s, and friction that its file does not have."""
    rng, v, friction = np.random.default_rng(0), np.zeros(6), 2.0
    heavy = mbocp.load_robot("ur5", payload=[{**LOAD, "mass": 2.0}])
    q = np.array([0.0, -1.3, 1.4, -1.6, -1.5, 0.0])
    estimator = of_arm(
        arm,
        unknowns={"robot.payload.load.mass": 3.0, "robot.damping": 3.0},
        drift={"robot.payload.load.mass": 3.0},
    )
    assert estimator.names[:2] == ("robot.payload.load.mass", "robot.joint.shoulder_pan_joint.damping")
    found = estimator.update(q)
    assert set(found.unobserved) == set(estimator.names)
    for own in (arm, heavy):
        for k in range(200):
            wave = np.array([40.0, 40.0, 20.0, 4.0, 3.0, 2.0]) * np.cos(0.03 * k + np.arange(6.0))
            force = pin.rnea(own.model, own.model.createData(), q, v, np.zeros(6)) + wave
            ((q, v, y),) = simulate(own, q, v, [force], rng, 1e-4, friction=friction)
            found = estimator.update(y, force, dt=PERIOD)
            assert found.status.is_good, found.status
    truth = np.concatenate([q, v, [2.0], np.full(6, friction)])
    off = np.abs(np.concatenate([found.q, found.v, list(found.parameters.values())]) - truth)
    assert (off < 4.0 * found.standard_deviations).all(), off / found.standard_deviations
    assert found.deviations["robot.payload.load.mass"] < 0.3
    assert "robot.payload.load.mass" not in found.unobserved
    assert estimator.robot().payloads[0].mass == found.parameters["robot.payload.load.mass"]
    taken = mbocp.RecedingHorizon(
        mbocp.load_problem("examples/receding/ur5_follow.toml").with_(robot=arm)
    ).step(found.q, found.v, robot=estimator.robot())
    assert taken.status.is_good, taken.status


@pytest.mark.slow
def test_deviations_are_honest(arm):
    """Normalised squares of errors, after 80 samples of forty motions, have the mean that they ought to."""
    errors, q0 = [], np.array([0.0, -1.3, 1.4, -1.6, -1.5, 0.0])
    for seed in range(40):
        rng = np.random.default_rng(seed)
        mass = abs(3.0 * rng.standard_normal())
        own = mbocp.load_robot("ur5", payload=[{**LOAD, "mass": mass}])
        estimator = of_arm(arm, horizon=0.08, steps=40)
        q, v = q0, rng.standard_normal(6)
        estimator.update(q + 1e-4 * rng.standard_normal(6))
        for k in range(80):
            force = pin.rnea(own.model, own.model.createData(), q, v, 5.0 * np.sin(0.02 * k + np.arange(6.0)))
            noise = 0.3 * rng.standard_normal(6)
            ((q, v, y),) = simulate(own, q, v, [force + noise], rng, 1e-4)
            found = estimator.update(y, force, dt=PERIOD)
        off = np.concatenate([found.q - q, found.v - v, [found.parameters["robot.payload.load.mass"] - mass]])
        errors.append(off / found.standard_deviations)
    squares = np.array(errors) ** 2
    assert 0.85 < squares.mean() < 1.15
    assert 0.92 < (squares < 1.96**2).mean() < 0.98


@pytest.mark.parametrize("period", [PERIOD, 4 * PERIOD])
def test_attitudes_and_circles_are_estimated_on_their_groups(period):
    """A tumbling body with an unlimited joint and an unknown weight on it, both pushed."""
    model, _ = chain("FreeFlyer RUBY", model=pin.Model())
    model.appendBodyToJoint(1, pin.Inertia.FromSphere(8.0, 0.3), pin.SE3.Identity())
    bare = robot(weightless(model))
    light, heavy = (bare.with_payload(Payload(frame="body", name="load", mass=m)) for m in (1.0, 2.5))
    estimator = MovingHorizonEstimator(
        light,
        horizon=0.04,
        steps=10,
        measured={"q": 1e-4},
        unknowns={"robot.payload.load.mass": 2.0},
        disturbance=1e-2,
        speed=4.0,
        iterations=3,
    )
    rng = np.random.default_rng(4)
    q, v = pin.randomConfiguration(model, np.zeros(9), np.ones(9)), 2.0 * rng.standard_normal(7)
    estimator.update(q)
    for k in range(200):
        since = k - k % round(period / PERIOD)  # what is given holds until the next sample
        force = 10.0 * np.sin(0.02 * since + np.arange(7.0))
        ((q, v, y),) = simulate(heavy, q, v, [force], rng, 1e-4)
        if (k + 1) % round(period / PERIOD) == 0:
            found = estimator.update(y, force, dt=period)
    assert np.linalg.norm(found.q[3:7]) == pytest.approx(1.0, abs=1e-9)
    assert np.linalg.norm(found.q[7:]) == pytest.approx(1.0, abs=1e-9)
    off = np.concatenate(
        [pin.difference(model, found.q, q), found.v - v, [found.parameters["robot.payload.load.mass"] - 2.5]]
    )
    assert (np.abs(off) < 4.0 * found.standard_deviations).all(), off / found.standard_deviations
    assert found.deviations["robot.payload.load.mass"] < 0.3


def test_the_place_of_a_weight_and_dry_friction_are_found():
    """Of a lever that swings about a level axis, one way and the other."""
    own = robot(chain("RY")[0])
    truth = Payload(frame="body", name="load", mass=1.0, com=(0.4, 0.0, -0.1))
    heavy, guess = own.with_payload(truth), own.with_payload(Payload(frame="body", name="load", mass=1.0))
    estimator = MovingHorizonEstimator(
        guess,
        measured={"q": 1e-5},
        unknowns={"robot.payload.load.com": 0.5, "robot.joint.0_RY.friction": 5.0},
        disturbance=1e-3,
        steps=50,
    )
    names = (
        "robot.payload.load.com.x",
        "robot.payload.load.com.y",
        "robot.payload.load.com.z",
        "robot.joint.0_RY.friction",
    )
    assert estimator.names == names
    rng, q, v, dry = np.random.default_rng(6), np.zeros(1), np.zeros(1), 2.0
    estimator.update(q)
    for k in range(1500):
        given = np.array([30.0 * np.sin(0.006 * k)])
        force = given - dry * np.tanh(v / 0.1)
        ((q, v, y),) = simulate(heavy, q, v, [force], rng, 1e-5, substeps=1)
        found = estimator.update(y, given, dt=PERIOD)
    off = np.abs(np.array(list(found.parameters.values())) - [0.4, 0.0, -0.1, dry])
    assert found.unobserved == ("robot.payload.load.com.y",)  # along the axis
    assert (off < [0.01, 0.01, 0.01, 0.05]).all(), off
    laden = estimator.robot()
    np.testing.assert_allclose(
        pin.crba(laden.model, laden.model.createData(), q),
        pin.crba(heavy.model, heavy.model.createData(), q),
        rtol=0.02,
    )


def test_what_no_sample_tells_is_named():
    """A weight in the axis of an upright joint does not show, and one beside it does."""
    own = robot(chain("RZ")[0])
    force, found = np.array([1.0]), {}
    for x in (0.0, 0.5):
        laden = own.with_payload(Payload(frame="body", name="load", mass=1.0, com=(x, 0.0, 0.2)))
        estimator = MovingHorizonEstimator(
            laden, measured={"q": 1e-5}, unknowns={"robot.payload.load.mass": 0.5}, disturbance=1e-3
        )
        estimator.update(np.zeros(1))
        for q, _, _ in simulate(
            laden, np.zeros(1), np.zeros(1), [force] * 300, np.random.default_rng(0), 0.0
        ):
            found[x] = estimator.update(q, force, dt=PERIOD)
    assert found[0.0].unobserved == ("robot.payload.load.mass",)
    assert found[0.0].deviations["robot.payload.load.mass"] == pytest.approx(0.5)
    assert found[0.0].parameters["robot.payload.load.mass"] == pytest.approx(1.0)
    assert found[0.5].unobserved == ()
    assert found[0.5].deviations["robot.payload.load.mass"] < 0.05


def test_derivatives_are_those_of_differences_on_the_group():
    """Of rows and gradient, in both states along their tangents, in noise and in constants."""
    model, _ = chain("FreeFlyer RUBY")
    own = robot(model).with_payload(Payload(frame="body", name="load", mass=0.7, com=(0.1, 0.2, 0.3)))
    words = ("robot.payload.load.mass", "robot.payload.load.com", "robot.damping", "robot.friction")
    constants = unknowns_of(own, words)
    at = EstimatorLayout(own.nq, own.nv, own.nu, len(constants))
    of = load_estimator_functions(own, constants, has_v=True).stage_function
    rng, n = np.random.default_rng(7), at.ndx
    theta, rho = rng.uniform(0.5, 1.0, at.num_theta), rng.uniform(0.5, 1.0, at.num_rho)
    for name, value in {"h": 0.1, "rate": 10.0, "moves": 1.0, "arrives": 0.5, "reference": own.q0}.items():
        rho[at.rho[name]] = value
    x = np.concatenate([own.q0, np.zeros(own.nv), [unknown.value for unknown in constants]])
    moved = of("retract")
    x0, x1 = (moved.evaluate([x, 0.1 * rng.standard_normal(n)], 1, False)[0] for _ in range(2))
    w, linear, size = rng.standard_normal(at.nw), of("linear"), 1e-6
    _, slopes, gradient, _ = linear.evaluate([x0, x1, w, theta, rho], 1, False)

    def values(d):
        ends = [moved.evaluate([x, part], 1, False)[0] for x, part in ((x1, d[:n]), (x0, d[n : 2 * n]))]
        return of("values").evaluate([ends[1], ends[0], np.zeros(0), w + d[2 * n :], theta, rho], 1, False)

    for k, unit in enumerate(size * np.eye(2 * n + at.nw)):
        (c, cost), (c_before, cost_before) = values(unit), values(-unit)
        np.testing.assert_allclose(slopes.reshape(-1, n)[k], (c - c_before) / (2 * size), atol=1e-6)
        np.testing.assert_allclose(gradient[k], (cost - cost_before) / (2 * size), atol=1e-5)


def test_a_lost_sample_is_bridged():
    own, rng = point_mass(), np.random.default_rng(5)
    estimator = MovingHorizonEstimator(own, measured={"q": 1e-3}, disturbance=0.05)
    estimator.update(np.zeros(3))
    forces = np.full((80, 3), 2.0)
    motion = simulate(own, np.zeros(3), np.zeros(3), forces, rng, 1e-3)
    for k, (force, (q, _, y)) in enumerate(zip(forces, motion, strict=True)):
        found = estimator.update(None if k >= 60 else y, force, dt=PERIOD)
        assert found.status.state != "bad_input"
        if k == 59:
            before = found
        assert (np.abs(found.q - q) < 4.5 * found.standard_deviations[:3]).all()
    assert (found.standard_deviations > before.standard_deviations).all()


def test_what_has_no_solution_is_said():
    """A base without mass: its accelerations do not follow from forces."""
    estimator = MovingHorizonEstimator(
        robot(chain("FreeFlyer RUBY")[0]), measured={"q": 1e-4}, disturbance=1e-2
    )
    q, told = pin.neutral(estimator._robot.model), set()
    for _ in range(40):
        found = estimator.update(q, np.zeros(7), dt=PERIOD)
        told.add(found.status.state)
        assert found.standard_deviations.shape == (14,)
    assert told - {"moved_on", "improved", "converged"}


def test_an_estimate_that_is_lost_begins_anew():
    estimator = MovingHorizonEstimator(
        robot(weightless(chain("FreeFlyer")[0])), measured={"q": 1e-4}, disturbance=1e-2
    )
    q = pin.neutral(estimator._robot.model)
    for _ in range(5):
        estimator.update(q, np.zeros(6))
    estimator._root_before = np.full((12, 12), math.nan)
    found = estimator.update(q, np.zeros(6))
    assert found.status.detail == "the estimate was not finite, and begins anew"
    for _ in range(30):
        found = estimator.update(q, np.zeros(6))
        assert found.status.is_good, found.status
    assert (found.standard_deviations < 1e-2).all()


def test_an_estimate_begins_anew_after_a_control_that_cannot_have_been():
    own = robot(weightless(chain("RX RY")[0]))
    estimator = MovingHorizonEstimator(own, steps=5, horizon=0.05, measured={"q": 1e-3}, disturbance=1e-2)
    details = set()
    for k in range(100):
        found = estimator.update(np.array([0.3, 0.2]), np.full(2, 1e6 if k == 10 else 0.0))
        details.add(found.status.detail)
    assert "the estimate was far from all samples of a horizon, and begins anew" in details
    assert found.status.is_good
    np.testing.assert_allclose(found.q, [0.3, 0.2], atol=1e-3)
    np.testing.assert_allclose(found.v, 0.0, atol=1e-2)


BAD_SAMPLES = {
    "q: got shape (2,), expected (3,)": {"q": np.zeros(2)},
    "q: not finite": {"q": np.full(3, math.nan)},
    "q: not an array of numbers": {"q": "here"},
    "u: got shape (), expected (3,)": {"u": 1.0},
    "v: `measured` does not have it": {"v": np.zeros(3)},
    "dt: got -1, expected a time >= 0": {"dt": -1},
    "dt: got 0, expected the time since": {"dt": 0},
    "time_limit: got soon, expected a time >= 0": {"time_limit": "soon"},
    "iterations: got -2, expected a whole number of at least 0": {"iterations": -2},
}


@pytest.mark.parametrize("words", BAD_SAMPLES)
def test_a_bad_sample_is_said_and_does_no_harm(words):
    estimator = MovingHorizonEstimator(point_mass(), measured={"q": 1e-3}, disturbance=0.05)
    early = estimator.update(np.full(3, math.nan))
    assert "the first sample must have it" in early.status.words
    estimator.update(np.zeros(3))
    for _ in range(30):
        estimator.update(np.zeros(3), np.zeros(3), dt=PERIOD)
        found = estimator.update(**{"q": np.zeros(3), "dt": PERIOD, **BAD_SAMPLES[words]})
        assert found.status.state == "bad_input"
        assert words in found.status.words
    assert np.isfinite(found.q).all()
    assert estimator.update(np.zeros(3), dt=PERIOD).status.is_good


REFUSED = {
    "robot 'four_bar' has closed loops": {"robot": "robots/four_bar"},
    "robot 'unicycle_pendulum' has drives": {"robot": "robots/unicycle_pendulum"},
    "measured.q: missing": {"measured": {"v": 1.0}},
    "measured: got 'tau', expected some of: q, v": {"measured": {"q": 1.0, "tau": 1.0}},
    "measured.q: got 0.0, expected a number that is positive, or 6": {"measured": {"q": 0.0}},
    "unknowns: got 'robot.payload.load.weight'": {"unknowns": {"robot.payload.load.weight": 1.0}},
    "got 'payload.load.mass'; this is 'robot.payload.load.mass' now": {
        "unknowns": {"payload.load.mass": 1.0}
    },
    "got 'friction.viscous'; this is 'robot.damping' now": {"unknowns": {"friction.viscous": 1.0}},
    "this is 'robot.joint.elbow_joint.friction' now": {"unknowns": {"friction.coulomb.elbow_joint": 1.0}},
    "is there twice": {"unknowns": {"robot.damping": 1.0, "robot.joint.elbow_joint.damping": 1.0}},
    "unknowns.robot.payload.load.mass: got -1": {"unknowns": {"robot.payload.load.mass": -1}},
    "drift: got 'robot.damping', expected some of: robot.payload.load.mass": {
        "drift": {"robot.damping": 1.0}
    },
    "disturbance: got nan, expected a number that is not negative": {"disturbance": math.nan},
    "steps: got 0, expected a whole number of at least 1": {"steps": 0},
    "horizon: got inf, expected": {"horizon": math.inf},
}


@pytest.mark.parametrize("words", REFUSED)
def test_what_cannot_be_estimated_is_refused(words, arm):
    given = dict(REFUSED[words])
    with pytest.raises((ProblemError, InvalidValue)) as raised:
        of_arm(given.pop("robot", arm), **given)
    assert words in str(raised.value)


def test_a_pose_is_measured_as_a_whole_or_not_at_all():
    own = robot(chain("FreeFlyer")[0])
    for sigma in ([1e-4] * 3 + [math.inf] * 3, [math.inf] * 5 + [1.0]):
        with pytest.raises(ProblemError, match="joint '0_FreeFlyer' has some components that are inf"):
            MovingHorizonEstimator(own, measured={"q": sigma}, disturbance=1e-2)


def test_a_first_estimator_waits_for_no_compiler(tmp_path, monkeypatch):
    monkeypatch.setattr(estimator_functions, "load_functions", load_functions)
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("MBOCP_FUNCTIONS", "auto")
    said = {"measured": {"q": 1e-3}, "disturbance": 0.05}
    sample = np.array([0.1, -0.2, 0.3])
    early = MovingHorizonEstimator(point_mass(), **said)
    assert early._functions.library is None
    monkeypatch.setenv("MBOCP_FUNCTIONS", "compiled")
    later = MovingHorizonEstimator(point_mass(), **said)
    assert (later._functions.library is None) == (compiler() is None)
    for moved in (0.0, 1e-3, 3e-3):
        found, expected = (one.update(sample + moved, np.ones(3), dt=PERIOD) for one in (early, later))
    np.testing.assert_allclose(found.v, expected.v, rtol=1e-12)
    np.testing.assert_allclose(found.standard_deviations, expected.standard_deviations, rtol=1e-12)


@pytest.mark.parametrize(
    ("functions", "robot", "frame"), [("tapes", "ur5", "tool0"), ("compiled", "double_pendulum", "link2")]
)
@pytest.mark.skipif(sys.platform != "linux", reason="LD_PRELOAD and the counter are for Linux")
def test_the_kernel_allocates_nothing(functions, robot, frame, tmp_path):
    counter, cc = tmp_path / "allocations.so", compiler()
    if cc is None:
        pytest.skip("no C compiler")
    command = [*cc, "-shared", "-fPIC", "-O1", "-o", counter, HERE / "allocations.c", "-ldl"]
    subprocess.run(command, check=True)
    found = subprocess.run(
        [sys.executable, HERE / "count_estimator.py", robot, frame],
        env={**os.environ, "LD_PRELOAD": str(counter), "MBOCP_FUNCTIONS": functions},
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == ["0"]

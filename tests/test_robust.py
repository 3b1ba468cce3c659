"""Tubes against theory, simulations and other mechanics; limits that leave room for them; what is refused."""

from __future__ import annotations

import pickle
import sys
import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))  # benchmarks are not part of the package

import mbocp
from benchmarks.robust import robust_table, simulate
from mbocp.exceptions import InvalidValue, MbocpError, ProblemError, SolverError
from mbocp.formulation.gains import tangents
from mbocp.robot.kinematics import frame_jacobian
from mbocp.robust import Tubes

EXAMPLES = Path(__file__).parents[1] / "examples"
SLIDERS = """<robot name="sliders"><link name="rail"/>
<link name="cart"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="x" type="prismatic"><parent link="rail"/><child link="cart"/><axis xyz="1 0 0"/>
<limit effort="50" velocity="9" lower="-9" upper="9"/></joint></robot>"""
MASS = 2.0
BALL = {"name": "ball", "frame": "link2", "mass": 0.2, "com": [0.0, 0.0, 0.1]}


@pytest.fixture
def cart(tmp_path):
    path = tmp_path / "sliders.urdf"
    path.write_text(SLIDERS)
    return mbocp.load_robot(path)


def cart_problem(cart, **others):
    goal = {"q": [0.5], "v": 0}
    return mbocp.Problem.create(cart, 1.0, 20, goal=goal, cost={"velocity": 1.0}, scheme="gauss2", **others)


def pendulum(scheme="gauss2", steps=16, **others):
    given = {"start": {"q": 0.02, "v": 0.03}, "disturbance": {"tau": 0.0005}}
    return mbocp.Problem.create(
        mbocp.load_robot("double_pendulum"),
        0.6,
        steps,
        start={"q": [0.3, -0.2], "v": [0.1, 0.4]},
        goal={"q": [0.5, 0.1], "v": 0},
        cost={"effort": 0.1, "velocity": 1.0},
        scheme=scheme,
        **{"robust": given, **others},
    )


def solved(problem):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return mbocp.solve(problem, check=True)


def test_a_cart_without_feedback_strays_as_theory_says(cart):
    start, tau = {"q": 0.01, "v": 0.05}, 0.3
    given = {"start": start, "disturbance": {"tau": tau}, "feedback": "none"}
    solution = solved(cart_problem(cart, robust=given))
    t, h = solution.t, solution.t[1]
    np.testing.assert_allclose(solution.sigma_vs[:, 0] ** 2, 0.05**2 + tau**2 * t / MASS**2, rtol=1e-9)
    noise = tau**2 / MASS**2 * (t**3 / 3.0 - t * h**2 / 12.0)  # held over steps of length h
    np.testing.assert_allclose(solution.sigma_qs[:, 0] ** 2, 0.01**2 + (0.05 * t) ** 2 + noise, rtol=1e-9)
    assert not solution.sigma_us.any()


def test_a_cart_with_feedback_keeps_the_lyapunov_equation(cart):
    solution = solved(cart_problem(cart, robust={"start": {"q": 0.01}, "disturbance": {"tau": 0.3}}))
    h, P = solution.t[1], np.diag([0.01**2, 0.0])
    A, B = np.array([[1.0, h], [0.0, 1.0]]), np.array([[h**2 / 2.0], [h]]) / MASS
    for n, K in enumerate(solution.gains):
        np.testing.assert_allclose(solution.sigma_us[n, 0] ** 2, (K @ P @ K.T).item(), rtol=1e-8, atol=1e-20)
        P = (A + B @ K) @ P @ (A + B @ K).T + 0.3**2 / h * B @ B.T
        deviations = [solution.sigma_qs[n + 1, 0], solution.sigma_vs[n + 1, 0]]
        np.testing.assert_allclose(deviations, np.sqrt(np.diag(P)), rtol=1e-8)


@pytest.mark.parametrize(("scheme", "substeps"), [("gauss2", 1), ("rk4", 6)])
def test_covariances_are_those_of_simulations(scheme, substeps):
    problem = pendulum(scheme, steps=24).with_(substeps=substeps)  # the damping of the joints is fast
    solution = solved(problem)
    runs = simulate(problem, solution, 500, finer=2, holds_noise=True)
    q, v = runs.away(problem, solution)
    for found, expected in ((q.std(axis=0), solution.sigma_qs), (v.std(axis=0), solution.sigma_vs)):
        atol = 0.03 * expected.max()
        np.testing.assert_allclose(found, expected, rtol=0.12, atol=atol)  # of 500 runs: 3 % is one deviation
    np.testing.assert_allclose((runs.us - solution.us).std(axis=0), solution.sigma_us, rtol=0.12)


@pytest.mark.parametrize("scheme", ["midpoint", "munthe_kaas"])
def test_a_floating_body_strays_along_its_tangent(scheme):
    given = {"lie": "munthe_kaas"} if scheme == "munthe_kaas" else {}
    problem = mbocp.Problem.create(
        mbocp.load_robot("hector", actuated=["root_joint"]),
        0.5,
        20,
        start={"q": [0.1, 0, 0.2, 0.1, -0.2, 0.1, 0.94**0.5], "v": [0.3, 0, 0, 0.1, 0.5, 0]},
        goal={"q": [0.4, 0.2, 0.3, 0, 0, 0, 1], "v": 0},
        cost={"effort": 0.1, "velocity": 1.0},
        integrator={"scheme": "rk4" if given else scheme, **given},
        robust={"start": {"q": 0.02, "v": 0.05}, "disturbance": {"tau": [0.1] * 3 + [0.005] * 3}},
    )
    solution = solved(problem)
    assert solution.sigma_qs.shape == (21, 6)
    q, v = simulate(problem, solution, 400, finer=2).away(problem, solution)
    np.testing.assert_allclose(q.std(axis=0), solution.sigma_qs, rtol=0.17)
    np.testing.assert_allclose(v.std(axis=0), solution.sigma_vs, rtol=0.17)


def test_a_heavier_cart_is_slower(tmp_path):
    path = tmp_path / "sliders.urdf"
    path.write_text(SLIDERS)
    cart = mbocp.load_robot(path, payload=[{**BALL, "frame": "cart"}])
    given = {"parameters": {"robot.payload.ball.mass": 0.1}, "feedback": "none"}
    solution = solved(cart_problem(cart, robust=given))
    slower = np.abs(solution.vs) * 0.1 / (MASS + BALL["mass"])
    np.testing.assert_allclose(solution.sigma_vs, slower, rtol=1e-7, atol=1e-12)


def test_a_cart_may_have_to_be_somewhere_on_its_way(cart):
    half = {"share": 0.5}
    path = [{"kind": "position", "frame": "cart", "x": [0.2, 0.2], "from": half, "until": half}]
    solution = solved(cart_problem(cart, robust={"start": {"q": 0.01}}, path=path))
    np.testing.assert_allclose(solution.qs[10], 0.2, atol=1e-9)
    assert solution.gains.shape == (20, 1, 2)


def test_masses_that_are_not_known_move_the_motion():
    robot = mbocp.load_robot("double_pendulum", payload=[BALL])
    word, sigma = "robot.payload.ball.mass", 0.002
    problem = pendulum(steps=48, robust={"parameters": {word: sigma}}).with_(robot=robot)
    solution = solved(problem)
    drawn = np.random.default_rng(3).standard_normal()
    q, v = simulate(problem, solution, 1, seed=3).away(problem, solution)
    for found, expected in ((q, solution.sigma_qs), (v, solution.sigma_vs)):
        size = expected.max()
        np.testing.assert_allclose(np.abs(found[0, :40]) / abs(drawn), expected[:40], atol=0.03 * size)
    assert solution.sigma_qs[24].min() > 1e-5


def slope(robot, state, tau):
    """Of (q, v) of a robot with loops, from its mass matrix and the derivative of its constraints."""
    (q, v), data = np.split(state, 2), robot.model.createData()
    M, bias = pin.crba(robot.model, data, q), pin.nonLinearEffects(robot.model, data, q, v)
    M = np.triu(M) + np.triu(M, 1).T
    J, size = robot.constraint_jacobian(q), 1e-6
    rates = [robot.constraint_jacobian(pin.integrate(robot.model, q, s * size * v)) @ v for s in (1, -1)]
    zeros = np.zeros((len(J), len(J)))
    forces = tau - bias - robot.model.damping * v
    right = np.concatenate([forces, -(rates[0] - rates[1]) / (2 * size)])
    return np.concatenate([v, np.linalg.solve(np.block([[M, J.T], [J, zeros]]), right)[: robot.nv]])


def test_closed_loops_stray_along_what_they_leave():
    path = EXAMPLES / "loops" / "four_bar.toml"
    size = 1e-4
    problem = mbocp.load_problem(path).with_(
        steps=60, robust={"start": {"q": {"crank": size}}, "feedback": "none"}
    )
    solution, robot = solved(problem), problem.robot
    covariances = Tubes.of(solution, problem.robust).tube.covariances
    for n in (0, 10, 20):
        J = robot.constraint_jacobian(solution.qs[n])
        assert np.abs(J @ covariances[n, :3, :3] @ J.T).max() < 1e-6 * np.abs(covariances[n, :3, :3]).max()
    # The same mechanism, started a little further along what its loop leaves, by other mechanics.
    basis = problem.free_at_end(solution.qs[0])
    move = basis @ basis.T @ np.array([size, 0.0, 0.0])
    ends = [followed(robot, solution, share * move, 20) for share in (-1.0, 1.0)]
    away = (ends[1] - ends[0]) / 2.0
    expected = np.concatenate([solution.sigma_qs[20], solution.sigma_vs[20]])
    np.testing.assert_allclose(np.abs(away), expected, rtol=0.02, atol=0.01 * expected.max())


def followed(robot, solution, move, steps):
    """State after some steps of the controls of a solution, from a start that is moved."""
    q, v, finer = solution.qs[0] + move, np.array(solution.vs[0]), 4
    while np.abs(robot.constraint_residual(q)).max() > 1e-14:
        q = q - np.linalg.pinv(robot.constraint_jacobian(q)) @ robot.constraint_residual(q)
    B, state = robot.actuation_matrix(q), np.concatenate([q, v])
    for u, length in zip(solution.us[:steps], np.diff(solution.t)[:steps], strict=True):
        for h in [length / finer] * finer:
            k1 = slope(robot, state, B @ u)
            k2 = slope(robot, state + h / 2 * k1, B @ u)
            k3 = slope(robot, state + h / 2 * k2, B @ u)
            k4 = slope(robot, state + h * k3, B @ u)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state


def test_limits_keep_off_and_the_next_motion_does_not_move():
    given = {"start": {"q": 0.005, "v": 0.01}, "disturbance": {"tau": 1e-4}}
    problem = pendulum(limits={"velocity": [0.42, 0.57], "effort": [0.7, 0.4]}, robust=given)
    solution, near = solved(problem), solved(problem.with_(robust=None))
    assert np.isnan(near.sigmas)
    assert np.abs(near.vs).max(axis=0) == pytest.approx([0.42, 0.57], abs=1e-6)
    room = problem.limits.v_upper - 2.0 * solution.sigma_vs - np.abs(solution.vs)
    assert -1e-4 < room[1:].min() < 1e-4  # active, and kept
    assert (problem.limits.u_upper - 2.0 * solution.sigma_us - np.abs(solution.us)).min() > -1e-4
    assert solution.cost > near.cost
    assert "velocity limit" in solution.tightest
    again = mbocp.solve(problem, warm_start=solution)
    np.testing.assert_allclose(again.vs, solution.vs, atol=2e-3)


def test_speeds_keep_off_within_coarse_steps(monkeypatch):
    given = {"start": {"q": 0.005, "v": 0.01}, "disturbance": {"tau": 1e-4}}
    problem = pendulum(steps=8, limits={"velocity": [0.45, 0.7]}, robust=given)

    def beyond():
        runs = simulate(problem, solved(problem), 100, finer=6).within
        return (np.abs(runs) > problem.limits.v_upper).any(axis=3).mean(axis=0).max()

    assert beyond() < 0.2  # at the worst place; 0.05 where steps are finer and better
    monkeypatch.setattr("mbocp.robust.can_hold_within", lambda _: "")
    assert beyond() > 0.8


def test_confidence_is_a_number_of_deviations_and_results_keep_tubes(tmp_path):
    problem = pendulum(limits={"velocity": [0.5, 0.85]})
    sure = problem.with_(robust={"confidence": 0.9772498680518208})
    assert sure.robust.sigmas == pytest.approx(2.0)
    solution = solved(sure)
    solution.save(tmp_path / "tubes.h5")
    found = mbocp.Solution.load(tmp_path / "tubes.h5")
    for name in ("sigma_qs", "sigma_vs", "sigma_us"):
        np.testing.assert_array_equal(getattr(found, name), getattr(solution, name))
    assert (found.sigmas, found.tightest) == (solution.sigmas, solution.tightest)
    np.testing.assert_array_equal(found.problem.robust.q, sure.robust.q)
    assert pickle.loads(pickle.dumps(sure)).robust.sigmas == sure.robust.sigmas
    assert found.problem.robust.sigmas == sure.robust.sigmas


def test_a_limit_without_room_is_refused():
    with pytest.raises(
        ProblemError, match=r"velocity limit of joint1 .* has no room: 40 standard deviations"
    ):
        solved(pendulum(limits={"velocity": [0.5, 0.85]}).with_(robust={"sigmas": 40.0}))


def test_room_that_leaves_no_motion_is_told():
    solution = mbocp.solve(pendulum(limits={"velocity": [5.0, 0.55]}))
    assert not solution.converged
    assert "limits that leave room for 2 standard deviations (velocity limit of joint2" in solution.advice


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"start": {"q": -0.1}}, r"robust\.start\.q.*>= 0"),
        ({"start": {"v": {"elbow": 0.1}}}, r"robust\.start\.v.*elbow"),
        ({"start": {"q": 0.1}, "sigmas": 0}, r"robust\.sigmas.*positive"),
        ({"start": {"q": 0.1}, "confidence": 0.4}, r"robust\.confidence.*0\.5 and 1"),
        ({"start": {"q": 0.1}, "confidence": 0.9, "sigmas": 2}, "give one of them"),
        ({"start": {"q": 0.1}, "feedback": "pd"}, r"robust\.feedback.*gains.*none"),
        ({"sigmas": 2}, "nothing uncertain"),
        ({"starts": {}}, "starts"),
    ],
)
def test_wrong_values_are_refused(given, words):
    with pytest.raises(MbocpError, match=words):
        pendulum(robust=given)


def test_what_has_no_tubes_is_refused():
    with pytest.raises(ProblemError, match=r"robust: states are not \(q, v\)"):
        pendulum("midpoint").with_(coordinates="natural")
    with pytest.raises(ProblemError, match='controls = "linear"'):
        pendulum().with_(controls="linear")
    with pytest.raises(InvalidValue, match=r"robust\.parameters.*ball.*no payload"):
        solved(pendulum(robust={"parameters": {"robot.payload.ball.mass": 0.1}}))
    with pytest.raises(InvalidValue, match=r"robust\.parameters.*cost\.effort"):
        solved(pendulum(robust={"parameters": {"cost.effort": 0.1}}))
    given = {"limits": {"effort_rate": 1e4}, "robust": {"parameters": {"robot.payload.ball.mass": 0.1}}}
    held = pendulum(**given).with_(robot=mbocp.load_robot("double_pendulum", payload=[BALL]))
    with pytest.raises(ProblemError, match="by itself it moves 'effort_rate of joint1 at the end'"):
        solved(held)
    with pytest.raises(SolverError, match="the solution is robust"):
        mbocp.sensitivities(solved(pendulum()), wrt=["start.q"])
    with pytest.raises(ProblemError, match="receding horizon: robust"):
        mbocp.RecedingHorizon(pendulum())


def test_many_problems_are_as_robust_as_one():
    problem = pendulum(limits={"velocity": [0.5, 0.85]}, steps=12)
    goals = np.array([[0.48, 0.08], [0.5, 0.1]])
    motions = mbocp.solve_many(problem, goals=goals)
    alone = solved(problem)
    np.testing.assert_allclose(motions.us[1], alone.us, atol=1e-9)


@pytest.mark.slow
def test_feet_stray_in_flight_and_stay_where_they_land():
    given = {"start": {"q": 3e-4, "v": 1e-3}, "disturbance": {"tau": 2e-4}}
    solution = solved(mbocp.load_problem(EXAMPLES / "legged" / "solo12_jump.toml").with_(robust=given))
    tubes, robot = Tubes.of(solution, solution.problem.robust), solution.problem.robot
    along = np.linalg.pinv(tangents(tubes.formulation, tubes.tube.xs))
    size = tubes.formulation.layout.nw
    spread = []
    for q, A, P in zip(solution.qs, along, tubes.tube.covariances[:, :size, :size], strict=True):
        J = frame_jacobian(robot.model, q, robot.frame_id("FL_FOOT"), pin.LOCAL_WORLD_ALIGNED)[:3] @ A
        spread.append(np.sqrt(np.diag(J @ P @ J.T)))
    takes_off, lands = (np.searchsorted(solution.t, end - 1e-9) for end in solution.phase_times["flight"])
    np.testing.assert_allclose(spread[:takes_off], spread[:1] * takes_off, rtol=1e-2)
    assert np.abs(spread[lands] / spread[0] - 1.0).min() > 0.1
    np.testing.assert_allclose(spread[lands + 2 :], spread[-1:] * (len(spread) - lands - 2), rtol=1e-2)


@pytest.mark.slow
def test_a_robust_arm_keeps_off_where_another_hits():
    near, robust = robust_table(100).rows
    assert float(near[3].rstrip(" %")) > 90.0
    assert float(robust[3].rstrip(" %")) < 12.0
    assert float(robust[1]) < 1.1 * float(near[1])

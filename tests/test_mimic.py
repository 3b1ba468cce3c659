"""Robots with mimic joints, from the problem to the solution and what is made of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.mechanics.motion_rates import accelerations
from mbocp.problem import Problem
from mbocp.problem.problem import problem_from_tables
from mbocp.robot import describe, load_robot
from mbocp.robot.kinematics import frame_jacobian
from mbocp.solution import Solution
from mbocp.view.plots import plot_solution
from mbocp.view.replay import write_replay
from tests.mechanics.mimics import HAND, Tied, tied
from tests.robot import urdfs
from tests.view.pages import read_page


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Tied:
    return tied("pair", tmp_path_factory.mktemp("pair"))


@pytest.fixture(scope="module")
def hand(tmp_path_factory: pytest.TempPathFactory) -> Tied:
    return tied("hand", tmp_path_factory.mktemp("hand"))


def problem(tied: Tied, *, steps: int = 20, **tables: Any) -> Problem:
    end = {name: 0.8 for name in tied.robot.joint_names if name not in tied.ties}
    document = {
        "robot": dict(tied.robot.spec),
        "horizon": {"duration": 0.8, "steps": steps},
        "goal": {"q": end, "v": [0.0] * tied.robot.nv},
        "integrator": {"scheme": "se1"},
    }
    return problem_from_tables({**document, **tables})


def solved(problem: Problem, **options: Any) -> Solution:
    solution = mbocp.solve(problem, **options)
    assert solution.converged, solution.advice
    return solution


def steps_of(scheme: str, tied: Tied, s: Solution) -> Array:
    """Defect of the momentum balance of each implicit step, on all joints tied together [N m]."""
    defects = []
    tau = {"se1": 1.0, "se2": 0.0, "midpoint": 0.5}[scheme]
    dt = s.t[1] - s.t[0]
    for n, u in enumerate(s.us):
        (q0, q1), (v0, v1) = s.qs[n : n + 2], s.vs[n : n + 2]
        v = (1 - tau) * v0 + tau * v1
        np.testing.assert_allclose(q1, q0 + dt * v, rtol=0, atol=1e-10)
        defects.append(tied.inverse_dynamics(q0 + tau * dt * v, v, (v1 - v0) / dt) - u)
    return np.array(defects)


def runge_kutta(tied: Tied, q: Array, v: Array, u: Array, dt: float) -> tuple[Array, Array]:
    """One classical step on all joints tied together."""

    def rate(x: Array) -> Array:
        return np.concatenate([x[len(q) :], tied.acceleration(x[: len(q)], x[len(q) :], u)])

    x = np.concatenate([q, v])
    k1 = rate(x)
    k2 = rate(x + dt / 2 * k1)
    k3 = rate(x + dt / 2 * k2)
    k4 = rate(x + dt * k3)
    x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x[: len(q)], x[len(q) :]


@pytest.mark.parametrize("scheme", ["se1", "se2", "midpoint"])
@pytest.mark.parametrize("name", ["pair", "hand"])
def test_implicit_steps_balance_the_tied_joints(
    scheme: str, name: str, request: pytest.FixtureRequest
) -> None:
    tied = request.getfixturevalue(name)
    s = solved(problem(tied, integrator={"scheme": scheme}))
    assert np.abs(steps_of(scheme, tied, s)).max() < 1e-8 * (1 + np.abs(s.us).max())
    np.testing.assert_allclose(s.ps, [tied.mass_matrix(q) @ v for q, v in zip(s.qs, s.vs, strict=True)])
    assert np.isfinite(s.mus).all()


@pytest.mark.parametrize("lie", ["plain", "munthe_kaas"])
def test_explicit_steps_follow_the_tied_joints(pair: Tied, lie: str) -> None:
    s = solved(problem(pair, integrator={"scheme": "rk4", "lie": lie}))
    for n, u in enumerate(s.us):
        q, v = runge_kutta(pair, s.qs[n], s.vs[n], u, s.t[1])
        np.testing.assert_allclose(np.r_[s.qs[n + 1], s.vs[n + 1]], np.r_[q, v], rtol=0, atol=1e-9)


@pytest.mark.parametrize("scheme", ["se1", "midpoint"])
def test_natural_coordinates_tend_to_the_same_optimum(pair: Tied, scheme: str) -> None:
    gaps = []
    for steps in (20, 80):
        options: dict[str, Any] = {"steps": steps, "integrator": {"scheme": scheme}}
        joint, natural = (solved(problem(pair, coordinates=c, **options)) for c in ("joint", "natural"))
        assert natural.constraint_violation < 1e-9
        gaps.append(np.abs(joint.qs - natural.qs).max())
    assert gaps[1] < gaps[0] / 3.0, gaps


@pytest.mark.parametrize("solver", ["fbsm_newton", "fbsm_bb+monolithic", "ipopt", "fatrop"])
def test_solvers_agree(pair: Tied, solver: str) -> None:
    expected, found = solved(problem(pair), solver="monolithic"), solved(problem(pair), solver=solver)
    assert found.cost == pytest.approx(expected.cost, rel=1e-9)


def speed(tied: Tied, q: Array, v: Array, frame: str) -> float:
    """Speed of a frame's origin, from all joints tied together [m/s]."""
    model, number = tied.full.model, tied.full.frame_id(frame)
    jacobian = frame_jacobian(model, tied.configuration(q), number, pin.LOCAL_WORLD_ALIGNED)
    return float(np.linalg.norm(jacobian[:3] @ tied.G @ v))


def test_limits_and_path_constraints(hand: Tied) -> None:
    """The tip of a finger that follows keeps below its speed, the leader within its own."""
    free = solved(problem(hand, cost={"velocity": 0.1}))
    fastest = max(speed(hand, q, v, "t2") for q, v in zip(free.qs, free.vs, strict=True))
    limits = {"velocity": {"knuckle": 0.9 * float(np.abs(free.vs[:, 2]).max())}}
    path = [{"kind": "speed", "frame": "t2", "max": 0.9 * fastest}]
    s = solved(problem(hand, cost={"velocity": 0.1}, limits=limits, path=path))
    speeds = [speed(hand, q, v, "t2") for q, v in zip(s.qs, s.vs, strict=True)]
    assert max(speeds) == pytest.approx(0.9 * fastest, rel=1e-6)
    assert np.abs(s.vs[:, 2]).max() <= limits["velocity"]["knuckle"] + 1e-7
    assert s.cost > free.cost


def test_speeds_are_looked_at_between_nodes(hand: Tied) -> None:
    """With `"gauss2"` they are followed along the flow, which takes accelerations of the tied joints."""
    limits = {"velocity": {"knuckle": 1.2}}
    s = solved(
        problem(hand, steps=10, cost={"velocity": 0.1}, integrator={"scheme": "gauss2"}, limits=limits)
    )
    assert s.limit_excess < 0.05
    found = accelerations(hand.robot, s.qs[:-1], s.vs[:-1], s.us)
    expected = [hand.acceleration(q, v, u) for q, v, u in zip(s.qs, s.vs, s.us, strict=False)]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


def test_the_adjoint_is_the_price_of_the_start(pair: Tied) -> None:
    """mu_q at the start, at rest, is the derivative of the optimal cost."""

    def at(shift: float) -> Solution:
        return solved(problem(pair, start={"q": [shift]}, integrator={"scheme": "midpoint"}))

    h = 1e-4
    slope = (at(h).cost - at(-h).cost) / (2 * h)
    assert at(0.0).mus[0, 0] == pytest.approx(slope, rel=1e-5)


def test_drives_of_a_leader(tmp_path: Path) -> None:
    """The leader is driven; what it drags along weighs on what is free."""
    tied_hand = tied("hand", tmp_path)
    toml = '[[drive]]\njoint = "arm_joint"\ncontrol = "acceleration"\n'
    robot = load_robot(urdfs.write(tmp_path, HAND, toml))
    mechanics = ForwardMechanics(robot)
    symbols = [ca.SX.sym("q", 3), ca.SX.sym("s", 3), ca.SX.sym("u", robot.nu)]
    rate = ca.Function("f", symbols, [mechanics.speed_rate(*symbols, ca.SX(0.0))])
    rng = np.random.default_rng(4)
    q, v, u = rng.uniform(-1, 1, 3), rng.standard_normal(3), rng.standard_normal(3)
    speeds = robot.speeds(q, v)
    a = np.empty(3)  # speeds: the free components in order, then the driven one
    a[[1, 2, 0]] = np.array(rate(q, speeds, u)).ravel()
    left = tied_hand.inverse_dynamics(q, v, a) - robot.actuation_matrix(q) @ u
    np.testing.assert_allclose(left[1:], 0.0, atol=1e-11)
    np.testing.assert_allclose(robot.drive_forces(q, v, a, u), left[:1], atol=1e-11)


def test_files_replay_and_description(hand: Tied, tmp_path: Path) -> None:
    s = solved(problem(hand))
    again = Solution.load(s.save(tmp_path / "hand.h5"))
    np.testing.assert_array_equal(again.mus, s.mus)
    page = read_page(write_replay(hand.robot, s.t, s.qs, tmp_path / "hand.html"))
    model, data = hand.full.model, hand.full.model.createData()
    pin.forwardKinematics(model, data, hand.configuration(s.qs[-1]))
    for name in hand.robot.joint_names:
        times, positions = page.tracks()[f"/replay/world/robot/{name}", "position"]
        assert times[-1] == pytest.approx(s.t[-1])
        np.testing.assert_allclose(positions[-1], data.oMi[model.getJointId(name)].translation, atol=1e-5)
    told = {joint["name"]: joint for joint in describe(hand.robot)["joints"]}
    assert told["tip2"]["type"] == "mimic"


@pytest.mark.slow
def test_panda_with_its_hand(tmp_path: Path) -> None:
    """The URDF as a file: the second finger mimics the first."""
    source = load_robot("panda").source
    assert source is not None
    robot = load_robot(source)
    assert (robot.nv, robot.nu, len(robot.joint_names)) == (8, 8, 9)
    goal = [0.5, -0.3, 0.2, -1.8, 0.1, 1.6, 0.3, 0.03]
    document = {
        "robot": str(source),
        "horizon": {"duration": 1.0, "steps": 40},
        "start": {"q": [0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0, 0.0]},
        "goal": {"q": goal, "v": [0.0] * 8},
        "cost": {"velocity": 1.0},
        "integrator": {"scheme": "se1"},
    }
    s = solved(problem_from_tables(document))
    np.testing.assert_allclose(s.q_final, goal, atol=1e-9)
    assert np.isfinite(s.mus).all()
    assert plot_solution(s, tmp_path / "panda.png", robot).stat().st_size > 10_000

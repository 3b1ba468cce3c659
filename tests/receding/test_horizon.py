"""A horizon that moves on: its steps, its limits, its deadline, and what it says of itself."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from benchmarks.receding_horizon import _cases, loop_times
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem import Bounds, Problem
from mbocp.programme.compiler import compiler
from mbocp.programme.kernel import kernel_programme
from mbocp.receding import RecedingHorizon
from mbocp.robot import load_robot
from mbocp.terms import running_cost

HERE = Path(__file__).parent
EXAMPLES = HERE.parents[1] / "examples"
FOLLOW = EXAMPLES / "receding" / "ur5_follow.toml"
PERIOD = 4e-3  # [s] of the closed loop
TIGHT = 1e-8  # part of the cost for the barrier, where optima are compared


@pytest.fixture(scope="module")
def problem() -> Problem:
    return mbocp.load_problem(FOLLOW)


@pytest.fixture
def horizon(problem: Problem) -> RecedingHorizon:
    return RecedingHorizon(problem)


def elsewhere(problem: Problem, seed: int, size: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    robot = problem.robot
    moved = robot.integrate(problem.q_start, size * rng.standard_normal(robot.nv))
    return moved, size * rng.standard_normal(robot.nv)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_state_that_stays_leads_to_its_optimum(problem, seed):
    q, v = elsewhere(problem, seed)
    goal = problem.q_start + np.random.default_rng(seed).uniform(-0.8, 0.8, 6)
    horizon = RecedingHorizon(problem, iterations=5, barrier=TIGHT)
    for _ in range(40):
        found = horizon.step(q, v, goal=goal, target=goal, dt=0.0)
        if found.status.state == "converged":
            break
    assert found.status.state == "converged"
    assert repr(found) == f"<HorizonStep converged: {found.status.words}>"
    cost = replace(problem.cost, target_q=goal)
    cold = mbocp.solve(
        problem.with_(q_start=q, v_start=v, cost=cost, goal=replace(problem.goal, q=goal)), check=True
    )
    np.testing.assert_allclose(found.q, cold.qs, atol=1e-5)
    np.testing.assert_allclose(found.us, cold.us, atol=1e-3 * np.abs(cold.us).max())


def test_gains_reach_an_exact_goal():
    """As controls of optima that are solved again do: they were 15 % off."""
    problem = mbocp.load_problem(EXAMPLES / "optima" / "cart_pole.toml").with_(steps=30)
    horizon = RecedingHorizon(problem, iterations=6)

    def first(dx: np.ndarray) -> mbocp.receding.HorizonStep:
        state = np.split(np.concatenate([problem.q_start, problem.v_start]) + dx, 2)
        while horizon.step(*state, dt=0.0).status.state != "converged":
            pass
        return horizon.step(*state, dt=0.0)  # with the factors of the optimum

    K, by = np.array(first(np.zeros(4)).K), 1e-4
    pairs = [(first(move).u.copy(), first(-move).u.copy()) for move in by * np.eye(4)]
    differences = np.array([(after - before) / (2 * by) for after, before in pairs]).T
    np.testing.assert_allclose(K, differences, atol=1e-3 * np.abs(K).max())


@pytest.mark.parametrize("iterations", [1, 2])
def test_a_closed_loop_keeps_limits_and_follows(problem, iterations):
    """Of 0.8 s, with noise, a goal that jumps by two radians and then moves, and torques at their limits."""
    horizon = RecedingHorizon(problem, iterations=iterations)
    model, rng = problem.robot.model, np.random.default_rng(5)
    data = model.createData()
    lower, upper = (side[0] for side in problem.limits_along()["u"])
    q, v = np.array(problem.q_start), np.array(problem.v_start)
    nearest = math.inf
    for k in range(round(0.8 / PERIOD)):
        goal = np.array([2.2, -0.7, 1.5, -2.3, -1.57, 0.8]) + 0.1 * np.sin(2.0 * k * PERIOD)
        measured = (q + 1e-4 * rng.standard_normal(6), v + 2e-3 * rng.standard_normal(6))
        found = horizon.step(*measured, goal=goal, target=goal, dt=PERIOD)
        assert found.status.state in ("improved", "converged"), found.status
        assert (found.us >= lower).all()
        assert (found.us <= upper).all()
        nearest = min(nearest, float(np.min(upper - np.abs(found.us[0]))))
        for _ in range(4):
            v = v + 1e-3 * pin.aba(model, data, q, v, found.u)
            q = pin.integrate(model, q, 1e-3 * v)
    assert nearest < 0.5, "no torque has come near its limit"
    assert np.abs(q - goal).max() < 0.02


@pytest.mark.slow
def test_a_far_goal_leaves_no_step_without_a_direction():
    """At its torque limits the Panda's Hessian is indefinite with every shift that is tried."""
    _, states, _ = loop_times(_cases()["Panda, N = 30"], steps=20, iterations=1)
    assert set(states) <= {"improved", "converged"}


def test_it_goes_by_the_steps_of_the_solver(problem):
    """The same bits as evaluate, factorise, solve and a full step of the kernel without limits."""
    free = problem.with_(limits=Bounds())
    horizon = RecedingHorizon(free)
    programme = horizon._formulation.programme
    q, v = elsewhere(free, 1, size=0.01)
    own, other = horizon._programme, kernel_programme(programme)
    for name in ("x", "y", "u", "m", "eta"):
        setattr(other, name, getattr(own, name))
    x = other.x
    x[:12] = np.concatenate([q, v])
    other.x = x
    other.evaluate()
    other.factorise(0.0, 0.0)
    direction = other.solve()
    other.move(1.0)
    other.accept(1.0)
    found = horizon.step(q, v, dt=0.0)
    assert found.status.step_length == 1.0
    assert found.status.increment == direction.increment
    np.testing.assert_array_equal(found.us.ravel(), other.u)
    np.testing.assert_array_equal(own.m, other.m)
    other_gains = other.gains()
    np.testing.assert_array_equal(horizon._native.gains.ravel(), other_gains)


@pytest.mark.parametrize("effort", [math.inf, 100.0])
def test_gains_answer_as_the_optimum_does(problem, effort):
    """To a small move of the state, with the first control: without limits, and with torques at theirs."""
    limits = Bounds(u_lower=np.full(6, -effort), u_upper=np.full(6, effort))
    horizon = RecedingHorizon(problem.with_(limits=limits), iterations=30, barrier=TIGHT, tolerance=1e-9)
    q, v = np.array(problem.q_start), np.array(problem.v_start)
    horizon.step(q, v, dt=0.0)
    before = horizon.step(q, v, dt=0.0)
    u, K = np.array(before.u), np.array(before.K)
    rng, size = np.random.default_rng(0), 1e-5
    for _ in range(3):
        dx = size * rng.standard_normal(12)
        after = horizon.step(q + dx[:6], v + dx[6:], dt=0.0)
        np.testing.assert_allclose(after.u - u, K @ dx, atol=1e-3 * np.abs(K @ dx).max())


@pytest.mark.parametrize("steps", [0.0, 1.0, 2.0, 0.25, 1.5, 29.0, 100.0])
def test_a_shift_is_that_of_time(horizon, steps):
    """Without a Newton step the prediction is the one before, between its nodes, and stays at its end."""
    old, old_us = np.array(horizon.first.q), np.array(horizon.first.us)
    nodes = np.clip(np.arange(31) + steps, 0, 30)
    knots = np.clip(np.arange(30) + steps, 0, 29)
    expected = np.array([np.interp(nodes, np.arange(31), column) for column in old.T]).T
    expected_us = np.array([np.interp(knots, np.arange(30), column) for column in old_us.T]).T
    found = horizon.step(expected[0], np.zeros(6), dt=steps * horizon.problem.dt, iterations=0)
    assert (found.status.iterations, found.status.state) == (0, "moved_on")
    np.testing.assert_allclose(found.q, expected, atol=1e-12)
    np.testing.assert_allclose(found.us, expected_us, atol=1e-9)


def closed_loop(problem: Problem, share: float, *, is_for_period: bool = True) -> tuple[float, int]:
    """Cost and Newton steps of 0.8 s with a push amid them, at a period of a share of the horizon's steps."""
    horizon, robot, rng = RecedingHorizon(problem), problem.robot, np.random.default_rng(0)
    data, period, dt = robot.model.createData(), share * problem.dt, 1e-3
    q = problem.q_start + 0.1 * rng.standard_normal(6)
    v, cost, iterations = 0.5 * rng.standard_normal(6), 0.0, 0
    for k in range(round(0.8 / period)):
        found = horizon.step(q, v, dt=period if k else 0.0)
        assert found.status.state in ("improved", "converged"), found.status
        iterations += found.status.iterations
        u = horizon.control_for(period) if is_for_period else np.array(found.u)
        if abs(k * period - 0.4) < period / 2:
            v = v + 0.5 * rng.standard_normal(6)
        for _ in range(round(period / dt)):
            off = q - problem.goal.q
            cost += dt / 2.0 * (1e-3 * u @ u + v @ v + 1e3 * off @ off)
            v = v + dt * pin.aba(robot.model, data, q, v, u)
            q = q + dt * v
    return cost, iterations


@pytest.mark.parametrize("scheme", ["se1", "gauss2"])
def test_a_period_may_be_a_part_of_a_step(problem, scheme):
    """With one Newton step each it costs no more; the control of a whole step would come early."""
    one = problem.with_(scheme=scheme)
    (whole, few), (part, many) = closed_loop(one, 1.0), closed_loop(one, 0.2)
    assert many == 5 * few
    assert part < 1.001 * whole
    early, _ = closed_loop(one, 0.2, is_for_period=False)
    assert early > 1.004 * part


def test_a_control_for_a_period_is_within_limits_and_that_of_a_step_in_the_end(horizon):
    us, dt = np.array(horizon.first.us), horizon.problem.dt
    np.testing.assert_array_equal(horizon.control_for(dt), us[0])
    np.testing.assert_array_equal(horizon.control_for(9.0), us[0])
    upper = horizon.problem.limits.u_upper
    expected = np.clip(us[0] - 0.4 * (us[1] - us[0]), -upper, upper)
    np.testing.assert_allclose(horizon.control_for(0.2 * dt), expected, rtol=1e-12)
    with pytest.raises(InvalidValue, match="period: got 0, expected a time above 0"):
        horizon.control_for(0)


def sways(at):
    return ca.sumsqr(at.q - 0.3 * ca.sin(4.0 * (at.t + at["start"])))


@pytest.mark.parametrize("moves", ["target", "term"])
def test_what_belongs_to_times_moves_by_parts_of_a_step(moves):
    """After a step and three tenths the optimum is that of a problem that begins there."""
    N, states = 10, {"q": [0.2, -0.1], "v": [0.3, 0.1]}
    targets = np.linspace(0.0, 1.0, N)[:, None] * [1.0, 0.5]
    numbers = np.arange(N)
    at = np.minimum(numbers + 1.3, N - 1)
    later = np.array([np.interp(at, numbers, column) for column in targets.T]).T

    def made(target, start):
        cost = {"effort": 1.0, "tracking": 1.0, "tracking_weights": {"q": 10.0}, "target": {"q": target}}
        own = running_cost(sways, weight=5.0, name="sways", start=start)
        terms = [own] if moves == "term" else []
        return Problem.create("double_pendulum", 0.5, N, start=states, cost=cost, terms=terms)

    begins = ((targets.tolist(), 0.0), (later.tolist(), 1.3 * 0.5 / N))
    moving, then = (made(rows if moves == "target" else [0.0, 0.0], start) for rows, start in begins)
    horizon = RecedingHorizon(moving, iterations=30, tolerance=1e-9)
    for share in (0.3, 1.0, 0.0):
        found = horizon.step(states["q"], states["v"], dt=share * moving.dt)
    np.testing.assert_allclose(found.q, mbocp.solve(then, check=True).qs, atol=1e-7)
    with pytest.raises(ProblemError, match="a target is a trajectory, or a term depends on the time itself"):
        horizon.save("nowhere")


def test_no_time_is_no_step_but_a_motion(horizon):
    q, v = horizon.problem.q_start, horizon.problem.v_start
    found = horizon.step(q, v, time_limit=0.0)
    assert found.status.state == "out_of_time"
    assert found.status.iterations == 0
    assert not found.status.is_good
    assert np.isfinite(found.us).all()


def test_a_deadline_ends_the_steps(problem):
    """A thousand steps take longer than ten of them; one that is under way is not broken off."""
    horizon = RecedingHorizon(problem, tolerance=0.0)
    q, v = elsewhere(problem, 4)
    one = max(horizon.step(q, v, dt=0.0).status.seconds for _ in range(10))
    found = horizon.step(q, v, dt=0.0, iterations=1000, time_limit=1e7 * one)
    assert found.status.state == "out_of_time"
    assert 0 < found.status.iterations < 1000


GOOD = np.zeros(6)
BAD_INPUTS = {
    "q: got shape (5,), expected (6,)": {"q": np.zeros(5)},
    "v: got shape (2, 3), expected (6,)": {"v": np.zeros((2, 3))},
    "q: not finite": {"q": np.full(6, math.nan)},
    "v: not an array of numbers": {"v": "fast"},
    "dt: got -1.0, expected a time >= 0 [s]": {"dt": -1.0},
    "dt: got soon, expected a time >= 0 [s]": {"dt": "soon"},
    "time_limit: got nan": {"time_limit": math.nan},
    "iterations: got 1000000000000, expected a whole number of at least 0": {"iterations": 10**12},
    "iterations: got -3, expected a whole number of at least 0": {"iterations": -3},
    "goal.q: got shape (3,), expected (6,)": {"goal": np.zeros(3)},
    "goal.q: got [inf": {"goal": np.full(6, math.inf)},
    "goal: no 'qq' in that of the problem": {"goal": {"qq": GOOD}},
    "target.q: got shape (3, 6), expected (30, 6)": {"target": np.zeros((3, 6))},
    "target.p: the cost of the problem does not track it": {"target": {"p": GOOD}},
    "weights: the term 'potential' had no weight": {"weights": {"potential": 1.0}},
    "cost.effort": {"weights": {"effort": -1.0}},
}


@pytest.mark.parametrize("words", BAD_INPUTS)
def test_what_cannot_be_is_said_and_not_raised(horizon, words):
    given = {"q": horizon.problem.q_start, "v": GOOD, **BAD_INPUTS[words]}
    found = horizon.step(given.pop("q"), given.pop("v"), **given)
    assert found.status.state == "bad_input"
    assert words in found.status.words
    assert np.isfinite(found.us).all()
    again = horizon.step(horizon.problem.q_start, GOOD, goal=horizon.problem.q_start)
    assert again.status.is_good


def test_a_state_far_from_all_does_no_lasting_harm(horizon):
    horizon.step(np.full(6, 1e200), np.full(6, 1e200))
    q, v = horizon.problem.q_start, horizon.problem.v_start
    for _ in range(60):
        found = horizon.step(q, v, dt=0.0, iterations=3)
    assert found.status.state == "converged"


def test_weights_change_the_motion_as_in_a_problem(problem):
    q, v = elsewhere(problem, 2)
    horizon = RecedingHorizon(problem, iterations=5, barrier=TIGHT)
    for _ in range(20):
        found = horizon.step(q, v, dt=0.0, weights={"velocity": 50.0})
    assert found.status.state == "converged"
    heavier = replace(problem.cost, velocity=np.full(6, 50.0))
    cold = mbocp.solve(problem.with_(q_start=q, v_start=v, cost=heavier), check=True)
    np.testing.assert_allclose(found.q, cold.qs, atol=1e-5)


def test_another_payload_from_now_on(problem):
    """The optimum of a heavier robot, by functions that were compiled for a lighter one."""
    light = load_robot("ur5", payload=[{"frame": "tool0", "mass": 0.0}])
    heavy = load_robot("ur5", payload=[{"frame": "tool0", "mass": 2.0, "com": [0.0, 0.1, 0.1]}])
    q, v = problem.q_start, problem.v_start
    horizon = RecedingHorizon(problem.with_(robot=light), iterations=5, barrier=TIGHT)
    before = horizon.step(q, v, dt=0.0).us.copy()
    for _ in range(20):
        found = horizon.step(q, v, dt=0.0, robot=heavy)
    assert found.status.state == "converged"
    cold = mbocp.solve(problem.with_(robot=heavy, q_start=q, v_start=v), check=True)
    np.testing.assert_allclose(found.q, cold.qs, atol=1e-5)
    np.testing.assert_allclose(found.us, cold.us, atol=1e-3 * np.abs(cold.us).max())
    assert np.abs(found.us - before).max() > 1.0
    for wrong in (load_robot("ur5"), "ur5"):
        refused = horizon.step(q, v, dt=0.0, robot=wrong)
        assert refused.status.state == "bad_input"
        assert "robot: " in refused.status.words


@pytest.mark.skipif(sys.platform != "linux", reason="LD_PRELOAD and the counter are for Linux")
def test_nothing_is_allocated(tmp_path):
    """Neither by the kernel nor, beyond Python's own pools, by Python."""
    counter = tmp_path / "allocations.so"
    cc = compiler()
    if cc is None:
        pytest.skip("no C compiler")
    command = [*cc, "-shared", "-fPIC", "-O1", "-o", counter, HERE / "allocations.c", "-ldl"]
    subprocess.run(command, check=True)
    found = subprocess.run(
        [sys.executable, HERE / "count.py", FOLLOW],
        env={**os.environ, "LD_PRELOAD": str(counter)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == ["0", "0"]


KINDS = {
    "free_flyer/drone_flip.toml": {},
    "loops/four_bar.toml": {},
    "arms/reach_pose.toml": {},
    "arms/ur5_reach.toml": {},
    "arms/via_points.toml": {},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
def test_other_robots_and_goals_begin_at_their_optimum_and_go_on(name):
    problem = mbocp.load_problem(EXAMPLES / name).with_(**KINDS[name])
    cold = mbocp.solve(problem, check=True)
    horizon = RecedingHorizon(problem, barrier=TIGHT, warm_start=cold, iterations=3)
    found = horizon.step(problem.q_start, problem.v_start, dt=0.0)
    assert found.status.state == "converged"
    np.testing.assert_allclose(found.q, cold.qs, atol=1e-5)
    for _ in range(5):
        found = horizon.step(np.array(found.q[1]), np.array(found.v[1]), iterations=5)
        assert found.status.is_good, found.status
    assert found.status.violation < 1e-2


@pytest.mark.slow
def test_goals_of_frames_move():
    problem = mbocp.load_problem(EXAMPLES / "arms/reach_pose.toml")
    horizon = RecedingHorizon(problem, iterations=10)
    name = problem.goal.frames[0].name
    robot, place = problem.robot, np.array(problem.goal.frames[0].target.position)
    for _ in range(10):
        place = place + np.array([0.005, -0.005, 0.0])
        found = horizon.step(problem.q_start, problem.v_start, dt=0.0, goal={name: place})
    assert found.status.state == "converged"
    np.testing.assert_allclose(robot.frame_placement(name, found.q[-1]).translation, place, atol=1e-6)
    assert "expected (4, 4)" in horizon.step(found.q[0], found.v[0], goal={name: [0.0]}).status.words


def test_goals_of_frames_move_with_their_tolerances():
    rpy, place = (3.1, 0.0, 0.0), np.array([0.45, 0.25, 0.35])
    frame = {"name": "tool0", "position": [0.4, 0.2, 0.3], "rpy": rpy}
    allowed = {"position_tolerance": 0.02, "orientation_tolerance": 0.05}
    problem = mbocp.Problem.create(
        mbocp.load_robot("ur5"),
        1.0,
        10,
        start={"q": [0, -1.57, 1.57, -1.57, -1.57, 0]},
        goal={"v": 0, "frame": frame | allowed},
        cost={"velocity": 100.0},
    )
    horizon, pose = RecedingHorizon(problem, iterations=10, barrier=1e-5), np.eye(4)
    pose[:3, 3], pose[:3, :3] = place, pin.rpy.rpyToMatrix(3.1, 0.0, 0.4)
    for _ in range(5):
        found = horizon.step(problem.q_start, problem.v_start, dt=0.0, goal={"tool0": pose})
    assert found.status.state == "converged"
    reached = problem.robot.frame_placement("tool0", found.q[-1])
    assert np.abs(reached.translation - place).max() < 0.0201
    assert np.linalg.norm(pin.log3(pose[:3, :3].T @ reached.rotation)) < 0.0501


def test_goals_that_leap_among_limits_are_followed_for_ever():
    """Limits in whose way one goal has been do not keep a horizon from all that come after."""
    q0, rng = [0.0, -1.2, 1.4, -1.7, -1.57, 0.0], np.random.default_rng(5)
    place = np.array([0.45, 0.25, 0.45])
    frame = {"name": "tool0", "position": place, "position_tolerance": 0.01}
    cost = {"effort": 1e-3, "velocity": 1.0}
    problem = Problem.create(
        "ur5", 0.5, 20, start={"q": q0}, goal={"frame": frame, "v": 0}, cost=cost, limits={"effort": True}
    )
    horizon = RecedingHorizon(problem, iterations=60)
    for _ in range(40):
        q, goal = np.array(q0) + rng.normal(scale=0.02, size=6), place + rng.uniform(-0.1, 0.1, 3)
        found = horizon.step(q, np.zeros(6), goal={"tool0": goal}, dt=0.0)
        assert found.status.state == "converged"
        reached = problem.robot.frame_placement("tool0", found.q[-1]).translation
        assert np.abs(reached - goal).max() < 0.0101


def test_poses_that_no_goal_asks_for_are_told():
    frame = {"name": "tool0", "axis": [0, 0, 1], "direction": [0, 0, -1], "orientation_tolerance": 0.1}
    problem = mbocp.load_problem(EXAMPLES / "arms/ur5_reach.toml", ["horizon.steps=10"])
    horizon = RecedingHorizon(problem.with_(goal={"v": 0, "frame": frame}), barrier=1e-5)
    step = horizon.step(problem.q_start, problem.v_start, goal={"tool0": [0.4, 0.2, 0.3]})
    assert "goal.tool0: the goal of the problem asks for none of this" in step.status.words


REFUSED = {
    "arms/minimum_time.toml": "horizon.duration",
    "arms/follow_path.toml": "horizon.duration",
    "walking/compass_gait.toml": "horizon.duration|phase",
    "free_flyer/round_trip.toml": "goal.periodic|via|start.free",
}


@pytest.mark.parametrize("iterations", [0, -3, 10**12])
def test_iterations_of_a_horizon_are_at_least_one(problem, iterations):
    with pytest.raises(InvalidValue, match=f"iterations: got {iterations}, expected a whole number of at"):
        RecedingHorizon(problem, iterations=iterations)


@pytest.mark.parametrize("name", REFUSED)
def test_what_belongs_to_given_times_is_refused(name):
    with pytest.raises(ProblemError, match=f"receding horizon: .*({REFUSED[name]})"):
        RecedingHorizon(EXAMPLES / name)

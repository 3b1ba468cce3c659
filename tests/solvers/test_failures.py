"""What cannot be solved: every method says so, with finite numbers, and never claims to have converged."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.problem import Problem
from mbocp.solution import Solution, Status

EXAMPLES = Path(__file__).parents[2] / "examples" / "paper"
METHODS = ("monolithic", "fbsm_newton", "fbsm_bb", "fbsm_bb+monolithic", "fbsm_bb+fbsm_newton")
SWEEPING = ("fbsm_newton", "fbsm_bb", "fbsm_bb+fbsm_newton")
SYSTEMS = (("cart_pendulum_rigid", 20), ("cart_pendulum_elastic", 20), ("elastic_pendulum", 10))


def load(name: str, *options: str) -> Problem:
    return mbocp.load_problem(EXAMPLES / f"{name}.toml", options)


def check_honest(s: Solution) -> None:
    """Finite numbers throughout; a status that fits them; advice."""
    for name in ("qs", "vs", "ps", "us", "lams", "mus", "zetas", "eta", "control_momenta"):
        assert np.isfinite(getattr(s, name)).all(), name
    assert math.isfinite(s.residual)
    assert math.isfinite(s.cost)
    assert s.status is not Status.SWITCHED
    if s.converged:
        assert s.residual <= 1e-9
    assert s.advice
    for word in ("nan", "inf)"):
        assert word not in s.advice
    json.loads(s.to_json(), parse_constant=lambda name: pytest.fail(name))


@pytest.mark.parametrize(("name", "steps"), SYSTEMS)
def test_a_sweep_that_cannot_be_done_names_the_time(name: str, steps: int) -> None:
    """From the middle on the controls are so large that no step can be solved."""
    problem = load(name, f"horizon.steps={steps}", "solver.max_iterations=500")  # so no other guess follows
    best = mbocp.solve(problem)
    us = best.us.copy()
    us[steps // 2 :] = 1e9
    start = dataclasses.replace(best, us=us)
    for method in SWEEPING:
        s = mbocp.solve(problem, solver=method, warm_start=start)
        check_honest(s)
        assert s.status is Status.SWEEP_FAILED, method
        (when,) = re.findall(r"the forward sweep fails in the step to t = ([\d.]+) s", s.advice)
        assert problem.duration / 2 < float(when) < problem.duration
        assert s.iterations == 0
        assert np.array_equal(s.us, us)  # what was given is what comes back
        assert '"monolithic", which needs no sweep' in s.advice
    for method in ("fbsm_bb+monolithic", "auto"):  # which is so
        s = mbocp.solve(problem, solver=method, warm_start=start)
        check_honest(s)
        assert s.converged
        assert s.cost == pytest.approx(best.cost, rel=1e-9)
        assert method == "auto" or "fbsm_bb ended as sweep_failed" in s.advice


@pytest.mark.parametrize(
    ("name", "option"),
    [
        ("cart_pendulum_rigid", "guess.u=[1e6]"),
        ("cart_pendulum_elastic", "guess.u=[1e6]"),
        ("cart_pendulum_elastic", "horizon.duration=2000.0"),
    ],
)
@pytest.mark.parametrize("method", [*METHODS, "auto"])
def test_a_guess_that_cannot_be_simulated_names_the_time(name: str, option: str, method: str) -> None:
    with pytest.raises(ProblemError, match=r"forward simulation .* in the step to t = [\d.]+ s"):
        mbocp.solve(load(name, "horizon.steps=10", option), solver=method)


@pytest.mark.parametrize("method", [*METHODS, "auto"])
@pytest.mark.parametrize("name", ["rigid_pendulum", "cart_pendulum_elastic"])
def test_one_iteration(name: str, method: str) -> None:
    s = mbocp.solve(load(name, "horizon.steps=10", "solver.max_iterations=1"), solver=method)
    check_honest(s)
    assert s.status is Status.MAX_ITERATIONS
    assert "not converged in 1 iteration (" in s.advice
    assert "raise solver.max_iterations" in s.advice
    steps = [r for r in s.history if not r.is_guess]
    assert 1 <= s.iterations == len(steps) <= 1 + ("+" in method)  # a phase has so many each
    assert s.residual <= min(r.residual for r in s.history if r.phase == s.history[-1].phase)


@pytest.mark.parametrize("method", [*METHODS, "auto"])
def test_a_goal_out_of_reach(method: str) -> None:
    """No solver finds in fifty iterations how the bob is 250 m away, beside the cart, 0.5 ms later.

    The gradient method does, whose iterations are many small ones, and what follows it; not in fifteen.
    """
    goal = ('goal={q=[250, 250.5, 1], enforce="exact"}', "cost.target={q=[0, 0, 2]}")
    problem = load("cart_pendulum_rigid", "horizon.steps=10", "horizon.duration=5e-4", *goal)
    options = dataclasses.replace(problem.solver, max_iterations=15 if "fbsm_bb" in method else 50)
    s = mbocp.solve(problem.with_(solver=options), solver=method)
    check_honest(s)
    assert s.status in (Status.LINE_SEARCH_FAILED, Status.MAX_ITERATIONS, Status.STAGNATED, Status.SINGULAR)
    assert "end condition" in s.advice
    assert s.residual > 1.0


def test_auto_does_not_end_as_switched_when_the_gradient_phase_spends_the_last_iterations() -> None:
    """Forty iterations until Newton's method is given up, 25 gradient steps, and no more are allowed."""
    problem = load("cart_pendulum_elastic", "horizon.steps=200", 'solver.globalisation="none"')
    for limit in (64, 65, 66):
        options = dataclasses.replace(problem.solver, max_iterations=limit)
        s = mbocp.solve(problem.with_(solver=options), solver="auto")
        check_honest(s)
        assert s.status is Status.MAX_ITERATIONS
        assert s.iterations == limit


# By hand, for a particle of 1 kg on the quartic spring (k = 0.6 N/m) or on the rod, both of 5 m: all rows of
# Box 1 and of the transversality conditions, without anything of mbocp.


def optimality(s: Solution, problem: Problem, *, is_rod: bool) -> tuple[float, float]:
    """Euclidean norms of all optimality conditions of a saved trajectory, and of r_u alone, eq. (31)."""
    dt, k, l2, g = s.duration / s.num_steps, 0.6, 25.0, problem.robot.model.gravity.linear
    alpha, mu_q, mu_p = problem.cost.effort, s.mus[:, :3], s.mus[:, 3:]
    q, p = s.qs[1:], s.ps[1:]
    lam, zeta = (s.lams, s.zetas) if is_rod else (np.zeros((s.num_steps, 1)),) * 2
    stretch = 0.0 if is_rod else k / (2 * l2) * (np.sum(q * q, axis=1, keepdims=True) - l2)
    bend = 0.0 if is_rod else k / l2 * q * np.sum(q * mu_p[:-1], axis=1, keepdims=True)
    gradient = q if is_rod else np.zeros_like(q)  # of Phi
    states = [
        s.qs[:-1] + dt * p - q,
        dt * (s.us + g - stretch * q - lam * gradient) - np.diff(s.ps, axis=0),
        0.5 * (np.sum(q * q, axis=1) - l2) * is_rod,
    ]
    adjoints = [
        np.diff(mu_q, axis=0) - dt * ((stretch + lam) * mu_p[:-1] + bend) + dt * zeta * gradient,
        np.diff(mu_p, axis=0) + dt * mu_q[:-1],
        np.sum(mu_p[:-1] * gradient, axis=1),
    ]
    controls = alpha * s.us + mu_p[:-1]
    miss = np.array([s.qs[-1] - problem.goal.q, s.ps[-1] - problem.goal.value])
    end, free = transversality(s, problem, miss, is_rod=is_rod)
    r_u = norm(controls, end)
    return norm(*states, *adjoints, free, np.array(r_u)), r_u


def transversality(s: Solution, problem: Problem, miss: Array, *, is_rod: bool) -> tuple[Array, Array]:
    """End condition, and what its multipliers cannot make up for in mu_N."""
    mu = s.mus[-1].reshape(2, 3)
    if problem.goal.enforce == "penalty":
        return np.zeros(0), mu - problem.cost.terminal * miss
    normal = problem.goal.q / np.linalg.norm(problem.goal.q)
    P = np.eye(3) - is_rod * np.outer(normal, normal)
    return miss @ P, mu - mu @ P


def norm(*parts: Array) -> float:
    return float(np.sqrt(sum(np.sum(part**2) for part in parts)))


def on_sphere(angles: tuple[float, float]) -> Array:
    """Point 5 m from the origin."""
    a, b = angles
    return 5.0 * np.array([np.cos(a) * np.cos(b), np.sin(a) * np.cos(b), np.sin(b)])


angle = st.floats(-3.0, 3.0)
small = st.floats(-3.0, 3.0)
vector = st.tuples(small, small, small)


@pytest.mark.parametrize("method", [*METHODS, "auto"])
@settings(max_examples=10, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
@given(
    system=st.sampled_from(["elastic_pendulum", "rigid_pendulum"]),
    enforce=st.sampled_from(["exact", "penalty"]),
    ends=st.tuples(angle, angle, angle, angle),
    momentum=vector,
    push=vector,
    duration=st.floats(0.2, 4.0),
    steps=st.integers(3, 25),
    effort=st.sampled_from([1e-3, 1.0]),
    globalisation=st.sampled_from(["default", "none"]),
)
def test_converged_means_that_the_optimality_conditions_hold(
    method: str,
    system: str,
    enforce: str,
    ends: tuple[float, float, float, float],
    momentum: tuple[float, float, float],
    push: tuple[float, float, float],
    duration: float,
    steps: int,
    effort: float,
    globalisation: str,
) -> None:
    is_rod = system == "rigid_pendulum"
    start, goal = on_sphere(ends[:2]), on_sphere(ends[2:])
    p = np.array(momentum) - (start @ momentum / 25.0 * start if is_rod else 0.0)
    problem = load(
        system,
        f"start={{q={start.tolist()}, p={p.tolist()}}}",
        f'goal={{q={goal.tolist()}, p=[0, 0, 0], enforce="{enforce}"}}',
        f"cost={{effort={effort}, terminal={1.0 if enforce == 'penalty' else 0.0}}}",
        f"horizon={{duration={duration}, steps={steps}}}",
        f"guess.u={list(push)}",
        f'solver={{globalisation="{globalisation}", max_iterations=150}}',
    )
    try:
        s = mbocp.solve(problem, solver=method)
    except ProblemError:  # the guess cannot be simulated
        event("no guess")
        return
    event(str(s.status))
    assert s.status is not Status.SWITCHED
    assert s.converged == (s.status is Status.CONVERGED)
    if not s.is_stationary:  # the same for an end at another root, whose conditions hold
        assert s.residual > 1e-9 or s.increment > 1e-9
        return
    check_honest(s)
    everything, r_u = optimality(s, problem, is_rod=is_rod)
    round_off = 1e-13 * (1.0 + np.abs(s.mus).max() + np.abs(s.us).max() + np.abs(s.ps).max())
    assert r_u <= 1e-9 + round_off
    assert everything <= 1e-9 + 10 * math.sqrt(s.num_steps) * round_off
    assert s.cost == pytest.approx(cost(s, problem), rel=1e-12)


def cost(s: Solution, problem: Problem) -> float:
    """Eq. (7), without a running cost of the state."""
    effort = 0.5 * s.duration / s.num_steps * np.sum(problem.cost.effort * s.us**2)
    miss = norm(s.qs[-1] - problem.goal.q, s.ps[-1] - problem.goal.value)
    return float(effort + 0.5 * problem.cost.terminal * miss**2)


@pytest.mark.parametrize("name", ["elastic_pendulum", "rigid_pendulum"])
def test_gradient_steps_begin_from_controls_zero(name: str) -> None:
    """There cost, gradient and eta are zero: only the end condition says where to go."""
    problem = load(name, "horizon.steps=20", "guess.u=[0, 0, 0]")
    s = mbocp.solve(problem, solver="fbsm_bb")
    assert s.converged, s.advice
    assert s.history[0].cost == 0.0
    assert s.cost == pytest.approx(mbocp.solve(problem, solver="monolithic").cost, rel=1e-9)

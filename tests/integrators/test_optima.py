"""Optima of the implicit schemes: the same problem, at the order of each, with the invariants of each."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.integrators import EULER_SCHEMES, TAU, VELOCITY_TAU
from mbocp.problem import Problem

EXAMPLES = Path(__file__).parents[2] / "examples"
SYSTEMS = (
    "paper/elastic_pendulum",
    "paper/rigid_pendulum",
    "paper/cart_pendulum_rigid",
    "paper/cart_pendulum_elastic",
    "arms/ur5_reach",
    "free_flyer/drone_flip",
)


def load(name: str, scheme: str, *settings: str) -> Problem:
    steps = ["horizon.steps=100"] if name.startswith("arms") else []
    path = EXAMPLES / f"{name}.toml"
    return mbocp.load_problem(path, [f'integrator.scheme="{scheme}"', *steps, *settings])


@cache
def solve(name: str, scheme: str, *settings: str) -> mbocp.Solution:
    solution = mbocp.solve(load(name, scheme, *settings))
    assert solution.converged, solution.advice
    return solution


def check_steps(problem: Problem, s: mbocp.Solution) -> None:
    """The steps, by Pinocchio's own algorithms."""
    robot, tau, dt = problem.robot, TAU[problem.scheme], problem.dt
    share = VELOCITY_TAU[problem.scheme]
    model, data = robot.model, robot.model.createData()
    for n in range(s.num_steps):
        moved = pin.integrate(model, s.qs[n], dt * ((1 - share) * s.vs[n] + share * s.vs[n + 1]))
        assert np.abs(pin.difference(model, s.qs[n + 1], moved)).max() < 1e-11
        v = (1 - tau) * s.vs[n] + tau * s.vs[n + 1]
        q = pin.integrate(model, s.qs[n], tau * dt * v)
        needed = pin.rnea(model, data, q, v, (s.vs[n + 1] - s.vs[n]) / dt)
        applied = robot.actuation_matrix(q) @ s.us[n] + robot.force_elements(q, v)
        applied = applied - robot.constraint_jacobian(q).T @ s.lams[n]
        assert np.abs(needed - applied).max() < 1e-8 * (1 + np.abs(needed).max())


@pytest.mark.parametrize("scheme", EULER_SCHEMES)
@pytest.mark.parametrize("name", SYSTEMS)
def test_example_problems(name: str, scheme: str) -> None:
    settings = ["horizon.steps=100"] if "paper" in name else []
    problem, s = load(name, scheme, *settings), solve(name, scheme, *settings)
    assert "strict local minimum" in s.advice
    check_steps(problem, s)
    if problem.goal.is_exact:
        assert np.linalg.norm(problem.robot.difference(problem.goal.q, s.q_final)) < 1e-9
    assert s.constraint_violation < 1e-10
    assert s.control_momentum_names
    assert s.control_momentum_drift < 1e-9 * (1 + np.abs(s.control_momenta).max())


@pytest.mark.parametrize("scheme", EULER_SCHEMES)
@pytest.mark.parametrize("name", ["elastic_pendulum", "rigid_pendulum"])
def test_the_papers_control_momentum(name: str, scheme: str) -> None:
    """Eq. (15) with the reported adjoints."""
    start = ["start.q=[-3, 0, -4]", "start.p=[0.4, 2, -0.3]"]
    s = solve(f"paper/{name}", scheme, "horizon.steps=60", *start, "goal.q=[0, 3, -4]")
    xi = np.cross(s.qs, s.mus[:, :3]) + np.cross(s.ps, s.mus[:, 3:])
    assert np.allclose(s.control_momenta[:, 0], xi[:, 2], atol=1e-9 * (1 + np.abs(xi).max()))
    assert np.abs(xi[0, 2]) > 1e-2


def costs(name: str, scheme: str, steps: tuple[int, ...]) -> Array:
    return np.array([solve(name, scheme, f"horizon.steps={n}").cost for n in steps])


def ratio(values: Array) -> float:
    """2 for first order, 4 for second, at steps that halve."""
    return float((values[0] - values[1]) / (values[1] - values[2]))


def test_costs_converge_at_the_order_of_the_scheme() -> None:
    name, steps = "paper/cart_pendulum_rigid", (40, 80, 160)
    se1, se2, midpoint = (costs(name, scheme, steps) for scheme in ("se1", "se2", "midpoint"))
    assert ratio(se1) == pytest.approx(2.0, abs=0.2)
    assert ratio(se2) == pytest.approx(2.0, abs=0.2)
    assert ratio(midpoint) == pytest.approx(4.0, abs=0.4)
    # SE2 is SE1 backwards in time: their errors are opposite to first order.
    mean = (se1 + se2) / 2
    assert ratio(mean) == pytest.approx(4.0, abs=0.4)
    assert np.abs(mean - midpoint)[-1] < 0.02 * np.abs(se1 - midpoint)[-1]
    limit = (4 * midpoint[2] - midpoint[1]) / 3
    assert (4 * mean[2] - mean[1]) / 3 == pytest.approx(limit, rel=1e-6)


def test_costs_of_an_arm_converge_at_the_order_of_the_scheme() -> None:
    steps = (25, 50, 100)
    assert ratio(costs("arms/ur5_reach", "se2", steps)) == pytest.approx(2.0, abs=0.2)
    assert ratio(costs("arms/ur5_reach", "midpoint", steps)) == pytest.approx(4.0, abs=0.4)


@pytest.mark.parametrize("scheme", EULER_SCHEMES)
def test_control_hamiltonian_varies_at_the_order_of_the_scheme(scheme: str) -> None:
    for name, steps in (("paper/elastic_pendulum", (160, 320)), ("paper/rigid_pendulum", (40, 80))):
        solutions = [solve(name, scheme, f"horizon.steps={n}") for n in steps]
        varies = [float(np.ptp(s.control_hamiltonians)) for s in solutions]
        order = 2 if scheme == "midpoint" else 1
        assert np.log2(varies[0] / varies[1]) == pytest.approx(order, abs=0.25)


@pytest.mark.parametrize(
    ("name", "scheme"),
    [("arms/ur5_reach", "se2"), ("arms/ur5_reach", "midpoint"), ("free_flyer/drone_flip", "midpoint")],
)
def test_adjoint_at_the_start_is_the_sensitivity_of_the_cost(name: str, scheme: str) -> None:
    """dJ = mu_0 . (dq, dp) when the start moves, with p = M(q) v."""
    moving = "start.v=[0.5, -0.4, 0.3, 0.2, -0.3, 0.4]"  # for the derivative of M(q) v
    problem, best = load(name, scheme, moving), solve(name, scheme, moving)
    robot, nv, h = problem.robot, problem.robot.nv, 1e-4
    direction = np.random.default_rng(2).standard_normal(2 * nv)

    def cost(t: float) -> float:
        q = robot.integrate(problem.q_start, t * direction[:nv])
        v = robot.velocity_from_momentum(q, problem.p_start + t * direction[nv:])
        s = mbocp.solve(problem.with_(q_start=q, v_start=v), warm_start=best)
        assert s.converged, s.advice
        return s.cost

    slope = (8 * (cost(h) - cost(-h)) - (cost(2 * h) - cost(-2 * h))) / (12 * h)
    assert best.mus[0] @ direction == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("scheme", EULER_SCHEMES)
def test_warm_starts_from_every_scheme(scheme: str) -> None:
    name = "arms/ur5_reach"
    cold = solve(name, scheme)
    for other in EULER_SCHEMES:
        warm = mbocp.solve(load(name, scheme), warm_start=solve(name, other))
        assert warm.converged
        assert warm.cost == pytest.approx(cold.cost, rel=1e-12)
        # One Newton step sets the multipliers right, the next finds nothing to do.
        assert warm.iterations <= (2 if other == scheme else 6)


def test_a_solution_knows_its_scheme() -> None:
    assert solve("paper/rigid_pendulum", "midpoint", "horizon.steps=10").scheme == "midpoint"

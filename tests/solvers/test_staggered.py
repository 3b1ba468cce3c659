"""FBSM-Newton, FBSM-BB, the hybrids and `auto`: against the monolithic solver, against each other."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import SolverError

EXAMPLES = Path(__file__).parents[2] / "examples"
PENALTY = ('goal.enforce="penalty"', "cost.effort=1e-3", "cost.terminal=1.0")
STRATEGIES = ("fbsm_newton", "fbsm_bb", "fbsm_bb+monolithic", "fbsm_bb+fbsm_newton", "auto")
TABLES = (  # Tables 2, 4 (both forms), 6, 7
    ("elastic_pendulum", (), (10, 50)),
    ("rigid_pendulum", PENALTY, (4, 20)),
    ("rigid_pendulum", (), (4, 20)),
    ("cart_pendulum_rigid", (), (20, 40)),
    ("cart_pendulum_elastic", (), (20, 40)),
)
CASES = [(name, form, steps) for name, form, all_steps in TABLES for steps in all_steps]
ROBOTS = ("arms/ur5_reach", "arms/panda_reach", "free_flyer/drone_flip")


def solve(name: str, method: str, *settings: str) -> mbocp.Solution:
    path = EXAMPLES / (name if "/" in name else f"paper/{name}")
    scheme = (
        ("integrator.scheme=se1", "horizon.steps=100")
        if name.startswith("arms")
        else ("integrator.scheme=se1",)
    )
    return mbocp.solve(mbocp.load_problem(f"{path}.toml", [*scheme, *settings]), solver=method)


def steps_of(solution: mbocp.Solution, phase: str) -> list[mbocp.IterationRecord]:
    return [r for r in solution.history if r.phase == phase and not r.is_guess]


@pytest.mark.parametrize(
    ("name", "form", "steps"), CASES, ids=[f"{n}-{'penalty' if f else 'plain'}-{s}" for n, f, s in CASES]
)
def test_every_strategy_finds_the_same_minimum(name: str, form: tuple[str, ...], steps: int) -> None:
    settings = (*form, f"horizon.steps={steps}")
    expected = solve(name, "monolithic", *settings)
    assert expected.converged
    for method in STRATEGIES:
        s = solve(name, method, *settings)
        assert s.converged, (method, s.advice)
        assert s.residual <= 1e-9
        assert "strict local minimum" in s.advice, method
        assert s.cost == pytest.approx(expected.cost, rel=1e-9), method
        assert np.abs(s.us - expected.us).max() < 1e-6, method
        assert s.constraint_violation < 1e-12


@pytest.mark.parametrize(
    "method", ["monolithic", "fbsm_newton", "fbsm_bb+monolithic", "fbsm_bb+fbsm_newton", "auto"]
)
@pytest.mark.parametrize("name", ROBOTS)
def test_newton_s_strategies_solve_robots(name: str, method: str) -> None:
    expected, s = solve(name, "monolithic"), solve(name, method)
    assert s.converged, s.advice
    assert s.cost == pytest.approx(expected.cost, rel=1e-10)
    assert np.abs(s.us - expected.us).max() < 1e-6
    assert np.abs(s.mus - expected.mus).max() < 1e-6 * (1.0 + np.abs(expected.mus).max())


@pytest.mark.parametrize("globalisation", ["none", "default"])
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("elastic_pendulum", ("horizon.steps=50",)),
        ("rigid_pendulum", ("horizon.steps=20",)),
        ("rigid_pendulum", ("horizon.steps=100", "guess.u=[0, -2, 1]")),
        ("cart_pendulum_rigid", ("horizon.steps=40",)),
        ("cart_pendulum_elastic", ("horizon.steps=40",)),
        ("free_flyer/drone_flip", ("horizon.steps=20", 'solver.loop="open"')),
    ],
)
def test_all_ways_to_the_step_give_the_same_iterates(
    name: str, settings: tuple[str, ...], globalisation: str
) -> None:
    """Structured, dense, and with the auxiliary adjoint: to round-off, until chaos has grown from it."""
    settings = (*settings, f'solver.globalisation="{globalisation}"', "solver.max_iterations=8")
    base = solve(name, "fbsm_newton", *settings)
    for other in ('solver.hessian="dense"', 'solver.adjoint="auxiliary"'):
        s = solve(name, "fbsm_newton", *settings, other)
        assert s.iterations == base.iterations
        for a, b in zip(base.history, s.history, strict=True):
            assert a.step_length == b.step_length or a.is_guess or a.residual < 1e-9
            assert a.residual == pytest.approx(b.residual, rel=1e-5, abs=1e-9)
        assert np.abs(base.us - s.us).max() < 1e-6 * (1.0 + np.abs(base.us).max())


def test_paper_s_hessian_by_finite_differences_converges_likewise() -> None:
    for name in ("elastic_pendulum", "cart_pendulum_elastic"):
        settings = ("horizon.steps=20", 'solver.globalisation="none"')
        exact = solve(name, "fbsm_newton", *settings)
        differences = solve(name, "fbsm_newton", *settings, 'solver.hessian="finite-difference"')
        assert exact.converged
        assert differences.converged
        assert differences.cost == pytest.approx(exact.cost, rel=1e-9)
        assert abs(differences.iterations - exact.iterations) <= 3


def test_a_dense_matrix_of_a_long_horizon_is_refused() -> None:
    with pytest.raises(SolverError, match=r"15006 x 15006.*structured"):
        solve("elastic_pendulum", "fbsm_newton", "horizon.steps=5000", 'solver.hessian="dense"')


@pytest.mark.parametrize(
    ("name", "steps", "count"),
    [
        ("elastic_pendulum", 10, 9),
        ("elastic_pendulum", 50, 9),
        ("elastic_pendulum", 100, 9),
        ("elastic_pendulum", 500, 15),
        ("cart_pendulum_elastic", 200, 8),
        ("cart_pendulum_elastic", 400, 8),
    ],
)
def test_algorithm_2_takes_the_paper_s_iterations(name: str, steps: int, count: int) -> None:
    s = solve(name, "fbsm_newton", f"horizon.steps={steps}", 'solver.globalisation="none"')
    assert s.converged
    assert s.iterations == count


@pytest.mark.parametrize("method", ["monolithic", "fbsm_newton"])
def test_the_last_steps_are_quadratic(method: str) -> None:
    for name in ("elastic_pendulum", "cart_pendulum_elastic", "rigid_pendulum"):
        s = solve(name, method)
        increments = [r.increment for r in s.history if r.increment < 1.0 and r.increment > 1e-12][-3:]
        assert len(increments) >= 2
        for before, after in itertools.pairwise(increments):
            assert after < max(10.0 * before**1.6, 1e-10), (name, increments)


def test_gradient_steps_are_no_longer_than_theta_max() -> None:
    for theta in (0.5, 2.0):
        s = solve("cart_pendulum_elastic", "fbsm_bb", "horizon.steps=20", f"solver.theta_max={theta}")
        assert s.converged
        increments = [r.increment for r in steps_of(s, "fbsm_bb")]
        assert max(increments) <= theta * (1.0 + 1e-12)
        assert max(increments) > 0.99 * theta


def test_gradient_method_uses_the_auxiliary_adjoint() -> None:
    plain = solve("rigid_pendulum", "fbsm_bb", "horizon.steps=10")
    split = solve("rigid_pendulum", "fbsm_bb", "horizon.steps=10", 'solver.adjoint="auxiliary"')
    assert split.converged
    assert split.cost == pytest.approx(plain.cost, rel=1e-12)


def test_hybrid_switches_after_so_many_steps_and_shows_both_phases() -> None:
    off = ("solver.switch_residual=0", "solver.switch_cost=0", "solver.switch_iterations=25")
    for newton in ("monolithic", "fbsm_newton"):
        s = solve("elastic_pendulum", f"fbsm_bb+{newton}", "horizon.steps=100", *off)
        assert s.converged
        assert len(steps_of(s, "fbsm_bb")) == 25
        assert len(steps_of(s, newton)) == s.iterations - 25
        assert 5 <= s.iterations - 25 <= 9  # the paper: 6
        assert [p.name for p in s.phases if p.iterations] == ["fbsm_bb", newton]
        assert [r.iteration for r in s.history if not r.is_guess] == list(range(1, s.iterations + 1))


def test_hybrid_switches_by_residual_and_by_cost() -> None:
    by_residual = solve(
        "elastic_pendulum", "fbsm_bb+monolithic", "horizon.steps=100", "solver.switch_cost=0",
        "solver.switch_iterations=500",
    )  # fmt: skip
    residuals = [r.residual for r in by_residual.history if r.phase == "fbsm_bb"]
    assert residuals[-1] < 10.0 <= min(residuals[:-1])
    by_cost = solve(
        "cart_pendulum_rigid", "fbsm_bb+monolithic", "horizon.steps=40", "solver.switch_residual=0",
        "solver.switch_cost=0.9", "solver.switch_iterations=500",
    )  # fmt: skip
    costs = [r.cost for r in by_cost.history if r.phase == "fbsm_bb"]
    assert costs[-1] < 0.9 * costs[0] <= min(costs[:-1])


def test_auto_is_the_monolithic_solver_where_that_converges() -> None:
    auto, monolithic = solve("arms/ur5_reach", "auto"), solve("arms/ur5_reach", "monolithic")
    assert auto.iterations == monolithic.iterations
    assert np.array_equal(auto.us, monolithic.us)
    assert auto.solver.startswith("auto")


def test_auto_goes_over_to_another_solver_and_says_so() -> None:
    """Pure Newton from adjoints zero goes nowhere on the elastic cart."""
    settings = ("horizon.steps=200", 'solver.globalisation="none"')
    alone = solve("cart_pendulum_elastic", "monolithic", *settings)
    assert not alone.converged
    s = solve("cart_pendulum_elastic", "auto", *settings)
    assert s.converged, s.advice
    names = [p.name for p in s.phases if p.iterations]
    assert names[:2] == ["monolithic", "fbsm_bb"]
    assert "monolithic made no progress any more after" in s.advice
    assert "fbsm_newton converged" in s.advice
    assert s.cost == pytest.approx(solve("cart_pendulum_elastic", "monolithic", "horizon.steps=200").cost)


def test_auto_keeps_within_its_budget() -> None:
    settings = ("horizon.steps=200", 'solver.globalisation="none"', "solver.max_iterations=60")
    s = solve("cart_pendulum_elastic", "auto", *settings)
    assert s.iterations <= 60
    short = solve("cart_pendulum_elastic", "auto", *settings[:2], "solver.max_iterations=3")
    assert short.status == "max_iterations"
    assert short.iterations == 3


def test_both_forms_and_their_adjoints() -> None:
    """Remark 2 for a staggered solver: mu* = alpha mu, H* = alpha H, up to O(alpha / beta_T)."""
    exact = solve("elastic_pendulum", "fbsm_newton", "horizon.steps=100")
    penalty = solve("elastic_pendulum", "fbsm_newton", "horizon.steps=100", *PENALTY)
    assert np.allclose(penalty.mus / 1e-3, exact.mus, atol=5e-3 * np.abs(exact.mus).max())
    assert np.allclose(penalty.control_hamiltonians / 1e-3, exact.control_hamiltonians, atol=2e-2)
    both = solve(
        "rigid_pendulum",
        "fbsm_bb+fbsm_newton",
        "horizon.steps=20",
        'goal.enforce="both"',
        "cost.terminal=1e-3",
    )
    assert both.converged
    assert np.abs(both.us - solve("rigid_pendulum", "monolithic", "horizon.steps=20").us).max() < 1e-8

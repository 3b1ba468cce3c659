"""The first paper's four systems, at all step sizes of its tables, against independently computed optima."""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp

ROOT = Path(__file__).parent
REFERENCE = json.loads((ROOT / "data" / "paper_reference.json").read_text(encoding="utf-8"))
EXAMPLES = ROOT.parent / "examples" / "paper"
PENALTY = ['goal.enforce="penalty"', "cost.effort=1e-3", "cost.terminal=1.0"]
TABLES = {  # steps of Tables 2, 4, 6, 7
    "elastic_pendulum": (10, 50, 100, 500),
    "rigid_pendulum": (4, 10, 20, 100),
    "cart_pendulum_rigid": (20, 40, 200, 400),
    "cart_pendulum_elastic": (20, 40, 200, 400),
}


def solve(
    name: str, *settings: str, globalisation: str = "default", method: str = "monolithic"
) -> mbocp.Solution:
    settings = (*settings, f'solver.globalisation="{globalisation}"')
    return mbocp.solve(mbocp.load_problem(EXAMPLES / f"{name}.toml", settings), solver=method)


def name_of(case: dict[str, Any]) -> str:
    return f"{case['problem']}-{case['form']}-{case['gravity']}-{case['steps']}"


@pytest.mark.parametrize("globalisation", ["none", "default"])
@pytest.mark.parametrize("case", REFERENCE, ids=name_of)
def test_matches_the_reference(case: dict[str, Any], globalisation: str) -> None:
    settings = [f"horizon.steps={case['steps']}"]
    if case["form"] != "tracking":
        settings.append(f"robot.gravity=[0, 0, -{case['gravity']}]")
    if case["form"] == "penalty":
        settings += PENALTY
    s = solve(case["problem"], *settings, globalisation=globalisation)
    assert s.converged, s.advice
    assert s.residual <= 1e-9
    assert s.increment <= 1e-9 or (s.residual <= 1e-11 and "the next increment" in s.advice)
    assert "strict local minimum" in s.advice
    assert s.cost == pytest.approx(case["cost"], rel=1e-11)
    scale = 1e-10 * (1.0 + np.abs(case["mu_0"]).max())
    assert np.abs(s.mus[0] - case["mu_0"]).max() < scale
    assert np.abs(s.mus[-1] - case["mu_N"]).max() < scale
    for n, u in case["u"]:
        assert np.abs(s.us[n] - u).max() < 1e-9
    for n, y in case["y"]:
        assert np.abs(np.concatenate([s.qs[n], s.ps[n]]) - y).max() < 1e-9
    for n, lam, zeta in case["lam"]:
        assert np.abs(s.lams[n - 1] - lam).max() < 1e-8  # lambda is the least accurate unknown: index 3
        assert np.abs(s.zetas[n - 1] - zeta).max() < 1e-8
    assert s.control_hamiltonian["min"] == pytest.approx(case["H"][0], rel=1e-9, abs=1e-10)
    assert s.control_hamiltonian["max"] == pytest.approx(case["H"][1], rel=1e-9, abs=1e-10)
    if globalisation == "none":
        assert s.iterations == case["pure_newton_iterations"]


@pytest.mark.parametrize(("name", "steps"), [(n, k) for n, all_steps in TABLES.items() for k in all_steps])
def test_converges_at_every_step_size_of_the_tables(name: str, steps: int) -> None:
    s = solve(name, f"horizon.steps={steps}")
    assert s.converged, s.advice
    assert "strict local minimum" in s.advice
    assert s.constraint_violation < 1e-12
    assert s.control_momentum_drift < 1e-9


@pytest.mark.parametrize(
    ("name", "steps"), [("elastic_pendulum", 500), ("rigid_pendulum", 100), ("cart_pendulum_rigid", 200)]
)
def test_pure_newton_converges_at_the_finest_steps(name: str, steps: int) -> None:
    s = solve(name, f"horizon.steps={steps}", globalisation="none")
    assert s.converged, s.advice
    assert s.cost == pytest.approx(solve(name, f"horizon.steps={steps}").cost, rel=1e-10)


def test_pure_newton_from_zero_adjoints_says_that_it_fails_on_the_elastic_cart() -> None:
    s = solve("cart_pendulum_elastic", "horizon.steps=200", "solver.max_iterations=60", globalisation="none")
    assert not s.converged
    assert s.status in ("max_iterations", "diverged", "singular")
    assert "violation" in s.advice


def test_newton_s_last_steps_are_quadratic() -> None:
    s = solve("elastic_pendulum", "horizon.steps=100", globalisation="none")
    increments = [r.increment for r in s.history[-4:-1]]
    for before, after in itertools.pairwise(increments):
        assert after < 0.1 * before**1.6


def test_both_exact_and_penalised() -> None:
    """gamma = 1 with beta_T = 1e-3: the exact end condition makes the penalty vanish, not the adjoint."""
    both = solve("rigid_pendulum", "horizon.steps=20", 'goal.enforce="both"', "cost.terminal=1e-3")
    exact = solve("rigid_pendulum", "horizon.steps=20")
    assert both.converged
    assert np.abs(both.us - exact.us).max() < 1e-8
    assert both.cost == pytest.approx(exact.cost, rel=1e-10)


def test_adjoints_of_both_forms_differ_by_alpha() -> None:
    """Remark 2: mu* = alpha mu and H* = alpha H, up to O(alpha / beta_T)."""
    exact = solve("elastic_pendulum", "horizon.steps=100")
    penalty = solve("elastic_pendulum", "horizon.steps=100", *PENALTY)
    assert np.allclose(penalty.mus / 1e-3, exact.mus, atol=5e-3 * np.abs(exact.mus).max())
    assert np.allclose(penalty.control_hamiltonians / 1e-3, exact.control_hamiltonians, atol=2e-2)


def test_control_hamiltonian_tends_to_its_constant() -> None:
    """About 0.373 with a = 9.8 (Fig. 2g: 0.37), to first order in the step."""
    means = [
        solve("elastic_pendulum", f"horizon.steps={n}").control_hamiltonians.mean()
        for n in (1000, 2000, 4000)
    ]
    assert 2 * means[2] - means[1] == pytest.approx(0.373, abs=0.003)
    assert (means[0] - means[1]) / (means[1] - means[2]) == pytest.approx(2.0, abs=0.2)


def test_control_momentum_is_conserved() -> None:
    gravity = solve("rigid_pendulum", "horizon.steps=100")
    assert gravity.control_momentum_names == ("rotation about z",)
    xi = np.cross(gravity.qs, gravity.mus[:, :3]) + np.cross(gravity.ps, gravity.mus[:, 3:])  # Eq. (15)
    assert np.abs(xi[:, 2] - xi[0, 2]).max() < 1e-9
    assert np.allclose(gravity.control_momenta[:, 0], xi[:, 2], atol=1e-9)
    assert np.ptp(xi[:, 0]) > 1.0


def test_all_components_are_conserved_without_gravity() -> None:
    """From the paper's guess the motion stays on the equator, where the end condition is singular."""
    goal = ["goal.q=[0, 4, 3]", "guess.u=[0, -2, 1]"]
    s = solve("rigid_pendulum", "horizon.steps=100", "robot.gravity=[0, 0, 0]", *goal)
    assert s.converged, s.advice
    xi = np.cross(s.qs, s.mus[:, :3]) + np.cross(s.ps, s.mus[:, 3:])
    assert np.abs(xi - xi[0]).max() < 1e-9
    assert np.abs(xi[0]).max() > 0.1
    assert len(s.control_momentum_names) == 3


def test_cart_s_adjoint_sum_is_conserved() -> None:
    s = solve("cart_pendulum_rigid", "horizon.steps=200")
    total = s.mus[:, 0] + s.mus[:, 1]
    assert np.abs(total - total[0]).max() < 1e-9
    assert np.abs(s.mus[0, 0]) > 1e-3


def test_unknowns_count_what_is_solved_for() -> None:
    """Per step mu, zeta, (q, p), lambda, u; and eta. The paper adds u_N and, with gamma = 1, mu_N."""
    elastic = solve("elastic_pendulum", "horizon.steps=10")
    assert elastic.unknowns == 15 * 10 + 6  # the paper: 15 N + 15
    rigid = solve("rigid_pendulum", "horizon.steps=10", *PENALTY)
    assert rigid.unknowns == 17 * 10  # the paper: 17 N + 3

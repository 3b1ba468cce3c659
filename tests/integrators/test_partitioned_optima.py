"""Optima with Gauss methods and Lobatto's pair: solvers agree, momenta are kept, lengths of steps weigh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.problem import Problem
from tests.integrators.test_schemes import by_hand

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = {
    "gauss1": "paper/elastic_pendulum.toml",
    "gauss2": "paper/elastic_pendulum.toml",
    "gauss3": "paper/elastic_pendulum.toml",
    "lobatto2": "paper/rigid_pendulum.toml",
    "lobatto3": "paper/rigid_pendulum.toml",
}
SCHEMES_OF_ONE: tuple[tuple[str, ...], ...] = ((), ("integrator.scheme=midpoint",))


def load(scheme: str, *settings: str) -> Problem:
    return mbocp.load_problem(EXAMPLES / SMALL[scheme], [f"integrator.scheme={scheme}", *settings])


@pytest.mark.parametrize("scheme", SMALL)
def test_solvers_agree(scheme: str) -> None:
    own = mbocp.solve(load(scheme, "horizon.steps=20"))
    other = mbocp.solve(load(scheme, "horizon.steps=20", "solver=ipopt"))
    assert own.converged, own.advice
    assert other.converged, other.advice
    assert own.cost == pytest.approx(other.cost, rel=1e-7)
    assert np.abs(own.qs - other.qs).max() < 1e-4
    assert np.abs(own.lams - other.lams).max(initial=0.0) < 1e-4
    assert own.constraint_violation < 1e-10
    assert own.control_momentum_drift < 1e-9
    if own.nc:
        assert own.velocity_violation < 1e-10


@pytest.mark.parametrize("scheme", ["gauss2", "lobatto3"])
def test_control_momenta_of_a_body_on_a_ball_joint(scheme: str) -> None:
    problem = by_hand("ball joint", scheme, 10).with_(cost={"effort": 1.0})
    solution = mbocp.solve(problem)
    assert solution.converged, solution.advice
    assert solution.control_momenta.shape[1] == 0 or solution.control_momentum_drift < 1e-9
    assert solution.manifold_drift < 1e-12


def test_one_stage_is_the_midpoint_rule_where_masses_are_constant() -> None:
    """In a vector space; where the mass varies it is the discrete Lagrangian that is taken in the middle."""
    one, rule = (
        mbocp.solve(load("gauss1", "horizon.steps=20", *more), check=True) for more in SCHEMES_OF_ONE
    )
    assert one.cost == pytest.approx(rule.cost, rel=1e-12)
    assert np.abs(one.qs - rule.qs).max() < 1e-9
    arms = [
        mbocp.load_problem(
            EXAMPLES / "arms/ur5_reach.toml", [f"integrator.scheme={name}", "horizon.steps=20"]
        )
        for name in ("gauss1", "midpoint")
    ]
    costs = [mbocp.solve(arm, check=True).cost for arm in arms]
    assert abs(costs[0] / costs[1] - 1.0) > 1e-6


def test_hamiltonian_of_a_free_duration_vanishes_in_the_mean() -> None:
    free = load("gauss2", "horizon.steps=20", "horizon.duration={min=1, max=20, guess=5}", "cost.time=1.0")
    solution = mbocp.solve(free)
    assert solution.converged, solution.advice
    assert not [a for a in solution.active_limits if a.kind == "duration"]
    assert abs(solution.control_hamiltonians.mean()) < 1e-7
    assert np.ptp(solution.control_hamiltonians) < 0.5  # of second order, as the controls are

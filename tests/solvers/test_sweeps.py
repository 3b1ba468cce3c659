"""The sweeps and what is computed from them, against finite differences and against each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.formulation import formulate
from mbocp.guesses import guess_candidates, make_guess
from mbocp.programme.kernel import kernel_programme
from mbocp.solvers.staggered.sweep import Kept, Sweeps, init_sweeps

EXAMPLES = Path(__file__).parents[2] / "examples"
SYSTEMS = (
    "paper/elastic_pendulum",  # exact end condition
    "paper/rigid_pendulum",  # and a constraint
    "paper/cart_pendulum_rigid",  # a constraint, tracking
    "free_flyer/drone_flip",  # a Lie group
    "arms/ur5_reach",
)


class Held:
    """A kernel programme with a swept trajectory near the guess, controls and eta disturbed."""

    def __init__(self, name: str, steps: int, *settings: str, disturbance: float = 1e-3) -> None:
        settings = ("integrator.scheme=se1", *settings)
        if name.startswith("arms"):  # few steps, but no longer ones
            settings = (f"horizon.duration={0.02 * steps}", *settings)
        problem = mbocp.load_problem(EXAMPLES / f"{name}.toml", [f"horizon.steps={steps}", *settings])
        formulation = formulate(problem)
        self.programme = formulation.programme
        iterate, _ = make_guess(guess_candidates(problem)[0], formulation)
        self.native = kernel_programme(self.programme)
        iterate.load_into(self.native)
        rng = np.random.default_rng(1)
        self.native.u = self.native.u + disturbance * rng.standard_normal(self.native.u.size)
        self.native.eta = rng.standard_normal(self.native.eta.size)
        assert Sweeps().run(self.native).evaluation is not None

    def reduced(self) -> np.ndarray[Any, Any]:
        """Derivative of the Lagrangian in (eta, u)."""
        return np.concatenate(
            [self.native.end_condition, self.native.control_gradient / self.native.control_scale]
        )


def lagrangian(native: Any) -> float:
    evaluation = native.gradient()
    return float(evaluation.cost + native.eta @ native.end_condition)


@pytest.mark.parametrize("name", SYSTEMS)
def test_swept_state_and_adjoint_satisfy_their_equations(name: str) -> None:
    held = Held(name, 20)
    swept = held.native.gradient()
    whole = held.native.evaluate()
    assert whole.cost == pytest.approx(swept.cost, rel=1e-14)
    scale = 1.0 + np.abs(held.native.m).max()
    assert whole.residual == pytest.approx(swept.residual, rel=1e-9, abs=1e-11 * scale)
    assert swept.residual > 1e-3  # it is not zero altogether


@pytest.mark.parametrize("name", SYSTEMS)
def test_reduced_gradient_is_the_derivative_of_the_lagrangian(name: str) -> None:
    held = Held(name, 12)
    native, kept = held.native, Kept.of(held.native)
    native.gradient()
    gradient = held.reduced()[native.eta.size :]
    rng = np.random.default_rng(2)
    for _ in range(3):
        direction, h, values = rng.standard_normal(gradient.size), 1e-5, []
        for step in (h, -h):
            kept.restore(native)
            native.u = kept.u + step * direction
            Sweeps().run(native)
            values.append(lagrangian(native))
        kept.restore(native)
        assert (values[0] - values[1]) / (2 * h) == pytest.approx(gradient @ direction, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("name", SYSTEMS)
def test_reduced_hessian_is_the_derivative_of_the_reduced_gradient(name: str) -> None:
    held = Held(name, 10)
    native, kept = held.native, Kept.of(held.native)
    native.evaluate()
    ng, size = native.eta.size, native.eta.size + native.u.size
    K = native.reduced_hessian().reshape(size, size)
    assert np.abs(K - K.T).max() <= 1e-11 * np.abs(K).max()
    rng = np.random.default_rng(3)
    for _ in range(3):
        direction, h, values = rng.standard_normal(size), 1e-6, []
        for step in (h, -h):
            kept.restore(native)
            native.eta = kept.eta + step * direction[:ng]
            native.u = kept.u + step * direction[ng:]
            Sweeps().run(native)
            values.append(held.reduced())
        kept.restore(native)
        expected = (values[0] - values[1]) / (2 * h)
        assert np.abs(K @ direction - expected).max() <= 2e-6 * (1.0 + np.abs(expected).max())


@pytest.mark.parametrize("shift", [0.0, 0.3])
@pytest.mark.parametrize("name", SYSTEMS)
def test_structured_step_is_the_dense_one(name: str, shift: float) -> None:
    """Where state and adjoint equations hold, the whole system's step has the reduced one's (eta, u)."""
    held = Held(name, 15)
    native = held.native
    native.evaluate()
    assert native.factorise(shift, 0.0).ok
    native.solve(3)
    structured = np.concatenate([native.deta, native.du])
    K = native.reduced_hessian(shift).reshape(structured.size, structured.size)
    dense = -np.linalg.solve(K, held.reduced())
    assert np.abs(dense - structured).max() <= 1e-8 * np.abs(structured).max()


@pytest.mark.parametrize("name", SYSTEMS)
def test_auxiliary_adjoint_gives_the_same_multipliers(name: str) -> None:
    """mu = sigma + A eta, eqs. (33) to (44)."""
    held = Held(name, 15)
    native = held.native
    native.gradient()
    direct, residual = native.m, native.control_gradient
    native.gradient(True)
    assert np.abs(native.m - direct).max() <= 1e-10 * (1.0 + np.abs(direct).max())
    assert np.abs(native.control_gradient - residual).max() <= 1e-9 * (1.0 + np.abs(residual).max())
    kind, ng = held.programme.kind, held.programme.ng
    sigma = native.sigma.reshape(-1, kind.ndx)
    A = native.A.reshape(len(sigma), kind.ndx, ng)
    mu = direct.reshape(-1, kind.ndx + kind.ny)[:, : kind.ndx]
    assert np.allclose(sigma + A @ native.eta, mu, rtol=1e-9, atol=1e-9 * (1.0 + np.abs(mu).max()))
    if ng:
        assert np.abs(A).max() > 0.1


@pytest.mark.parametrize("name", SYSTEMS)
def test_end_sensitivity_is_the_derivative_of_the_end_condition(name: str) -> None:
    held = Held(name, 12)
    native, kept = held.native, Kept.of(held.native)
    native.gradient()
    G = native.end_sensitivity().reshape(native.eta.size, native.u.size)
    direction, h, values = np.random.default_rng(4).standard_normal(native.u.size), 1e-6, []
    for step in (h, -h):
        kept.restore(native)
        native.u = kept.u + step * direction
        Sweeps().run(native)
        values.append(native.end_condition)
    expected = (values[0] - values[1]) / (2 * h)
    assert np.abs(G @ direction - expected).max(initial=0.0) <= 1e-6 * (
        1.0 + np.abs(expected).max(initial=0.0)
    )


@pytest.mark.parametrize("name", ["paper/elastic_pendulum", "free_flyer/drone_flip", "arms/ur5_reach"])
def test_closed_loop_adjoint_is_the_gradient_in_the_planned_controls(name: str) -> None:
    """With u = planned + K (x - planned x), the closed loop's sweep differentiates in the plan."""
    held = Held(name, 15)
    native = held.native
    native.evaluate()
    assert native.factorise(0.1, 1.0).ok
    closed = Sweeps(feedback=True)
    assert closed.run(native).evaluation is not None
    kept = Kept.of(native)
    closed.backward(native)
    gradient = native.control_gradient / native.control_scale
    native.gradient()
    opened = native.control_gradient / native.control_scale
    assert np.abs(gradient - opened).max() > 1e-3 * np.abs(opened).max()  # the loop does make a difference
    direction, h, values = np.random.default_rng(5).standard_normal(gradient.size), 1e-5, []
    for step in (h, -h):
        kept.restore(native)
        native.u = kept.u + step * direction
        closed.run(native)
        values.append(lagrangian(native))
    assert (values[0] - values[1]) / (2 * h) == pytest.approx(gradient @ direction, rel=1e-6, abs=1e-7)


def test_a_closed_sweep_stays_where_an_open_one_explodes() -> None:
    """The kinova example's wrist: sensitivities of 1e50 and more in open loop."""
    problem = mbocp.load_problem(
        EXAMPLES / "arms" / "kinova_reach.toml", ["integrator.scheme=se1", "horizon.steps=100"]
    )
    formulation = formulate(problem)
    programme = formulation.programme
    iterate, _ = make_guess("line", formulation)
    native = kernel_programme(programme)
    iterate.load_into(native)
    native.simulate(1e-13, 50, True, False)
    native.gradient()
    assert np.abs(native.end_sensitivity()).max() > 1e20
    iterate.load_into(native)
    sweeps, outcome = init_sweeps(native, programme, loop="auto", auxiliary=False)
    assert sweeps.feedback
    assert outcome.evaluation is not None
    assert np.abs(native.end_sensitivity(True)).max() < 1e5


def test_the_loop_stays_open_where_it_can() -> None:
    held = Held("paper/elastic_pendulum", 50)
    sweeps, outcome = init_sweeps(held.native, held.programme, loop="auto", auxiliary=False)
    assert not sweeps.feedback
    assert outcome.evaluation is not None


def test_a_sweep_that_fails_says_where() -> None:
    held = Held("paper/cart_pendulum_rigid", 20)
    native = held.native
    u = native.u.copy()
    u[7] = np.nan
    native.u = u
    outcome = Sweeps().run(native)
    assert outcome.evaluation is None
    assert outcome.failed_stage == 7

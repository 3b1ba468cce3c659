"""The tolerance where the numbers of a problem are so large that round-off is above it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import mbocp
from benchmarks import gaits
from mbocp._arrays import norm
from mbocp.formulation import Formulation, formulate, transcribe
from mbocp.guesses import make_guess
from mbocp.programme.native_modules import kernel
from mbocp.solvers import GlobalisedNewton, Status

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelNewtonState, Sizes


PAPER = Path(__file__).parents[2] / "examples" / "paper"


def solved(name: str, settings: dict[str, Any]) -> tuple[mbocp.Problem, KernelNewtonState]:
    problem = mbocp.load_problem(PAPER / f"{name}.toml", settings)
    state, _ = newton(formulate(problem), problem.guess.kind if problem.guess.kind != "auto" else "line")
    return problem, state


def newton(formulation: Formulation, guess: str) -> tuple[KernelNewtonState, list[float]]:
    """Where Newton's method ends, and the costs on its way."""
    programme = formulation.programme
    iterate, _ = make_guess(guess, formulation)
    solver = GlobalisedNewton(control_weight=programme.control_weight)
    state, costs = solver.init(programme, iterate), []
    while solver.terminate(state) is None:
        state = solver.step(state)
        costs.append(state.evaluation.cost)
    return state, costs


def test_a_problem_of_large_numbers_is_solved_to_round_off() -> None:
    """Of a length: forces have a unit of their own, and would be of ordinary size."""
    settings = {"goal.q": [0.0, 0.0, -500.0], "horizon.steps": 40}
    s = mbocp.solve(mbocp.load_problem(PAPER / "elastic_pendulum.toml", settings))
    assert s.converged, s.advice
    assert s.residual > 1e-9  # as it is, not scaled
    assert "round-off" in s.advice
    assert s.residual < 1e-13 * np.linalg.norm(s.mus)
    assert s.constraint_violation < 1e-9


def test_a_step_further_changes_the_motion_by_round_off_alone() -> None:
    _, state = solved("rigid_pendulum", {"horizon.duration": 0.01})
    native = state.native
    assert is_resolved(state)
    x, u = native.x, native.u
    native.evaluate()
    assert native.factorise(0.0, state.augmentation).ok
    assert native.solve().finite
    assert np.linalg.norm(native.dx) < 1e-12 * np.linalg.norm(x)
    assert np.linalg.norm(native.du) < 1e-12 * np.linalg.norm(u)
    assert np.linalg.norm(native.dm) < 1e-12 * np.linalg.norm(native.m)


@pytest.mark.parametrize("name", ["elastic_pendulum", "rigid_pendulum", "cart_pendulum_rigid"])
def test_problems_of_ordinary_size_know_the_tolerance_alone(name: str) -> None:
    _, state = solved(name, {})
    assert state.evaluation.residual <= 1e-9
    assert min(state.increment, state.next_increment) <= 1e-9
    assert largest(state.native.round_off()) < 1e-11
    assert not is_resolved(state)


@pytest.mark.parametrize(
    "name", ["elastic_pendulum", "rigid_pendulum", "../arms/ur5_reach", "../arms/panda_reach"]
)
def test_the_step_that_was_foreseen_and_not_taken_is_far_below_the_tolerance(name: str) -> None:
    _, state = solved(name, {})
    assert state.evaluation.residual <= 1e-11
    assert state.increment > 1e-9 >= state.next_increment  # it ends by what it foresees
    further = GlobalisedNewton().step(state)
    assert further.increment < 1e-10


def test_a_tolerance_below_the_round_off_of_increments_ends_by_round_off() -> None:
    """Steps among round-off are refused, and no shift helps."""
    settings = {"horizon.steps": 1000, "solver.tolerance": 1e-12, "solver.method": "monolithic"}
    s = mbocp.solve(mbocp.load_problem(PAPER / "elastic_pendulum.toml", settings))
    assert s.converged, s.advice
    assert s.iterations <= 10
    assert all(record.regularisation == 0.0 for record in s.history)
    assert s.residual < 1e-12


@pytest.mark.parametrize("length", [1, 100, 10_000, 1_000_000])
@pytest.mark.parametrize(
    ("residual", "step", "expected"),
    [
        (1e-12, 3e-9, True),
        (1e-11, 3e-9, False),  # above round-off, and far below the tolerance
        (1e-12, 3e-6, False),  # not yet there, relative to the unknowns
    ],
)
def test_long_horizons_end_when_short_ones_do(
    length: int, residual: float, step: float, expected: bool
) -> None:
    """Norms of the same motion in more steps are larger by a root, those of its round-off, too."""
    scale, size, contraction, tolerance = np.sqrt(length), 1e3, 1e-3, 1e-9
    ended = kernel().is_at_rest(
        scale * residual,
        8.0 * 2.0**-52 * size * scale,
        contraction * step * scale,
        contraction * step / size,
        tolerance,
    )
    assert ended == expected


def chain(links: int, length: float, mass: float) -> str:
    """Links on hinges about one axis, as a URDF."""
    own = mass * length**2 / 12.0
    text = '<robot name="chain"><link name="base"/>'
    for i in range(links):
        before, down = ("base", 0.0) if i == 0 else (f"l{i - 1}", -length)
        text += f"""<link name="l{i}"><inertial><origin xyz="0 0 {-length / 2}"/><mass value="{mass}"/>
          <inertia ixx="{own}" iyy="{own}" izz="{own}" ixy="0" ixz="0" iyz="0"/></inertial></link>
          <joint name="j{i}" type="continuous"><parent link="{before}"/><child link="l{i}"/>
          <origin xyz="0 0 {down}"/><axis xyz="0 1 0"/></joint>"""
    return text + "</robot>"


@pytest.mark.slow
def test_a_chain_ends_where_its_terms_leave_round_off(tmp_path: Path) -> None:
    """Its terms are many times its multipliers: the residual stays above the tolerance, the motion rests."""
    (tmp_path / "chain.urdf").write_text(chain(16, 0.2, 1.0))
    q = np.random.default_rng(1).uniform(-1.0, 1.0, 16)
    goal = {"q": list(q), "v": 0}
    problem = mbocp.Problem.create(str(tmp_path / "chain.urdf"), 1.0, 20, goal=goal, scheme="gauss2")
    state, costs = newton(formulate(problem), "line")
    native, e = state.native, state.evaluation
    assert GlobalisedNewton().terminate(state) is Status.CONVERGED
    assert state.iteration <= 12
    assert np.ptp(costs[-3:]) < 1e-12 * costs[-1]
    assert e.residual > max(1e-9, largest(native.round_off()))
    assert e.residual < largest(native.round_off_of_terms(e)) < 1e-10 * np.linalg.norm(native.m)


def test_each_part_of_the_residual_has_its_own_round_off() -> None:
    """Large multipliers excuse no violation of the state equations."""
    _, state = solved("rigid_pendulum", {})
    native = state.native
    native.evaluate()
    assert native.factorise(0.0, state.augmentation).ok
    assert native.solve().finite  # a direction of next to nothing
    unit = native.m / native.sizes().dual
    native.m, native.eta = 1e9 * unit, np.zeros_like(native.eta)
    allowed, dual = native.round_off(), native.sizes().dual
    assert allowed.dual == pytest.approx(8 * 2.0**-52 * dual)
    assert allowed.primal == pytest.approx(8 * 2.0**-52 * native.sizes().primal)
    below, above = 0.5 * allowed.dual, 2.0 * allowed.dual
    assert allowed.dual > 1e-9 > allowed.primal
    assert native.relative_increment() < 1e-9
    assert native.is_resolved(1e-10, below, 1.0, 1e-9)
    assert not native.is_resolved(1e-10, above, 1.0, 1e-9)
    assert not native.is_resolved(1e-8, below, 1.0, 1e-9)
    assert not native.is_resolved(1e-10, below, np.inf, 1e-9)  # before the first step
    native.m = unit
    assert not native.is_resolved(1e-10, 1e-10, 1.0, 1e-9)  # nothing is large
    assert kernel().relative_residual(allowed, 3e-3, 0.0, 1e-9) == 3e-3


def is_resolved(state: KernelNewtonState) -> bool:
    e = state.evaluation
    return state.native.is_resolved(e.primal, e.dual, state.increment, 1e-9)


def largest(sizes: Sizes) -> float:
    return max(sizes.primal, sizes.dual)


@pytest.mark.parametrize("scale", [1.0, 1e-170, 1e170, 0.0, np.inf, np.nan])
def test_sizes_of_the_unknowns_are_norms_also_where_squares_have_no_number(scale: float) -> None:
    problem, state = solved("rigid_pendulum", {"horizon.duration": 0.01})
    native, kind = state.native, transcribe(problem).kind
    rng = np.random.default_rng(0)
    with np.errstate(invalid="ignore"):
        for name in ("x", "u", "m", "eta"):
            setattr(native, name, scale * rng.normal(size=getattr(native, name).size))
        m = native.m.reshape(-1, kind.scale_m.size) * kind.scale_m
    sizes = native.sizes()
    assert sizes.primal == pytest.approx(np.hypot(norm(native.x), norm(native.u)), rel=1e-14, nan_ok=True)
    assert sizes.dual == pytest.approx(np.hypot(norm(m.ravel()), norm(native.eta)), rel=1e-14, nan_ok=True)


def test_multipliers_of_limits_count_among_the_sizes() -> None:
    problem = mbocp.load_problem(PAPER / "rigid_pendulum.toml", {"limits.effort": 100.0})
    formulation = formulate(problem)
    iterate, _ = make_guess("line", formulation)
    native = GlobalisedNewton().init(formulation.programme, iterate).native
    native.z_upper = native.z_upper + 1e9
    expected = norm(np.concatenate([native.limit_multipliers, native.eta]))
    assert native.sizes().dual == pytest.approx(expected, rel=1e-9)


@pytest.mark.slow
def test_a_trot_ends_where_steps_lead_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its residual at round-off is above what its terms let expect."""
    monkeypatch.setattr(gaits, "_SECONDS", 0.25)
    monkeypatch.setattr(gaits, "_FASTEST", 0.5)
    problem = gaits.gait("trot", 2, "anymal_c")
    solution = mbocp.solve(problem.with_(solver=replace(problem.solver, method="monolithic")))
    assert solution.converged
    assert solution.iterations < 50

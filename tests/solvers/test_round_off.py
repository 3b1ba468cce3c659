"""The tolerance where the numbers of a problem are so large that round-off is above it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp._linear import norm
from mbocp.formulation import Formulation, formulate
from mbocp.guesses import make_guess
from mbocp.programme.native import kernel
from mbocp.solvers import GlobalisedNewton, NewtonState, Status
from mbocp.solvers.newton_method.newton import is_resolved
from mbocp.solvers.newton_method.round_off import (
    relative_increment,
    relative_residual,
    round_off,
    round_off_of_terms,
)

pytestmark = pytest.mark.usefixtures("interpreted")

PAPER = Path(__file__).parents[2] / "examples" / "paper"
FILTER = kernel().Filter.start(0.0)


def solved(name: str, settings: dict[str, Any]) -> tuple[mbocp.Problem, NewtonState]:
    problem = mbocp.load_problem(PAPER / f"{name}.toml", settings)
    state, _ = newton(formulate(problem), problem.guess.kind if problem.guess.kind != "auto" else "line")
    return problem, state


def newton(formulation: Formulation, guess: str) -> tuple[NewtonState, list[float]]:
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
    assert is_resolved(state, 1e-9)
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
    assert max(round_off(state.native)) < 1e-11
    assert not is_resolved(state, 1e-9)


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
    scale = np.sqrt(length)
    evaluation = SimpleNamespace(residual=scale * residual, primal=0.0, dual=scale * residual)
    contraction = 1e-3
    state = NewtonState(
        stub(1e3 * scale, step * scale),
        evaluation,
        FILTER,
        increment=step * scale,
        step_length=1.0,
        contraction=contraction,
    )
    ended = GlobalisedNewton().terminate(state) is not None
    assert ended == expected


def test_residuals_above_the_tolerance_are_never_at_rest() -> None:
    evaluation = SimpleNamespace(residual=2e-9, primal=2e-9, dual=0.0)
    state = NewtonState(
        stub(1e9, 1e-12), evaluation, FILTER, increment=1e-12, step_length=1.0, contraction=1e-3, still=9
    )
    assert GlobalisedNewton().terminate(state) is None


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
    assert e.residual > max(1e-9, *round_off(native))
    assert e.residual < max(round_off_of_terms(native, e)) < 1e-10 * np.linalg.norm(native.m)


def stub(size: float, step: float) -> Any:
    """What a kernel programme shows, with multipliers of one size and a last step of another."""
    unit = np.array([1.0, 0.0])
    return SimpleNamespace(
        x=unit,
        u=unit,
        y=np.zeros(0),
        m=size * unit,
        eta=np.zeros(1),
        sizes=lambda: SimpleNamespace(primal=np.sqrt(2.0), dual=size),
        dx=0.0 * unit,
        du=0.0 * unit,
        dy=np.zeros(0),
        dm=step * unit,
        deta=np.zeros(1),
        slack=np.zeros(0),
        z_lower=np.zeros(0),
        z_upper=np.zeros(0),
        evaluate=lambda: SimpleNamespace(primal=0.0, dual=0.0),
    )


def test_each_part_of_the_residual_has_its_own_round_off() -> None:
    """Large multipliers excuse no violation of the state equations."""
    native = stub(1e9, 0.5)
    primal, dual = round_off(native)
    assert dual == pytest.approx(8 * 2.0**-52 * 1e9)
    assert primal == pytest.approx(8 * 2.0**-52 * np.sqrt(2.0))

    def state(primal: float, dual: float, step: float = 0.5) -> Any:
        evaluation = SimpleNamespace(primal=primal, dual=dual)
        return NewtonState(stub(1e9, step), evaluation, FILTER, increment=step)

    assert is_resolved(state(1e-10, 1e-6), 1e-9)
    assert not is_resolved(state(1e-10, 3e-6), 1e-9)
    assert not is_resolved(state(1e-8, 1e-7), 1e-9)
    assert not is_resolved(state(1e-10, 1e-6, step=2.0), 1e-9)
    assert relative_residual(round_off(native), SimpleNamespace(primal=3e-3, dual=0.0), 1e-9) == 3e-3
    assert relative_increment(native) == pytest.approx(0.5e-9)


@pytest.mark.parametrize("scale", [1.0, 1e-170, 1e170, 0.0, np.inf, np.nan])
def test_sizes_of_the_unknowns_are_norms_also_where_squares_have_no_number(scale: float) -> None:
    _, state = solved("rigid_pendulum", {"horizon.duration": 0.01})
    native, kind = state.native, state.kind
    assert kind is not None
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

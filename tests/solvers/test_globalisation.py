"""What keeps Newton's method on its way: cap on turns, small shifts, slacks well inside, progress by cost."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
import pytest

import mbocp
from mbocp.formulation import formulate, transcribe
from mbocp.guesses import make_guess
from mbocp.programme import StagewiseProgramme
from mbocp.programme.native_modules import kernel
from mbocp.solvers import GlobalisedNewton
from mbocp.solvers.records import IterationRecord, Status
from mbocp.solvers.strategies.auto import has_stalled, is_nearly_feasible

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelNewtonState
    from mbocp.terms import Kinematics


EXAMPLES = Path(__file__).parents[2] / "examples"
PEERS = EXAMPLES.parent / "benchmarks" / "peers" / "problems"
BOLD, CAREFUL = kernel().Care.bold(), kernel().Care.careful()


def one_motor(motor: str, start: list[float], goal: list[float], steps: int = 100) -> mbocp.Problem:
    """A double pendulum with one motor that swings from one end to the other in a second."""
    robot = mbocp.load_robot("double_pendulum", actuated=[motor], damping=False)
    return mbocp.Problem.create(
        robot,
        1.0,
        steps,
        start={"q": start},
        goal={"q": goal, "v": [0.0, 0.0]},
        cost={"effort": 1.0},
        scheme="se1",
    )


def begun(problem: mbocp.Problem) -> tuple[StagewiseProgramme, GlobalisedNewton, KernelNewtonState]:
    formulation = formulate(problem)
    programme = formulation.programme
    iterate, _ = make_guess("line", formulation)
    solver = GlobalisedNewton(control_weight=programme.control_weight)
    return programme, solver, solver.init(programme, iterate)


def test_a_large_shift_falls_fast_while_steps_are_full() -> None:
    """A penalty far from met asks for a shift that the motion after the first step no longer needs."""
    robot = mbocp.load_robot("double_pendulum")

    def missed(at: Kinematics) -> ca.SX:
        return 1e6 * (1.0 - ca.cos(at.q[0] - 2.0))

    problem = mbocp.Problem.create(
        robot,
        1.0,
        40,
        start={"q": [0.0, 0.0]},
        goal={"q": [0.5, 0.5]},
        terms=[mbocp.terms.running_cost(missed)],
        scheme="se1",
    )
    _, solver, state = begun(problem)
    first = solver.step(state)
    assert first.step_length == 1.0
    assert first.regularisation > 1e3
    second = solver.step(first)
    assert second.regularisation == pytest.approx(first.regularisation / 30.0)
    assert second.step_length < 1.0  # fast no longer
    third = solver.step(second)
    assert third.regularisation >= second.regularisation / 3.0


def test_a_shift_grows_where_the_cap_would_leave_next_to_nothing_of_a_step() -> None:
    """A Panda: shifts that just make the Hessian definite gave seven steps below a twentieth in a row."""
    s = mbocp.solve(mbocp.load_problem(PEERS / "F.toml"))
    assert s.converged
    assert s.cost == pytest.approx(295.80841, rel=1e-7)
    is_short = [record.step_length < 0.05 for record in s.history[1:]]
    assert not any(a and b and c for a, b, c in zip(is_short, is_short[1:], is_short[2:], strict=False))


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("arms/ur5_reach", [1] * 6 + [0] * 6),
        ("arms/kinova_reach", [1] * 6 + [0] * 6),
        ("paper/elastic_pendulum", [0] * 6),
        ("free_flyer/drone_flip", [0] * 12),
        ("loops/four_bar", [1] * 3 + [0] * 3),
    ],
)
def test_a_programme_says_which_unknowns_are_angles(path: str, expected: list[int]) -> None:
    programme = transcribe(mbocp.load_problem(EXAMPLES / f"{path}.toml"))
    np.testing.assert_allclose(programme.kind.turning, expected, atol=1e-15)


def test_cosine_and_sine_are_angles_in_a_flat_programme_and_quaternions_are_not() -> None:
    problem = mbocp.load_problem(EXAMPLES / "so3/unicycle_pendulum.toml")
    formulation = formulate(problem)
    turning = formulation.programme.kind.turning
    yaw = problem.robot.model.getJointId("yaw")
    assert turning[formulation.space.parts[yaw - 1].at_z] == pytest.approx(1.0)
    assert turning.sum() == pytest.approx(formulation.space.parts[yaw - 1].group.nz)


@pytest.mark.parametrize("motor", ["joint1", "joint2"])
def test_no_iteration_turns_a_joint_by_more_than_a_radian(motor: str) -> None:
    _, solver, state = begun(one_motor(motor, [0.0, 0.0], [math.pi, 0.0], 40))
    largest, was_capped = 0.0, False
    for _ in range(12):
        before = state.native.x.reshape(-1, 4)[:, :2]
        state = solver.step(state)
        if state.step_length == 0.0:
            continue  # relaxed steps taken back
        turn = float(np.abs(state.native.x.reshape(-1, 4)[:, :2] - before).max())
        full = float(np.abs(state.native.dx.reshape(-1, 4)[:, :2]).max())
        largest, was_capped = max(largest, turn), was_capped or full > 1.0 + 1e-9
    assert largest <= 1.0 + 1e-9
    assert was_capped


def test_one_motor_swings_the_pendulum_up() -> None:
    """Without the cap, and with a least shift of 1e-3, this takes 143 iterations to a cost of 0.568."""
    s = mbocp.solve(one_motor("joint1", [math.pi, 0.0], [0.0, 0.0]), solver="monolithic")
    assert s.converged, s.advice
    assert s.iterations < 60
    assert s.cost < 0.03


def test_a_swing_that_had_not_been_solved_in_all_phases() -> None:
    robot = mbocp.load_robot("double_pendulum", actuated=["joint2"], damping=False)
    problem = mbocp.Problem.create(
        robot,
        2.8900655149766044,
        77,
        goal={"q": [math.pi, 0.0], "v": [0.0, 0.0]},
        cost={"effort": 1.0},
        scheme="se1",
    )
    s = mbocp.solve(problem)
    assert s.status.is_stationary, s.advice  # a joint turns fast, which is not the solver's to judge
    plain = next(phase for phase in s.phases if phase.name == "monolithic")
    assert plain.iterations < 100  # the descent along a fading weight comes after it


def test_shifts_go_down_to_the_least_one_and_then_to_none() -> None:
    assert BOLD.larger_shift(0.0, 1e-6) == 1e-6
    assert BOLD.larger_shift(1e-3, 1e-6) == pytest.approx(8e-3)
    assert BOLD.next_shift(1e-3, 1.0, 0.5, 1e-6) == pytest.approx(1e-3 / 3.0)
    assert BOLD.next_shift(2e-6, 1.0, 0.5, 1e-6) == 0.0
    assert BOLD.next_shift(1.0, 1.0, 0.01, 1e-6) == 0.0


def test_slacks_begin_a_tenth_inside() -> None:
    limits = "limits={effort=5.3, velocity={y=6.5}}"
    problem = mbocp.load_problem(EXAMPLES / "paper/elastic_pendulum.toml", ["horizon.steps=12", limits])
    programme, _, state = begun(problem)
    bounds, native = programme.bounds, state.native
    slacks = native.slack
    lower, upper = bounds.lower[bounds.has_limit], bounds.upper[bounds.has_limit]
    room = 0.1 * np.minimum(upper - lower, np.maximum(1.0, np.abs(upper)))
    assert np.all(slacks >= lower + room * (1.0 - 1e-12))
    assert np.all(slacks <= upper - room * (1.0 - 1e-12))


def records(residuals: list[float], costs: list[float], primal: float = 0.0) -> list[IterationRecord]:
    return [
        IterationRecord(i, r, cost=c, primal=primal, dual=r)
        for i, (r, c) in enumerate(zip(residuals, costs, strict=True))
    ]


def test_a_falling_cost_is_progress_as_a_falling_residual_is() -> None:
    flat, falling = [1.0] * 80, list(np.geomspace(1.0, 1e-2, 80))
    assert has_stalled(records(flat, flat))
    assert not has_stalled(records(falling, flat))
    assert not has_stalled(records(flat, falling))
    assert not has_stalled(records(flat[:40], flat[:40]))  # too early to tell


def test_a_cost_that_falls_while_constraints_are_given_up_is_no_progress() -> None:
    flat, falling = [1.0] * 80, list(np.geomspace(1.0, 1e-2, 80))
    history = records(flat, falling)
    away = [IterationRecord(r.iteration, 1.0, cost=r.cost, primal=0.01 * r.iteration) for r in history]
    assert has_stalled(away)


def test_what_is_infeasible_from_one_guess_is_not_asked_of_ipopt_from_the_next(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Arithmetic says so here; a search has to where none does."""
    problem = mbocp.Problem.create(
        "double_pendulum",
        1.0,
        12,
        goal={"q": [2.0, 0.0], "v": [0.0, 0.0]},
        limits={"velocity": 1.0},
        scheme="se1",
    )
    told = mbocp.solve(problem)
    assert told.status is Status.INFEASIBLE, told.advice
    assert not any(phase.name.startswith("ipopt") for phase in told.phases)
    monkeypatch.setattr("mbocp.problem.reasons.causes.why_in_vain", lambda *_: None)
    s = mbocp.solve(problem)
    assert s.status is Status.INFEASIBLE, s.advice
    of_ipopt = [phase for phase in s.phases if phase.name.startswith("ipopt")]
    of_newton = [phase for phase in s.phases if phase.name.startswith("monolithic")]
    assert len(of_ipopt) == 1
    assert len(of_newton) > 1
    assert s.iterations == sum(phase.iterations for phase in s.phases)


def test_a_slow_descent_from_a_saddle_gets_more_iterations() -> None:
    flat = [1.0] * 120
    slow = list(1.0 - 1e-5 * np.arange(120))  # 4e-4 in forty iterations
    near = [IterationRecord(i, 1.0, cost=c, primal=1.0 if i == 0 else 0.01) for i, c in enumerate(slow)]
    far = [replace(r, primal=1.0) for r in near]
    assert not has_stalled(near[:90])
    assert has_stalled(near)  # not for ever
    assert has_stalled(far[:90])
    assert has_stalled(records(flat[:90], flat[:90]))  # at rest
    assert is_nearly_feasible(near)
    assert not is_nearly_feasible(far)


def test_one_step_that_violates_more_does_not_hide_a_falling_cost() -> None:
    falling = records([1.0] * 80, list(np.geomspace(1.0, 1e-2, 80)))
    assert not has_stalled([*falling[:-1], replace(falling[-1], primal=0.9)])


def test_careful_shifts_grow_by_smaller_factors() -> None:
    assert CAREFUL.larger_shift(1e-3, 1e-6) < BOLD.larger_shift(1e-3, 1e-6)


def test_a_short_step_leads_to_a_shift_that_changes_the_next_one() -> None:
    assert BOLD.next_shift(0.0, 0.1, 0.5, 1e-6) == 1e-2
    assert BOLD.next_shift(1.0, 0.1, 0.5, 1e-6) == 2.0


def solved(file: Path) -> KernelNewtonState:
    """Where the solver ends, from a motion that stays where it starts."""
    formulation = formulate(mbocp.load_problem(file))
    iterate, _ = make_guess("hold", formulation)
    solver = GlobalisedNewton(control_weight=formulation.programme.control_weight)
    state = solver.init(formulation.programme, iterate)
    while solver.terminate(state) is None:
        state = solver.step(state)
    assert solver.terminate(state) is Status.CONVERGED
    return state


def test_the_first_shift_is_found_in_few_factorisations() -> None:
    """A Z1 whose Hessian is indefinite in the third iteration, by a control weight or so."""
    state = solved(PEERS / "Z.toml")
    assert state.factorisations <= state.iteration + 5  # ten for that shift alone where it grew eightfold
    assert BOLD.regrown_shift(0.0, 0.0, 1e-6) == 1e-2
    assert BOLD.regrown_shift(1e-2, 0.0, 1e-6) == pytest.approx(0.3)


def test_multipliers_that_no_shift_makes_up_for_are_forgotten() -> None:
    """They make the Hessian indefinite by more than the largest shift: this ended as singular."""
    problem = one_motor("joint1", [0.0, 0.0], [0.3, 0.0], 20)
    programme, solver, _ = begun(problem)
    guess, _ = make_guess("line", formulate(problem))
    wild = 1e14 * np.random.default_rng(0).standard_normal(guess.ms.shape)
    state = solver.init(programme, replace(guess, ms=wild))
    while solver.terminate(state) is None:
        state = solver.step(state)
    assert solver.terminate(state) is Status.CONVERGED


def test_steps_far_astray_get_no_correction() -> None:
    """On this Panda's motion at most half of the steps do."""
    state = solved(PEERS / "F.toml")
    assert 1 <= state.corrections <= state.iteration / 2


def test_only_a_definite_system_is_factorised_again_for_its_conditioning() -> None:
    """No weight of the end condition changes the inertia, and a shift is what follows."""
    _, solver, state = begun(one_motor("joint1", [math.pi, 0.0], [0.0, 0.0], 40))
    native, weight, least = state.native, 1e-6, 1e-3
    once, well = native.factorise(0.0, weight), native.factorise_well(0.0, weight)
    assert once.negative == native.num_end_conditions
    assert once.end_condition < least < well.end_condition
    assert well.augmentation > weight
    solver.step(state)
    once, well = native.factorise(0.0, weight), native.factorise_well(0.0, weight)
    assert once.negative > native.num_end_conditions
    assert once.end_condition < least
    assert well.augmentation == weight

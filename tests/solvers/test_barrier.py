"""The barrier inside the structured Newton step: its derivatives, its parameter, and what it refuses."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import ProblemError
from mbocp.formulation import formulate
from mbocp.guesses import make_guess
from mbocp.programme import StagewiseProgramme
from mbocp.programme.kernel import kernel_programme
from mbocp.programme.native_modules import kernel
from mbocp.solvers import GlobalisedNewton

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelNewton, KernelNewtonState


PAPER = Path(__file__).parents[2] / "examples" / "paper"
UNICYCLE = PAPER.parent / "so3" / "unicycle_pendulum.toml"
TALL = 'path=[{frame="pendulum", kind="distance", point=[0, 0, 3], min=0.5}]'
LIMITS = "limits={effort=5.3, velocity={y=6.5}, position={z=[-11.3, 100]}}"
PATH = (
    'path=[{name="leash", kind="distance", frame="bob", point=[0, 0, 0], min=3, max=11.5}, '
    '{name="calm", kind="speed", frame="bob", max=7}]'
)


# Without the damping of its URDF.
ARM = """
robot = { name = "double_pendulum", damping = false }
goal = { q = [1.2, -0.8], v = [0, 0] }
integrator.scheme = "se1"
[horizon]
duration = 1.0
steps = 20
"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """A double pendulum that is lifted."""
    path = tmp_path / "arm.toml"
    path.write_text(ARM)
    return path


def begun(
    *settings: str, path: Path = PAPER / "elastic_pendulum.toml"
) -> tuple[StagewiseProgramme, GlobalisedNewton, KernelNewtonState]:
    problem = mbocp.load_problem(path, ["horizon.steps=12", *settings])
    formulation = formulate(problem)
    programme = formulation.programme
    iterate, _ = make_guess("line", formulation)
    solver = GlobalisedNewton(control_weight=programme.control_weight)
    return programme, solver, solver.init(programme, iterate)


def newton(solver: GlobalisedNewton) -> KernelNewton:
    """The kernel's method with the settings of a solver."""
    return kernel().Newton(
        tolerance=solver.tolerance,
        max_iterations=solver.max_iterations,
        control_weight=solver.control_weight,
        is_careful=False,
        rough=0.0,
    )


def fields(native: Any) -> dict[str, np.ndarray]:
    names = ("x", "y", "u", "m", "eta", "slack", "z_lower", "z_upper")
    return {name: getattr(native, name) for name in names}


def test_a_barrier_without_limits_weighs_nothing(arm: Path) -> None:
    formulation = formulate(mbocp.load_problem(arm))
    iterate, _ = make_guess("line", formulation)
    for has_limits in (False, True):
        native = kernel_programme(formulation.programme, has_limits=has_limits)
        iterate.load_into(native)
        evaluated, weighed = native.evaluate(), native.weigh(0.1)
        assert native.num_limits == 0
        assert weighed.residual == evaluated.residual > 0.0
        assert weighed.objective == evaluated.cost


@pytest.mark.parametrize("scheme", ["se1", "midpoint", "rk4"])
@pytest.mark.parametrize("setting", [LIMITS, PATH], ids=["limits", "path"])
def test_newtons_method_on_the_barrier_problem_is_of_second_order(scheme: str, setting: str) -> None:
    """Every derivative has its part in that: one that is wrong leaves an error of first order."""
    _, solver, state = begun(setting, f"integrator.scheme={scheme}")
    native, mu = state.native, 1e-2
    solver = replace(
        solver, tolerance=10.0 * mu * np.sqrt(native.num_limits)
    )  # mu falls to this and no further
    while state.evaluation.barrier_error > 1e-10:
        state = solver.step(state)
        assert state.iteration < 60
    assert state.barrier == pytest.approx(mu)
    solved, rng = fields(native), np.random.default_rng(0)
    noise = {name: rng.standard_normal(value.size) for name, value in solved.items()}
    noise["x"][: native.x.size // (native.num_stages + 1)] = 0.0  # the start is given
    bounded = {"z_lower": 0.1, "z_upper": 0.1, "slack": 1e-3}
    errors = []
    for size in (1e-3, 5e-4):
        for name, value in solved.items():
            scale = bounded.get(name, 1.0) * (value if name.startswith("z_") else 1.0)
            setattr(native, name, value + size * scale * noise[name])
        native.evaluate()
        native.weigh(mu)
        assert native.factorise(0.0, state.augmentation).ok
        assert native.solve().finite
        native.move(1.0)
        native.accept(1.0, 1.0)
        native.evaluate()
        errors.append(native.weigh(mu).barrier_error)
    order = np.log2(errors[0] / errors[1])
    assert 1.7 < order < 2.6, (errors, order)


def test_derivatives_do_not_pile_up() -> None:
    """At the last node guards and path functions meet; evaluated again, everything is as it was."""
    settings = ["horizon.steps=8", "robot.rotations=dcm", "integrator.lie=plain", TALL]
    programme, solver, state = begun(*settings, path=UNICYCLE)
    assert programme.num_guards
    assert programme.bounds.nh
    native = solver.step(solver.step(state)).native
    directions = []
    for _ in range(3):
        native.evaluate()
        assert native.factorise(1.0, state.augmentation).ok
        assert native.solve().linear_residual < 1e-8
        directions.append((native.dx, native.du, native.dm))
    for later in directions[1:]:
        for a, b in zip(directions[0], later, strict=True):
            assert np.array_equal(a, b)


def test_steps_stay_inside_and_the_direction_solves_its_system() -> None:
    programme, solver, state = begun(LIMITS, PATH)
    native, bounds = state.native, programme.bounds
    for _ in range(8):
        state = solver.step(state)
        assert state.failure is None
        native.factorise(1e-2, state.augmentation)
        assert native.solve().linear_residual < 1e-9
        assert native.z_lower.min() >= 0.0
        assert native.z_upper.min() >= 0.0
        controls = native.slack.reshape(native.num_stages, -1)[:, 2:5]
        assert (bounds.u_lower < controls).all()
        assert (controls < bounds.u_upper).all()


def test_the_barrier_falls_and_ends_below_the_tolerance() -> None:
    _, solver, state = begun(LIMITS)
    barriers = [state.barrier]
    while solver.terminate(state) is None:
        state = solver.step(state)
        barriers.append(state.barrier)
    assert min(barriers) == barriers[-1] < 1e-9 < barriers[0]
    assert state.evaluation.complementarity <= 0.2 * solver.tolerance
    assert state.evaluation.residual <= solver.tolerance
    assert newton(solver).update_barrier(state).barrier == state.barrier


@pytest.mark.parametrize("setting", [LIMITS, PATH], ids=["limits", "path"])
def test_a_barrier_that_is_fixed_at_the_guess_is_the_first_one_and_only_falls(setting: str) -> None:
    """A run without free parameters is as if there had never been any."""
    _, solver, begin = begun(setting)
    state = newton(solver).fix_barrier(newton(solver).update_barrier(begin))
    assert state.barrier == begin.barrier
    assert state.filter.most_violation == begin.filter.most_violation
    assert state.filter.num_corners == 0
    assert not state.may_stop
    barriers = [state.barrier]
    while solver.terminate(state) is None:
        state = solver.step(state)
        barriers.append(state.barrier)
    assert all(after <= before for before, after in pairwise(barriers))
    assert state.failure is None


def test_another_right_hand_side_needs_no_other_factors() -> None:
    """The matrix does not depend on the barrier parameter."""
    _, solver, state = begun(LIMITS, PATH)
    native = solver.step(solver.step(state)).native
    for mu in (0.0, 1e-3, 0.5):
        native.weigh(mu)
        native.factorise(1.0, state.augmentation)
        native.solve()
        wanted = [native.dx, native.du, native.dm]
        native.weigh(0.1)
        native.factorise(1.0, state.augmentation)
        native.aim(mu)
        found = native.solve()
        assert found.linear_residual < 1e-9
        for a, b in zip([native.dx, native.du, native.dm], wanted, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-7 * np.abs(b).max())


def test_the_corrected_step_makes_up_for_products_of_the_first_one() -> None:
    """With (d, z) distances and multipliers, d z + d dz + z dd = mu - dd' dz', ' the step without barrier."""
    _, solver, state = begun("limits={effort=5.3}")
    while state.evaluation.residual > 10.0:
        state = solver.step(state)
    native, mu = state.native, 1e-2
    changes = []
    kept, size = fields(native), 1e-9  # short enough that nothing is cut
    for is_curved in (None, False, True):
        native.evaluate()
        native.aim(0.0)
        native.factorise(1.0, state.augmentation)
        native.solve()
        if is_curved is not None:
            native.aim(mu, is_curved)
            native.solve()
        native.move(size)
        native.accept(size, size)
        changes.append(((native.slack - kept["slack"]) / size, (native.z_lower - kept["z_lower"]) / size))
        for name, value in kept.items():
            setattr(native, name, value)
    slack, z_lower = kept["slack"], kept["z_lower"]
    distance = slack + 5.3
    (ds0, _), plain, curved = changes
    dz0 = -z_lower * (1.0 + ds0 / distance)
    for (ds, dz), wanted in ((plain, mu), (curved, mu - ds0 * dz0)):
        np.testing.assert_allclose(
            distance * z_lower + distance * dz + z_lower * ds, wanted, rtol=1e-3, atol=1e-4
        )
    assert np.abs(ds0 * dz0).max() > 1e-2


def test_slacks_in_the_way_of_a_step_stop_at_their_bounds_each_by_itself() -> None:
    _, solver, state = begun("limits={effort=5.3}")
    native = solver.step(state).native
    native.factorise(1.0, state.augmentation)
    longest = native.solve().longest
    assert longest < 1.0
    kept, rest, moved = fields(native), 1e-2, {}
    before = kept["slack"]
    for length in (1e-9, longest, 1.0):
        native.move(length)
        native.accept(length, 0.0)
        moved[length] = native.slack
        for name, value in kept.items():
            setattr(native, name, value)
        native.evaluate()
        native.factorise(1.0, state.augmentation)
        native.solve()
    step = (moved[1e-9] - before) / 1e-9
    np.testing.assert_allclose(moved[longest], before + longest * step, rtol=1e-4, atol=1e-4)
    least, most = -5.3 + rest * (before + 5.3), 5.3 - rest * (5.3 - before)
    wanted = np.clip(before + step, least, most)
    assert (wanted != before + step).any()
    assert np.isclose(wanted, before + step).any()
    np.testing.assert_allclose(moved[1.0], wanted, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("name", "most"), [("U-lim", 14), ("F-lim", 30)])
def test_the_peers_problems_within_limits_take_few_iterations(name: str, most: int) -> None:
    """With fixed parameters alone, and steps cut by the first limit in the way, they took 17 and 38."""
    solution = mbocp.solve(PAPER.parents[1] / "benchmarks" / "peers" / "problems" / f"{name}.toml")
    assert solution.converged
    assert solution.iterations <= most


def test_a_guess_outside_its_limits_is_no_obstacle() -> None:
    """Slacks are inside from the beginning; the controls of the straight line need not be."""
    _, solver, state = begun("limits={effort=5.3}")
    native = state.native
    outside = native.u.copy()
    outside[:] = 40.0
    native.u = outside
    native.start_limits(state.barrier)
    state = newton(solver).resume(native, state.augmentation, state.barrier, is_free=True)
    while solver.terminate(state) is None:
        state = solver.step(state)
    assert str(solver.terminate(state)) == "converged"
    assert np.abs(native.u).max() <= 5.3


def test_the_kernel_refuses_what_is_no_limit() -> None:
    programme, _, _ = begun(LIMITS)
    native = kernel_programme(programme)
    bounds = programme.bounds
    sides = {name: getattr(bounds, name)[0] for name in bounds.__dataclass_fields__}
    rest = {"path": None, "path_values": None, "num_guards": 0, "guard": None}
    with pytest.raises(ValueError, match="wrong length"):
        native.set_limits(**{**sides, "u_lower": bounds.u_lower[0, :1]}, **rest)
    with pytest.raises(ValueError, match="no room"):
        native.set_limits(**{**sides, "u_lower": bounds.u_upper[0] + 1.0}, **rest)
    with pytest.raises(ValueError, match="path functions are missing"):
        native.set_limits(**{**sides, "path_lower": np.zeros(1), "path_upper": np.ones(1)}, **rest)


def test_natural_coordinates_keep_limits_of_controls(arm: Path) -> None:
    problem = mbocp.load_problem(arm, ["coordinates=natural", "limits={effort=0.5}"])
    own, ipopt = (mbocp.solve(problem, solver=solver) for solver in ("monolithic", "ipopt"))
    assert own.is_stationary
    assert ipopt.is_stationary
    assert own.active_limits
    assert own.limit_violation == 0.0
    assert own.cost == pytest.approx(ipopt.cost, rel=1e-7)
    np.testing.assert_allclose(own.lam_us, ipopt.lam_us, atol=1e-4 * np.abs(ipopt.lam_us).max())


def test_natural_coordinates_leave_path_constraints_to_others(arm: Path) -> None:
    wall = 'path=[{frame="link2", kind="position", z=[-9, 9]}]'
    problem = mbocp.load_problem(arm, ["coordinates=natural", wall])
    with pytest.raises(ProblemError, match='natural coordinates; take "ipopt" or "fatrop"'):
        mbocp.solve(problem, solver="monolithic")
    s = mbocp.solve(problem, solver="auto", check=True)
    assert s.solver == "auto: IPOPT"


def fastest(*settings: str, path: Path) -> mbocp.Problem:
    """An arm in minimum time with next to no cost of effort; its accelerations take little torque."""
    return mbocp.load_problem(
        path,
        [
            "start.q=[-0.75, -0.31]",
            "goal.q=[1.31, -0.36]",
            "horizon={duration={min=0.1, max=20.0}, steps=40}",
            "cost={time=1.0, effort=1e-5}",
            "limits={effort=200.0, velocity=3.0, acceleration=[10.0, 5.0]}",
            "integrator.scheme=midpoint",
            "solver.method=monolithic",
            *settings,
        ],
    )


def test_limits_that_outweigh_a_small_cost_by_round_off_end_with_a_larger_barrier(arm: Path) -> None:
    """With the least barrier the system is singular to working precision: 400 iterations came to no end."""
    tolerance = 1e-9
    problem = fastest(path=arm)
    found = mbocp.solve(problem)
    assert found.is_stationary
    assert found.iterations < 60
    assert found.limit_violation == 0.0
    residual = found.history[-1].residual
    assert tolerance < residual < 1e-7
    assert "round-off" in found.advice
    # The first joint takes as long at best: 2.06 rad at 10 rad/s^2 and 3 rad/s.
    assert found.duration == pytest.approx(2.06 / 3.0 + 3.0 / 10.0, rel=2e-3)
    assert found.history[-1].primal <= tolerance


def test_a_barrier_is_raised_to_the_tolerance_at_most(arm: Path) -> None:
    _, solver, first = begun(LIMITS)
    rules, native = newton(solver), first.native
    most = solver.tolerance * max(1.0, abs(first.evaluation.cost))
    assert rules.raise_barrier(first).barrier == first.barrier  # a first barrier is larger

    def with_barrier(barrier: float) -> KernelNewtonState:
        native.weigh(barrier)
        return rules.resume(native, first.augmentation, barrier, is_free=True)

    once = rules.raise_barrier(with_barrier(1e-12))
    assert once.barrier == once.least_barrier == pytest.approx(1e-11)
    assert not once.may_stop
    last = rules.raise_barrier(with_barrier(0.5 * most))
    assert last.barrier == most
    assert rules.raise_barrier(last).barrier == most
    assert rules.raise_barrier(with_barrier(0.0)).least_barrier == 0.0
    once = rules.raise_barrier(with_barrier(1e-12))
    assert rules.update_barrier(once).barrier >= once.least_barrier

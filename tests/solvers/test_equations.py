"""Rows at some nodes only, and rows that are equations, in the structured Newton step."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mbocp
from mbocp.exceptions import ProblemError
from mbocp.formulation import formulate
from mbocp.guesses import make_guess
from mbocp.programme import StagewiseProgramme
from mbocp.programme.kernel import kernel_programme
from mbocp.solution import Solution
from mbocp.solvers import GlobalisedNewton
from mbocp.terms import OwnTerm, path_constraint

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelNewtonState


FILE = Path(__file__).parents[2] / "examples" / "paper" / "elastic_pendulum.toml"
STEPS = 20
VIA = 'path=[{frame="bob", kind="position", x=[1, 1], y=[-4, -4], z=[-7, -7], from=2.5, until=2.5}]'
LEASH = 'path=[{frame="bob", kind="distance", point=[0, 0, 0], min=8, max=8, from=1.5, until=3.5}]'
CALM = 'path=[{frame="bob", kind="speed", max=4, from=2, until=3}]'


def load(*changes: str, terms: tuple[OwnTerm, ...] = ()) -> Any:
    return mbocp.load_problem(FILE, [f"horizon.steps={STEPS}", *changes], terms=terms)


def in_plane(at: Any) -> Any:
    return 1.25 * at.q[0] + at.q[1]


def plane(**words: Any) -> OwnTerm:
    """Through start and goal, so that the last node's row repeats the goal."""
    return path_constraint(in_plane, name=words.pop("name", "plane"), **{"equals": -7.5, **words})


def begun(problem: Any) -> tuple[StagewiseProgramme, GlobalisedNewton, KernelNewtonState]:
    formulation = formulate(problem)
    programme = formulation.programme
    iterate, _ = make_guess("line", formulation)
    solver = GlobalisedNewton(control_weight=programme.control_weight)
    return programme, solver, solver.init(programme, iterate)


def solved(problem: Any, method: str = "monolithic") -> Solution:
    found = mbocp.solve(problem, solver=method)
    assert found.is_stationary, found.advice
    return found


def agree(one: Solution, other: Solution, accuracy: float) -> None:
    assert one.cost == pytest.approx(other.cost, rel=accuracy)
    for field in ("qs", "us", "mus", "eta", "lam_path"):
        a, b = getattr(one, field), getattr(other, field)
        np.testing.assert_allclose(a, b, rtol=0, atol=accuracy * (1.0 + np.abs(b).max(initial=0.0)))


@pytest.mark.parametrize("scheme", ["se1", "se2", "midpoint", "rk4"])
@pytest.mark.parametrize("setting", [VIA, LEASH, CALM], ids=["via", "sphere", "calm"])
def test_methods_agree_at_some_of_the_nodes(scheme: str, setting: str) -> None:
    problem = load(setting, f"integrator.scheme={scheme}")
    own, ipopt = solved(problem), solved(problem, "ipopt")
    agree(own, ipopt, 1e-7 if setting == CALM else 1e-8)
    assert own.lam_path.any()
    bounds = formulate(problem).programme.bounds
    free = ~bounds.has_limit[:, -bounds.nh :]
    assert not own.lam_path[free].any()
    assert own.limit_violation < 1e-9
    if setting == CALM:
        (active,) = own.active_limits
        assert 0 < active.count <= active.total == 5
    else:
        assert own.active_limits == ()  # equations are no limits


def test_fatrop_takes_rows_at_some_of_the_nodes() -> None:
    """It regularises near curved constraints, and reaches no more there."""
    for setting, accuracy in ((VIA, 1e-8), (CALM, 1e-5)):
        problem = load(setting, "solver.tolerance=1e-8")
        agree(solved(problem), solved(problem, "fatrop"), accuracy)


@pytest.mark.parametrize("words", [{}, {"equals": None, "lower": -8.0, "upper": -7.0}], ids=["=", "<"])
def test_convergence_is_quadratic_and_ends_at_round_off(words: dict[str, Any]) -> None:
    _, solver, state = begun(load("start.p=[-3, 3.75, 0]", terms=(plane(**words),)))
    residuals = []
    while solver.terminate(state) is None:
        state = solver.step(state)
        residuals.append(state.evaluation.residual)
    assert str(solver.terminate(state)) == "converged"
    assert len(residuals) < 30
    if words:
        return
    small = [r for r in residuals if r < 1e-2]
    assert small[-1] < 1e-12
    assert all(after < 100.0 * before**2 + 1e-12 for before, after in pairwise(small))


def test_rows_that_repeat_others_do_no_harm() -> None:
    """The last node's row repeats the goal; and then every row is there twice."""
    once = solved(load("start.p=[-3, 3.75, 0]", terms=(plane(),)))
    twice = solved(load("start.p=[-3, 3.75, 0]", terms=(plane(), plane(name="again"))))
    assert twice.iterations <= once.iterations + 1
    assert twice.cost == pytest.approx(once.cost, rel=1e-12)
    np.testing.assert_allclose(twice.qs, once.qs, atol=1e-9)
    inner = slice(1, -2)
    np.testing.assert_allclose(twice.lam_path.sum(axis=1)[inner], once.lam_path[inner, 0], atol=1e-8)
    assert np.abs(once.qs @ [1.25, 1.0, 0.0] + 7.5).max() < 1e-13


def test_fatrop_refuses_what_is_too_much_for_its_last_node() -> None:
    problem = load("start.p=[-3, 3.75, 0]", terms=(plane(),))
    with pytest.raises(
        ProblemError, match='"fatrop" takes at most 6 equations at the last node, got 6 of the'
    ):
        mbocp.solve(problem, solver="fatrop")
    early = load("start.p=[-3, 3.75, 0]", terms=(plane(until=4.5),))
    agree(solved(early), solved(early, "fatrop"), 1e-7)


def test_an_equation_is_the_limit_of_a_narrow_box() -> None:
    kept = solved(load(VIA))
    errors = []
    for width in (1e-2, 1e-3, 1e-4):
        box = "path=[{frame='bob', kind='position', from=2.5, until=2.5, "
        sides = (f"{axis}=[{b - width}, {b + width}]" for axis, b in zip("xyz", (1, -4, -7), strict=True))
        near = solved(load(box + ", ".join(sides) + "}]"))
        assert near.cost < kept.cost
        slope = np.abs(near.lam_path).sum()  # of the cost in the width
        assert kept.cost - near.cost == pytest.approx(width * slope, rel=10 * width)
        errors.append(np.abs(near.lam_path - kept.lam_path).max())
    assert errors[1] < 0.2 * errors[0]
    assert errors[2] < 0.2 * errors[1]


def test_a_span_of_all_nodes_changes_no_bit() -> None:
    whole, part = CALM.replace(", from=2, until=3", ""), CALM.replace("from=2, until=3", "from=0, until=5")
    one, other = (solved(load(text)) for text in (whole, part))
    assert one.iterations == other.iterations
    for field in ("qs", "us", "mus", "lam_path"):
        assert np.array_equal(getattr(one, field), getattr(other, field))


def directions(programme: StagewiseProgramme, *, has_limits: bool) -> list[np.ndarray]:
    native = kernel_programme(programme, has_limits=has_limits)
    rng = np.random.default_rng(3)
    native.x = rng.uniform(1.0, 2.0, native.x.size)
    native.u, native.m = rng.standard_normal(native.u.size), rng.standard_normal(native.m.size)
    if has_limits:
        native.start_limits(0.1, 0.1)
    native.evaluate()
    native.factorise(1.0, 1.0)
    native.solve()
    return [native.dx, native.du, native.dm, native.deta]


def test_rows_that_are_free_at_all_nodes_change_no_bit() -> None:
    programme = formulate(load(CALM)).programme
    unbounded = {
        name: np.full_like(side, -np.inf if name.endswith("lower") else np.inf)
        for name, side in vars(programme.bounds).items()
    }
    free = replace(programme, bounds=replace(programme.bounds, **unbounded))
    assert free.bounds.is_empty
    for a, b in zip(directions(free, has_limits=True), directions(free, has_limits=False), strict=True):
        assert np.array_equal(a, b)


@settings(max_examples=25)
@given(st.data())
def test_rows_of_the_kernel_are_those_that_are_bounded(data: st.DataObject) -> None:
    """Bounds at random nodes, some of them equations: rows, values and multipliers are in their places."""
    programme = formulate(load(CALM)).programme
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    sides = {}
    for name in ("x", "u", "path"):
        shape = getattr(programme.bounds, f"{name}_lower").shape
        lower = np.where(rng.random(shape) < 0.3, rng.uniform(-9, -5, shape), -np.inf)
        upper = np.where(rng.random(shape) < 0.3, rng.uniform(5, 9, shape), np.inf)
        is_equation = rng.random(shape) < 0.1
        value = rng.uniform(-3, 3, shape)
        sides[f"{name}_lower"] = np.where(is_equation, value, lower)
        sides[f"{name}_upper"] = np.where(is_equation, value, upper)
    programme = replace(programme, bounds=replace(programme.bounds, **sides))
    bounds, N, nx = programme.bounds, STEPS, programme.kind.nx
    formulation = formulate(load())
    iterate, _ = make_guess("line", formulation)
    native = GlobalisedNewton().init(programme, iterate).native
    lower, upper = bounds.lower[bounds.has_limit], bounds.upper[bounds.has_limit]
    is_equation = lower == upper
    assert native.num_limits == np.count_nonzero(~is_equation)
    assert native.slack.size == lower.size
    assert np.array_equal(native.slack[is_equation], lower[is_equation])
    xs, us = native.x.reshape(N + 1, nx)[1:], native.u.reshape(N, -1)
    h = np.array([np.asarray(programme.functions.function("path")(x, 0, 0, programme.theta)[0]) for x in xs])
    values = np.hstack([xs, us, h.reshape(N, -1)])[bounds.has_limit]
    inside = (values > lower) & (values < upper)
    np.testing.assert_allclose(native.slack[inside], values[inside], atol=2.0)
    # The step meets all rows to first order; where all are linear, that is all there is.
    factorisation = native.factorise(10.0, 1.0)
    assert factorisation.ok
    assert native.solve().finite


def test_a_step_meets_linear_equations() -> None:
    _, _, state = begun(load("start.p=[-3, 3.75, 0]", terms=(plane(equals=-7.4, since=1.0, until=4.0),)))
    native = state.native
    for _ in range(3):  # delta goes by what the first factorisation has found
        native.evaluate()
        assert native.factorise(1.0, state.augmentation).ok
        assert native.solve().linear_residual < 1e-9
        native.trial(0.5)
    moved = (native.x + native.dx).reshape(STEPS + 1, -1)
    held = moved[4:17, :2] @ [1.25, 1.0]
    np.testing.assert_allclose(held, -7.4, atol=1e-8)


def test_path_functions_are_not_called_where_their_rows_are_free() -> None:
    """There the logarithm has no value."""
    import casadi as ca

    def below(at: Any) -> Any:
        return ca.log(-9.0 - at.q[1])

    problem = load(terms=(path_constraint(below, lower=-9.0, since=5.0),))
    _, _, state = begun(problem)
    assert state.failure is None
    assert np.isfinite(state.evaluation.residual)
    assert state.native.num_limits == 1

"""IPOPT and fatrop find what Newton's method finds, multipliers included."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.formulation import formulate, transcribe
from mbocp.problem import Problem
from mbocp.solution import Solution
from mbocp.solvers.nlp.nlp_layout import NlpLayout
from tests.integrators.explicit import heavy_top

EXAMPLES = Path(__file__).parents[2] / "examples"
FIELDS = (
    "qs", "vs", "us", "lams", "mus", "zetas", "eta", "control_momenta", "control_hamiltonians",
)  # fmt: skip
CASES = {
    "rigid pendulum": ("paper/rigid_pendulum", "horizon.steps=20"),
    "rigid pendulum, midpoint": ("paper/rigid_pendulum", "horizon.steps=20", "integrator.scheme=midpoint"),
    "rigid pendulum, se2": ("paper/rigid_pendulum", "horizon.steps=20", "integrator.scheme=se2"),
    "rigid pendulum, rk4": ("paper/rigid_pendulum", "horizon.steps=20", "integrator.scheme=rk4"),
    "elastic pendulum": ("paper/elastic_pendulum", "horizon.steps=20"),
    "cart and rigid pendulum": ("paper/cart_pendulum_rigid", "horizon.steps=20"),
    "cart and elastic pendulum": ("paper/cart_pendulum_elastic", "horizon.steps=20"),
    "cart and elastic pendulum, rkf5": (
        "paper/cart_pendulum_elastic", "horizon.steps=20", "integrator.scheme=rkf5", "integrator.substeps=2",
    ),
    "drone": ("free_flyer/drone_flip", "horizon.steps=20", "integrator.scheme=se1"),
    "drone, midpoint": ("free_flyer/drone_flip", "horizon.steps=20", "integrator.scheme=midpoint"),
    "drone, rk4": ("free_flyer/drone_flip", "horizon.steps=20", "integrator.scheme=rk4"),
    "arm": ("arms/ur5_reach", "horizon.steps=20", "integrator.scheme=se1"),
}  # fmt: skip
SLOW = ("drone, midpoint", "drone, rk4", "cart and elastic pendulum, rkf5", "rigid pendulum, se2")


def problem_named(name: str) -> Problem:
    path, *settings = CASES[name]
    return mbocp.load_problem(EXAMPLES / f"{path}.toml", settings)


def worst(got: Solution, wanted: Solution, field: str) -> float:
    """Largest difference, relative to the largest entry or one."""
    a: Array = getattr(got, field)
    b: Array = getattr(wanted, field)
    assert a.shape == b.shape, field
    return float(np.abs(a - b).max(initial=0.0) / (1.0 + np.abs(b).max(initial=0.0)))


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in CASES]
)
def test_all_methods_agree(name: str) -> None:
    """Adjoints, constraint forces and what is conserved, in the programme on the group and in coordinates."""
    problem = problem_named(name)
    newton = mbocp.solve(problem, solver="monolithic")
    assert newton.converged, newton.advice
    for method in ("ipopt", "fatrop"):
        s = mbocp.solve(problem, solver=method)
        assert s.converged, s.advice
        assert s.solver == {"ipopt": "IPOPT", "fatrop": "fatrop"}[method]
        assert s.cost == pytest.approx(newton.cost, rel=1e-8)
        assert s.residual < 1e-7
        assert s.constraint_violation < (1e-3 if "rk" in name else 1e-8)
        for field in FIELDS:
            assert worst(s, newton, field) < 1e-7, (method, field)
        for field in ("lam_us", "lam_vs", "lam_qs"):  # there are no limits
            assert not np.any(getattr(s, field))


@cache
def top(rotations: str, lie: str, method: str) -> Solution:
    """A top that is turned over by torques, from the start that hangs."""
    robot = replace(heavy_top(), rotations=rotations)
    goal = {"q": [0.0, 0.0, 0.6, 0.8], "v": [0.0, 0.0, 0.0], "enforce": "exact"}
    problem = Problem.create(
        robot,
        1.0,
        16,
        goal=goal,
        cost={"effort": 1.0, "velocity": 0.1, "potential": 0.2, "control_rate": 1e-3},
        integrator={"scheme": "rk4", "lie": lie},
        solver={"method": method},
    )
    assert formulate(problem).layout.nz == {"quaternion": 4, "dcm": 9}[rotations]
    s = mbocp.solve(problem)
    assert s.converged, s.advice
    assert np.abs(robot.difference(goal["q"], s.q_final)).max() < 1e-8
    return s


@pytest.mark.parametrize("rotations", ["quaternion", "dcm"])
@pytest.mark.parametrize("lie", ["plain", pytest.param("baumgarte", marks=pytest.mark.slow), "munthe_kaas"])
def test_attitudes_in_all_coordinates(rotations: str, lie: str) -> None:
    """One optimum, to the error of the discretisation; for methods on the group to round-off."""
    newton = top("quaternion", "munthe_kaas", "monolithic")
    for method in ("ipopt", "fatrop", *(["monolithic"] if lie != "munthe_kaas" else [])):
        s = top(rotations, lie, method)
        same_steps = lie == "munthe_kaas"
        assert s.cost == pytest.approx(newton.cost, rel=1e-9 if same_steps else 1e-3)
        for field in FIELDS:
            if field == "qs":  # the goal's quaternion, or minus it
                turns = [heavy_top().difference(a, b) for a, b in zip(s.qs, newton.qs, strict=True)]
                assert np.abs(turns).max() < (1e-8 if same_steps else 2e-3)
            elif same_steps:
                assert worst(s, newton, field) < 1e-6, (method, field)
        if same_steps:
            assert s.manifold_drift < 1e-8  # what the solver leaves
            assert s.manifold_drift_resimulated < 1e-14
        else:
            assert s.manifold_drift > 1e-9
            assert s.manifold_drift_resimulated == pytest.approx(s.manifold_drift, rel=1e-4)


def test_steps_become_gaps_for_fatrop_alone() -> None:
    implicit = transcribe(problem_named("rigid pendulum").with_(solver=_options("ipopt")))
    explicit = transcribe(problem_named("rigid pendulum, rk4").with_(solver=_options("ipopt")))
    assert not NlpLayout.of(implicit, wants_gaps=False).is_lifted
    assert NlpLayout.of(implicit, wants_gaps=True).is_lifted
    assert not NlpLayout.of(explicit, wants_gaps=True).is_lifted


def _options(method: str) -> mbocp.problem.SolverOptions:
    return mbocp.problem.SolverOptions(method=method)


@pytest.mark.parametrize("method", ["fbsm_newton", "fbsm_bb+monolithic"])
def test_sweeps_run_along_explicit_schemes(method: str) -> None:
    for rotations, lie in (("quaternion", "munthe_kaas"), ("dcm", "plain")):
        newton = top(rotations, lie, "monolithic")
        assert top(rotations, lie, method).cost == pytest.approx(newton.cost, rel=1e-9)


def test_a_warm_start_begins_where_a_solve_ended() -> None:
    problem = problem_named("rigid pendulum")
    first = mbocp.solve(problem, solver="ipopt")
    again = mbocp.solve(problem, solver="fatrop", warm_start=first)
    assert again.converged
    assert again.iterations <= first.iterations
    assert again.cost == pytest.approx(first.cost, rel=1e-10)

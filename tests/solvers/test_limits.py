"""Limits and path constraints through every interior-point method and scheme: kept, and priced alike.

What multipliers mean, and whole examples, are in `tests/test_limits.py`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import ProblemError
from mbocp.formulation import transcribe
from mbocp.problem import Problem
from mbocp.solution import Solution
from mbocp.solvers import Status
from tests.integrators.explicit import hector

FILE = Path(__file__).parents[2] / "examples" / "paper" / "elastic_pendulum.toml"
LIMITS = "limits={effort=5.3, velocity={y=6.5}, position={z=[-11.3, 100]}}"
BOX = '{name="box", kind="position", frame="bob", z=[-11.3, inf]}'
LEASH = '{name="leash", kind="distance", frame="bob", point=[0, 0, 0], min=3, max=11.5}'
CALM = '{name="calm", kind="speed", frame="bob", max=7}'
PATH = f"path=[{BOX}, {LEASH}, {CALM}]"
# fatrop regularises near curved constraints, and reaches no more.
TOLERANCE = {"monolithic": 1e-9, "ipopt": 1e-9, "fatrop": 1e-7}


def solved(method: str, *settings: str, is_left: bool = False) -> Solution:
    """Solve with settings; `is_left`: limits are left between nodes, where explicit steps have no rows."""
    tolerance = f"solver.tolerance={TOLERANCE[method]}"
    s = mbocp.solve(mbocp.load_problem(FILE, ["horizon.steps=20", tolerance, *settings]), solver=method)
    assert s.status is (Status.UNDER_RESOLVED if is_left else Status.CONVERGED), s.advice
    assert ("between nodes the path constraint" in s.advice) == is_left
    assert s.limit_violation <= 1e-8
    return s


@pytest.mark.parametrize("scheme", ["se1", "se2", "midpoint", "rk4"])
@pytest.mark.parametrize("setting", [LIMITS, PATH], ids=["limits", "path"])
def test_methods_agree_where_inequalities_are_active(scheme: str, setting: str) -> None:
    integrator = f"integrator.scheme={scheme}"
    is_left, methods = scheme == "rk4" and setting == PATH, ("ipopt", "fatrop", "monolithic")
    ipopt, *others = (solved(method, integrator, setting, is_left=is_left) for method in methods)
    assert ipopt.active_limits
    for other in others:
        touched = [{(a.kind, a.name, a.side) for a in s.active_limits} for s in (ipopt, other)]
        assert touched[0] == touched[1]
        assert other.cost == pytest.approx(ipopt.cost, rel=1e-6)
        for field in ("us", "qs", "mus", "eta", "lam_us", "lam_vs", "lam_qs", "lam_path"):
            a, b = getattr(ipopt, field), getattr(other, field)
            assert np.allclose(a, b, rtol=0, atol=2e-4 * (1.0 + np.abs(a).max(initial=0.0))), field
    free = mbocp.solve(mbocp.load_problem(FILE, ["horizon.steps=20", integrator]), solver="monolithic")
    assert free.cost < ipopt.cost


@pytest.mark.parametrize("method", list(TOLERANCE))
def test_multipliers_are_signed_and_complementary(method: str) -> None:
    """Positive at an upper bound, negative at a lower one, and nothing away from both."""
    s = solved(method, LIMITS)
    problem = mbocp.load_problem(FILE, [LIMITS])
    bounds = problem.limits
    for lam, values, lower, upper in (
        (s.lam_us, s.us, bounds.u_lower, bounds.u_upper),
        (s.lam_vs[1:], s.vs[1:], bounds.v_lower, bounds.v_upper),
        (s.lam_qs[1:], s.qs[1:], bounds.q_lower, bounds.q_upper),
    ):
        distance = np.where(lam > 0.0, upper - values, values - lower)
        product = np.where(lam == 0.0, 0.0, np.abs(lam) * np.where(np.isfinite(distance), distance, 1.0))
        assert product.max() < 1e-5
        assert distance[lam != 0.0].min(initial=0.0) > -1e-8
    assert not np.any(s.lam_vs[0])
    assert not np.any(s.lam_qs[0])  # the start is given
    touched = {(a.kind, a.name, a.side) for a in s.active_limits}
    assert touched == {
        ("control", "y", "lower"),
        ("control", "z", "upper"),
        ("velocity", "y", "lower"),
        ("position", "z", "lower"),
    }
    assert s.lam_us[:, 1].min() < -1e-2 < 1e-2 < s.lam_us[:, 2].max()


@pytest.mark.parametrize("method", list(TOLERANCE))
def test_path_constraints_are_kept_and_active(method: str) -> None:
    s = solved(method, PATH)
    assert s.path_names == ("box.z", "leash", "calm")
    assert {(a.name, a.side, a.bound, a.unit) for a in s.active_limits} == {
        ("box.z", "lower", -11.3, "m"),
        ("leash", "upper", 11.5, "m"),
        ("calm", "upper", 7.0, "m/s"),
    }
    assert s.qs[1:, 2].min() == pytest.approx(-11.3, abs=1e-6)
    assert np.linalg.norm(s.qs[1:], axis=1).max() == pytest.approx(11.5, abs=1e-6)
    assert np.linalg.norm(s.vs[1:], axis=1).max() == pytest.approx(7.0, abs=1e-6)
    worst = np.abs(s.lam_path).argmax(axis=0)
    for column, sign in enumerate((-1.0, 1.0, 1.0)):  # lower, upper, upper
        assert sign * s.lam_path[worst[column], column] > 1e-3


@pytest.mark.parametrize("method", list(TOLERANCE))
@pytest.mark.parametrize("scheme", ["se1", "rk4"])
def test_a_free_body_within_limits(method: str, scheme: str) -> None:
    """Quaternions beside bounded positions, velocities and thrusts; the box is the position limit again."""
    turned = [0.6, 0.3, 1.0, 0.0, 0.0, 0.7071067811865476, 0.7071067811865476]
    words = {
        "goal": {"q": turned, "v": [0.0] * 6, "enforce": "exact"},
        "cost": {"effort": 1.0, "velocity": 1.0},
        "scheme": scheme,
        "solver": {"method": method, "tolerance": TOLERANCE[method]},
    }
    limits = {"effort": 30.0, "velocity": [9.0, 9.0, 0.9, 9.0, 9.0, 9.0]}
    robot = hector()
    s = mbocp.solve(
        Problem.create(robot, 1.5, 12, limits=limits, **{"integrator": {"scheme": "se1"}, **words})
    )
    assert s.status.is_stationary, s.advice  # twelve steps do not resolve every turn
    assert s.limit_violation <= 1e-8
    assert ("velocity", "root_joint.vz", "upper") in {(a.kind, a.name, a.side) for a in s.active_limits}
    assert np.abs(robot.difference(turned, s.q_final)).max() < 1e-7
    low = {
        **limits,
        "velocity": 9.0,
        "position": {"root_joint.y": [-0.01, 9.0], "root_joint.z": [-9.0, 1.0001]},
    }
    path = [{"kind": "position", "frame": "base_link", "y": [-0.01, 9.0], "z": [-9.0, 1.0001]}]
    costs = []
    for tables in ({"limits": low}, {"limits": {**limits, "velocity": 9.0}, "path": path}):
        bounded = mbocp.solve(
            Problem.create(
                robot,
                1.5,
                12,
                **{"integrator": {"scheme": "se1"}, **tables, **words},
            )
        )
        assert bounded.status.is_stationary, bounded.advice
        assert bounded.limit_violation <= 1e-8
        costs.append(bounded.cost)
    assert costs[0] == pytest.approx(costs[1], rel=1e-6)


def test_auto_takes_its_own_solver_where_there_are_inequalities() -> None:
    problem = mbocp.load_problem(FILE, ["horizon.steps=20", LIMITS])
    s = mbocp.solve(problem, solver="auto")
    assert s.converged
    assert s.solver.startswith("auto: monolithic (Newton, barrier")


def test_auto_goes_over_to_ipopt_where_its_own_solver_fails() -> None:
    """Too short for these forces: the first says what is furthest off, and the second that it cannot be."""
    settings = ["horizon.steps=20", "horizon.duration=0.3", "limits={effort=5.3}"]
    problem = mbocp.load_problem(FILE, settings)
    own = mbocp.solve(problem, solver="monolithic")
    assert own.status == "line_search_failed"
    assert "largest violation: end condition" in own.advice
    s = mbocp.solve(problem, solver="auto")
    assert s.status == "infeasible"
    assert s.solver == "auto: monolithic > monolithic without limits > monolithic > IPOPT"
    assert "; auto: monolithic " in s.advice
    assert s.iterations == sum(p.iterations for p in s.phases) > own.iterations


def test_limits_have_names_for_messages() -> None:
    programme = transcribe(mbocp.load_problem(FILE, [LIMITS, f"path=[{CALM}]"]))
    nc = programme.kind.ndx + programme.kind.ny
    words = [programme.describe_row(0, nc + i).split(" in the step")[0] for i in range(6)]
    of_controls = [f"limit of control {axis}" for axis in "xyz"]
    assert words == ["position limit of z", "velocity limit of y", *of_controls, "path constraint 'calm'"]


def test_pure_newton_keeps_no_limits() -> None:
    with pytest.raises(ProblemError, match="globalisation"):
        mbocp.load_problem(FILE, [LIMITS, "solver.method=monolithic", "solver.globalisation=none"])


def test_the_linear_solver_of_ipopt_can_be_chosen() -> None:
    automatic, mumps = solved("ipopt", LIMITS), solved("ipopt", LIMITS, "solver.linear_solver=mumps")
    assert mumps.cost == pytest.approx(automatic.cost, rel=1e-10)

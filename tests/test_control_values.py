"""`horizon.controls`: orders, limits, rates, replays, files, warm starts of controls in steps."""

from __future__ import annotations

import csv
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.formulation import formulate
from mbocp.integrators import PAIRS
from mbocp.problem import Problem
from mbocp.problem.between_nodes import GROSS_EXCESS
from mbocp.solution import Solution
from tests.formulation.stages import check_derivatives
from tests.integrators.test_orders_of_optima import order, solved, swing

EXAMPLES = Path(__file__).parents[1] / "examples"
KINDS = ("linear", "stages")


def pendulum(controls: str = "stages", scheme: str = "gauss2", steps: int = 12, **others: Any) -> Problem:
    words: dict[str, Any] = {
        "cost": {"effort": 0.1, "velocity": 1.0},
        "goal": {"q": [0.9, 0.4], "v": 0},
        **others,
    }
    return Problem.create(
        mbocp.load_robot("double_pendulum"),
        0.6,
        steps,
        start={"q": [0.3, -0.2], "v": [0.1, 0.4]},
        controls=controls,
        scheme=scheme,
        **words,
    )


def solution_of(problem: Problem, **others: Any) -> Solution:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return mbocp.solve(problem, check=True, **others)


ORDERS = [
    pytest.param("RX RY", "gauss2", "stages", 4, (5, 10, 20), id="two hinges, gauss2"),
    pytest.param("RX RY", "gauss3", "stages", 6, (6, 12, 24), id="two hinges, gauss3"),
    pytest.param("RX RY", "lobatto2", "stages", 2, (20, 40, 80), id="two hinges, lobatto2"),
    pytest.param("RX RY", "lobatto3", "stages", 4, (10, 20, 40), id="two hinges, lobatto3"),
    pytest.param("RX RY", "gauss2", "linear", 4, (10, 20, 40), id="two hinges, linear, gauss2"),
    pytest.param("RX RY", "gauss3", "linear", 4, (10, 20, 40), id="two hinges, linear, gauss3"),
    pytest.param("Spherical", "gauss2", "stages", 4, (5, 10, 20), id="SO(3), gauss2"),
    pytest.param("Spherical", "gauss2", "linear", 4, (10, 20, 40), id="SO(3), linear, gauss2"),
    pytest.param("FreeFlyer", "gauss2", "stages", 4, (5, 10, 20), id="SE(3)", marks=pytest.mark.slow),
    pytest.param("Spherical", "gauss3", "stages", 6, (4, 8, 16), id="SO(3), gauss3", marks=pytest.mark.slow),
]


@pytest.mark.parametrize(("kinds", "scheme", "controls", "expected", "steps"), ORDERS)
def test_costs_and_adjoints_have_the_order_of_the_scheme(
    kinds: str, scheme: str, controls: str, expected: int, steps: tuple[int, ...]
) -> None:
    costs, adjoints = solved(swing(kinds, scheme).with_(controls=controls), steps)
    assert order(costs) == pytest.approx(expected, abs=0.2)
    assert order(adjoints) == pytest.approx(expected, abs=0.2)


@pytest.mark.parametrize("controls", KINDS)
def test_accelerations_in_the_cost_keep_the_order(controls: str) -> None:
    """They are taken at the stages; the mean of a step would hold the cost at order two."""
    problem = swing("RX RY", "gauss2").with_(controls=controls, cost={"acceleration": 0.3})
    costs, adjoints = solved(problem, (10, 20, 40))
    assert order(costs) == pytest.approx(4.0, abs=0.25)
    assert order(adjoints) == pytest.approx(4.0, abs=0.25)


@pytest.mark.parametrize(
    ("scheme", "expected", "steps"), [("gauss2", 4, (6, 12, 24)), ("gauss3", 6, (6, 12, 24))]
)
def test_states_of_the_optimum_converge_with_the_order(
    scheme: str, expected: int, steps: tuple[int, ...]
) -> None:
    """At the nodes that all meshes have, and adjoints there, too."""
    problem, before = swing("RX RY", scheme).with_(controls="stages"), None
    states, adjoints = [], []
    for count in steps:
        before = solution_of(problem.with_(num_steps=count), warm_start=before)
        stride = count // steps[0]
        states.append(np.hstack([before.qs, before.vs])[::stride])
        adjoints.append(before.mus[::stride])
    for rows in (states, adjoints):
        first, second = (np.abs(b - a).max() for a, b in pairwise(rows))
        assert np.log2(first / second) == pytest.approx(expected, abs=0.35)


@pytest.mark.slow
def test_orders_of_a_double_pendulum() -> None:
    """It is light: coarse steps do not resolve how fast it turns."""
    before, states, adjoints = None, [], []
    for count in (40, 80, 160):
        before = solution_of(pendulum(steps=count, cost={"effort": 1.0}), warm_start=before)
        states.append(np.hstack([before.qs, before.vs])[:: count // 40])
        adjoints.append(before.mus[:: count // 40])
    for rows in (states, adjoints):
        first, second = (np.abs(b - a).max() for a, b in pairwise(rows))
        assert np.log2(first / second) == pytest.approx(4.0, abs=0.2)


@pytest.mark.slow
def test_orders_of_an_arm() -> None:
    problem = mbocp.load_problem(EXAMPLES / "arms/ur5_reach.toml").with_(scheme="gauss2", controls="stages")
    costs, adjoints = solved(problem, (100, 200, 400))
    assert order(costs) == pytest.approx(4.0, abs=0.3)
    assert order(adjoints[:, :6]) == pytest.approx(4.0, abs=0.5)


@pytest.mark.parametrize("controls", KINDS)
@pytest.mark.parametrize("scheme", [name for name, pair in PAIRS.items() if pair.num_stages > 1])
def test_solvers_agree(scheme: str, controls: str) -> None:
    file = "rigid_pendulum" if scheme.startswith("lobatto") else "elastic_pendulum"
    settings = [f"integrator.scheme={scheme}", f"horizon.controls={controls}", "horizon.steps=20"]
    problem = mbocp.load_problem(EXAMPLES / f"paper/{file}.toml", settings)
    own, other = solution_of(problem), solution_of(problem.with_(solver={"method": "ipopt"}))
    assert own.cost == pytest.approx(other.cost, rel=1e-7)
    assert np.abs(own.u_values - other.u_values).max() < 1e-3 * np.abs(own.u_values).max()
    assert own.residual < 1e-8
    if controls == "stages":
        assert own.control_momentum_drift < 1e-9
    else:  # forces along axes of the world are part of what turns
        assert own.control_momentum_names == ()


@pytest.mark.parametrize("name", ["double_pendulum", "hector"])
@pytest.mark.parametrize("controls", KINDS)
def test_derivatives_of_steps(controls: str, name: str) -> None:
    """With all that looks at controls and accelerations; also of the first step, and of free lengths."""
    robot = mbocp.load_robot(name, actuated=["root_joint"]) if name == "hector" else mbocp.load_robot(name)
    rates = {"control_rate": 0.3} if controls == "linear" else {}
    problem = Problem.create(
        robot,
        {"min": 0.5, "max": 2.0},
        6,
        goal={"v": 0},
        cost={"effort": 1.0, "acceleration": 0.2, "fuel": 0.1, "time": 1.0, **rates},
        limits={"effort": 90.0, "power": 50.0, **({"effort_rate": 300.0} if rates else {})},
        scheme="gauss2",
        controls=controls,
    )
    formulation = formulate(problem)
    for stage in (0, 3) if name == "double_pendulum" else (3,):
        check_derivatives(formulation, stage, alone=())


@pytest.mark.parametrize("scheme", ["midpoint", "gauss1"])
def test_schemes_of_one_stage(scheme: str) -> None:
    """Their controls are the same whatever they are called."""
    constant, stages = (solution_of(pendulum(kind, scheme)) for kind in ("constant", "stages"))
    assert stages.cost == constant.cost
    assert stages.has_constant_controls


@pytest.mark.parametrize("controls", KINDS)
def test_limits_hold_at_every_value(controls: str) -> None:
    free = solution_of(pendulum(controls))
    bound = 0.7 * np.abs(free.u_values).max()
    problem = pendulum(controls, limits={"effort": float(bound)})
    held, other = (mbocp.solve(problem.with_(solver={"method": method})) for method in ("auto", "ipopt"))
    assert held.is_stationary
    assert held.cost == pytest.approx(other.cost, rel=1e-6)
    assert np.abs(held.u_values).max() <= bound * (1.0 + 1e-6)
    assert np.abs(held.u_values).max() >= bound * (1.0 - 1e-4)
    assert held.limit_violation < 1e-6
    assert [limit.kind for limit in held.active_limits] == ["control"] * len(held.active_limits) != []
    assert np.abs(held.lam_us).max() > 0.0
    fine = np.abs(held.controls_at(np.linspace(0.0, held.duration, 5000))).max() / bound - 1.0
    assert held.limit_excess == pytest.approx(max(fine, 0.0), abs=2e-3)
    if controls == "linear":
        assert fine <= 1e-6
    assert held.converged == (held.limit_excess <= GROSS_EXCESS)


def test_linear_controls_are_continuous_and_have_rates() -> None:
    free = solution_of(pendulum("linear"))
    assert free.has_linear_controls
    steepest = np.abs(_slopes(free)).max()
    problem = pendulum("linear", limits={"effort_rate": float(0.5 * steepest)})
    held = solution_of(problem)
    assert np.abs(_slopes(held)).max() == pytest.approx(0.5 * steepest, rel=1e-5)
    assert held.cost > free.cost
    smooth = solution_of(pendulum("linear", cost={"effort": 0.1, "velocity": 1.0, "control_rate": 0.01}))
    assert _roughness(smooth) < _roughness(free)
    weighed = pendulum("linear", cost={"effort": 0.0, "control_rate": 0.01})
    alone = solution_of(weighed)
    own = 0.005 * np.diff(alone.t) @ (_slopes(alone) ** 2).sum(axis=1)
    assert own == pytest.approx(alone.cost, rel=1e-9)


def _slopes(solution: Solution) -> Array:
    found: Array = np.diff(solution.u_values, axis=1)[:, 0] / np.diff(solution.t)[:, None]
    return found


def _roughness(solution: Solution) -> float:
    return float(np.sum(_slopes(solution) ** 2))


@pytest.mark.parametrize(("controls", "local"), [("linear", 5), ("stages", 5)])
def test_replays_follow_the_polynomial(controls: str, local: int) -> None:
    """Local errors are those of the scheme only if the flow sees the controls that it saw."""
    problem = swing("RX RY", "gauss2").with_(controls=controls)
    coarse, fine = (solution_of(problem.with_(steps=n), accuracy=True).accuracy for n in (8, 16))
    assert np.log2(coarse.local_error / fine.local_error) == pytest.approx(local, abs=0.6)
    assert fine.replay_error < 1e-4
    assert fine.tracked_error < 1e-5


@pytest.mark.parametrize("controls", KINDS)
def test_the_first_gains_are_derivatives_of_the_first_values(controls: str) -> None:
    problem = pendulum(
        controls,
        steps=8,
        goal={"q": [0.5, 0.1], "v": 0, "enforce": "penalty"},
        cost={"effort": 0.1, "velocity": 1.0, "terminal": 30.0},
    )
    solution = solution_of(problem, gains=True)
    nv, step = problem.robot.nv, 1e-4
    nu = problem.robot.nu
    more = nu if controls == "linear" else 0
    assert solution.gains.shape == (problem.num_steps, 2 * nu, 2 * nv + more)
    if more:
        assert np.array_equal(solution.gains[1, :nu], np.eye(nu, 2 * nv + nu, 2 * nv))
    for i in range(2 * nv):
        firsts = []
        for sign in (1.0, -1.0):
            away = np.zeros(2 * nv)
            away[i] = sign * step
            q = problem.robot.integrate(problem.q_start, away[:nv])
            moved = problem.with_(q_start=q, v_start=problem.v_start + away[nv:])
            firsts.append(solution_of(moved, warm_start=solution).u_values[0].ravel())
        slope = (firsts[0] - firsts[1]) / (2.0 * step)
        np.testing.assert_allclose(
            solution.gains[0][:, i], slope, rtol=2e-4, atol=2e-5 * np.abs(solution.gains[0]).max()
        )


@pytest.mark.parametrize("controls", KINDS)
def test_results_keep_their_controls(controls: str, tmp_path: Path) -> None:
    solution = solution_of(pendulum(controls), gains=True)
    solution.save(tmp_path / "result.h5")
    loaded = Solution.load(tmp_path / "result.h5")
    assert loaded == solution
    assert loaded.u_values.shape == (12, 2, 2)
    times = np.linspace(0.0, 0.6, 41)
    assert np.array_equal(loaded.controls_at(times), solution.controls_at(times))
    again = solution_of(loaded.load_problem())
    assert again.cost == pytest.approx(solution.cost, rel=1e-12)


@pytest.mark.parametrize("controls", KINDS)
def test_tables_and_samples(controls: str, tmp_path: Path) -> None:
    solution = solution_of(pendulum(controls))
    solution.export(tmp_path / "fine.csv", rate=1000.0)
    with (tmp_path / "fine.csv").open() as file:
        rows = list(csv.reader(file))
    columns = [i for i, name in enumerate(rows[0]) if name.startswith("u:")]
    written = np.array(rows[1:], dtype=float)
    assert np.allclose(written[:, columns], solution.controls_at(written[:, 0]), atol=1e-12)
    assert np.ptp(np.diff(written[10:18, columns], axis=0), axis=0).max() < 1e-6 * np.abs(written).max()
    solution.to_csv(tmp_path / "nodes.csv")
    with (tmp_path / "nodes.csv").open() as file:
        nodes = list(csv.reader(file))
    inner = [i for i, name in enumerate(nodes[0]) if name.startswith("u@")]
    assert np.array(nodes[1][inner[0] : inner[-1] + 1], float) == pytest.approx(solution.u_values[0].ravel())
    pytest.importorskip("xarray")
    assert solution.to_xarray()["u_within"].shape == solution.u_values.shape


@pytest.mark.parametrize("before", ["constant", "linear", "stages"])
@pytest.mark.parametrize("after", ["constant", "linear", "stages"])
def test_warm_starts_from_other_controls(before: str, after: str) -> None:
    """And from other numbers of steps: Newton's method has little left to do."""
    first = solution_of(pendulum(before, steps=16))
    cold, warm = solution_of(pendulum(after)), solution_of(pendulum(after), warm_start=first)
    assert warm.cost == pytest.approx(cold.cost, rel=1e-9)
    assert warm.iterations <= cold.iterations


@pytest.mark.parametrize("controls", KINDS)
def test_steps_are_found(controls: str) -> None:
    asked = 1e-6
    problem = swing("RX RY", "gauss2").with_(controls=controls)
    found = solution_of(problem.with_(accuracy=asked))
    limit = solution_of(problem.with_(num_steps=200)).cost
    assert found.accuracy.cost_error <= asked
    assert abs(found.cost / limit - 1.0) <= asked
    constant = solution_of(problem.with_(accuracy=asked, controls="constant"))
    assert found.num_steps < constant.num_steps / 4


def test_plots_draw_the_polynomial(tmp_path: Path) -> None:
    from mbocp.view.figures.panels import control_panels

    solution = solution_of(pendulum("stages"))
    (panel,) = control_panels(solution)
    assert not panel.step
    inner = np.unique(panel.t[:-1])
    assert len(inner) > 3 * solution.num_steps
    middle = panel.t[2]
    assert panel.values[2] == pytest.approx(solution.controls_at([middle])[0])
    solution.plot(tmp_path / "plot.png")


@pytest.mark.parametrize(
    ("words", "match"),
    [
        ({"controls": "stages", "scheme": "se1"}, 'scheme "se1" takes one control for each step.*"gauss2"'),
        ({"controls": "linear", "scheme": "rk4"}, 'scheme "rk4" takes one control for each step'),
        ({"controls": "linear", "scheme": "midpoint"}, 'scheme "midpoint" takes one control for each step'),
        ({"controls": "linear", "scheme": "gauss1"}, 'scheme "gauss1" takes one control for each step'),
        ({"controls": "stages", "limits": {"effort_rate": 10.0}}, "limits.effort_rate: .*leap from step"),
        ({"controls": "stages", "cost": {"control_rate": 1.0}}, "cost.control_rate: .*leap from step"),
    ],
)
def test_what_does_not_go_together_is_refused(words: dict[str, Any], match: str) -> None:
    with pytest.raises(ProblemError, match=match):
        pendulum(**words)


def test_other_words_are_refused() -> None:
    with pytest.raises(InvalidValue, match=r"horizon\.controls.*smooth"):
        pendulum().with_(controls="smooth")


def test_phases_without_a_control_in_common() -> None:
    phases = [
        {"name": "push", "steps": 4, "duration": 0.3, "limits": {"effort": [[1.0, 5.0], [-9.0, 9.0]]}},
        {"name": "pull", "steps": 4, "duration": 0.3, "limits": {"effort": [[-5.0, -1.0], [-9.0, 9.0]]}},
    ]
    words: dict[str, Any] = {"goal": {"v": 0}, "scheme": "gauss2", "phase": phases}
    robot = mbocp.load_robot("double_pendulum")
    with pytest.raises(ProblemError, match=r"limits\.effort: .*no control in common"):
        Problem.create(robot, controls="linear", **words)
    assert (
        Problem.create(robot, controls="stages", **{"integrator": {"scheme": "se1"}, **words}).controls
        == "stages"
    )


def test_the_control_at_a_switch_of_limits_keeps_both() -> None:
    phases = [
        {"name": "strong", "steps": 6, "duration": 0.3, "limits": {"effort": 40.0}},
        {"name": "weak", "steps": 6, "duration": 0.3, "limits": {"effort": 15.0}},
    ]
    solution = solution_of(
        Problem.create(
            mbocp.load_robot("double_pendulum"),
            goal={"q": [0.6, 0.4], "v": 0},
            scheme="gauss2",
            controls="linear",
            phase=phases,
        )
    )
    assert np.abs(solution.u_values[5, 1]).max() <= 15.0 + 1e-5
    assert solution.limit_violation < 1e-6


def effort(solution: Solution) -> Array:
    weights = np.array(PAIRS[solution.scheme].b)
    own: Array = np.einsum("k,nku->n", weights, solution.u_values**2) / 2.0
    return own


def test_effort_is_the_quadrature_of_the_scheme() -> None:
    solution = solution_of(pendulum(cost={"effort": 1.0}))
    assert np.diff(solution.t) @ effort(solution) == pytest.approx(solution.cost, rel=1e-12)
    assert solution.us == pytest.approx(solution.u_values.mean(axis=1))

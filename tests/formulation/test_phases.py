"""Steps of several lengths, whose states have a clock: exact derivatives, the steps of given length."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mbocp import Problem, load_problem
from mbocp.formulation import Motion, formulate
from mbocp.formulation.base import Formulation
from mbocp.formulation.features.step_lengths import StepLengths, begins_phase
from mbocp.problem import ProblemWarning
from mbocp.problem.timeline.free_times import TimedNode, phases_between
from mbocp.problem.timeline.sequence import Horizon
from mbocp.problem.timeline.times import FreeTime
from mbocp.terms import running_cost
from tests.formulation.stages import check_derivatives, near
from tests.formulation.test_step_lengths import CASES

EXAMPLES = Path(__file__).parents[2] / "examples"
N, BEGINS = 6, 4  # steps, and the node at which the second phase begins
ARM = [
    ("arms/ur5_limits", {"scheme": "se1"}),
    ("arms/ur5_limits", {"scheme": "rk4"}),
]


def clock(k: Any) -> Any:
    return k.t * k.t + k.v[0] * k.t


def free(name: str, integrator: dict[str, Any], *, has_rates: bool) -> Problem:
    """With a term that looks at the time, and with rates, which look at the length of the step before."""
    problem = load_problem(EXAMPLES / f"{name}.toml")
    T, robot = problem.duration, problem.robot
    # A velocity at the node: every robot can have it.
    via = [{"name": "a", "time": "free", "share": BEGINS / N, "v": speed(robot)}]
    rates: dict[str, Any] = {}
    if has_rates:
        rates = {"effort_rate": 1e4}
        rates |= {} if robot.drives else {"jerk": 1e4, "acceleration": 1e3}
    return problem.with_(
        steps=N,
        integrator=integrator,
        duration={"min": T / 3, "max": 3 * T, "guess": T},
        via=via,
        path=(),
        cost={"time": 0.7, "velocity": 0.3, "fuel": 0.2, "control_rate": 0.1 * has_rates},
        limits=rates,
        terms=(running_cost(clock, weight=0.3),),
        solver={"method": "auto"},
    )


def speed(robot: Any) -> dict[str, Any]:
    """Of the last joint whose velocity no control prescribes."""
    sizes = {name: len(robot.v_labels[robot.velocity_indices(name)]) for name in robot.joint_names}
    free = [n for n in sizes if not set(robot.driven) & set(range(robot.nv)[robot.velocity_indices(n)])]
    return {free[-1]: 0.1 if sizes[free[-1]] == 1 else [0.1] * sizes[free[-1]]}


@pytest.fixture(params=CASES + ARM, ids=lambda case: "-".join(map(str, (case[0], *case[1].values()))))
def case(request: pytest.FixtureRequest) -> tuple[str, dict[str, Any]]:
    return request.param


def test_a_step_is_the_one_of_given_length_and_time(case: tuple[str, dict[str, Any]]) -> None:
    problem = free(*case, has_rates=False)
    formulation = formulate(problem)
    programme, at, nu = formulation.programme, formulation.layout, problem.robot.nu
    assert list(at.states) == ["h", "t"]
    point, _ = near(formulation)
    for stage in (0, 3, BEGINS):
        e, (w,) = begins_phase(N, (0, BEGINS))[stage], point.u[nu:]
        (h0,), (h1,), (t0,), (t1,) = (
            x[piece] for piece in (at.states["h"], at.states["t"]) for x in (point.x0, point.x1)
        )
        length, T = h0 + e * w, problem.duration
        rho = programme.rho.reshape(N, -1)[stage]
        assert rho[-1] == e
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ProblemWarning)  # cost.time adds a constant, which is meant
            given = formulate(problem.with_(duration=T * length, via=(), limits={"effort": 1e6})).programme
        rho_given = given.rho.reshape(N, -1)[stage].copy()
        tau = problem_tau(formulation)
        assert rho_given[-1] == pytest.approx((stage + tau) * T / N * length)  # the time of equal steps
        rho_given[-1] = t0 * T + tau * T / N * length
        c, cost = programme.functions.function("values")(*point, programme.theta, rho)
        same = (point.x0[: at.states["h"].start], point.x1[: at.states["h"].start], point.y, point.u[:nu])
        c_given, cost_given = given.functions.function("values")(*same, given.theta, rho_given)
        c, c_given = np.asarray(c).ravel(), np.asarray(c_given).ravel()
        rows = [at.rows["h"].start, at.rows["t"].start]
        assert np.allclose(np.delete(c, rows), c_given, rtol=1e-12, atol=1e-12 * np.abs(c_given).max())
        assert c[rows] == pytest.approx([length - h1, t0 + length / N - t1], abs=1e-15)
        assert float(cost) == pytest.approx(float(cost_given) + (1 - e) * w**2 / 2, rel=1e-12)


def problem_tau(formulation: Formulation) -> float:
    """Where in a step its cost is evaluated."""
    return (
        formulation.tau if formulation.programme.kind.ny or not formulation.programme.rows_are_gaps else 0.0
    )


def test_derivatives(case: tuple[str, dict[str, Any]]) -> None:
    """Length and time of the step are among the unknowns that are looked at alone."""
    formulation = formulate(free(*case, has_rates=True))
    alone = [formulation.layout.rows[name].start for name in ("h", "t")]
    for stage in (0, 3, BEGINS):
        check_derivatives(formulation, stage, alone)


def test_motions_keep_the_lengths_of_their_phases() -> None:
    problem = free("loops/four_bar", {"scheme": "se1"}, has_rates=False)
    formulation, robot = formulate(problem), problem.robot
    rng = np.random.default_rng(0)
    dts = problem.dt * np.repeat([1.7, 0.4], [BEGINS, N - BEGINS])
    motion = Motion(
        np.tile(problem.q_start, (N + 1, 1)),
        np.vstack([problem.v_start, rng.standard_normal((N, robot.nv))]),
        rng.standard_normal((N, robot.nu)),
        dts,
    )
    iterate = formulation.iterate_of(motion, np.zeros((N, robot.nc)))
    iterate.check(formulation.programme)
    found = formulation.motion_of(iterate)
    for name in ("qs", "vs", "us", "dts"):
        assert np.allclose(getattr(found, name), getattr(motion, name), atol=1e-14)
    at = formulation.layout
    assert iterate.xs[:, at.states["t"]].ravel() == pytest.approx(
        np.append(0.0, np.cumsum(dts)) / problem.duration
    )
    uneven = Motion(motion.qs, motion.vs, motion.us, dts * np.tile([0.5, 1.5], N // 2))
    evened = formulation.motion_of(formulation.iterate_of(uneven, np.zeros((N, robot.nc))))
    assert evened.dts == pytest.approx(dts)
    too_long = Motion(motion.qs, motion.vs, motion.us, 9.0 * dts)
    shortened = formulation.motion_of(formulation.iterate_of(too_long, np.zeros((N, robot.nc))))
    assert shortened.dts.sum() == pytest.approx(3.0 * problem.duration, rel=1e-12)
    assert shortened.dts[0] / shortened.dts[-1] == pytest.approx(1.7 / 0.4)


def test_bounds_are_those_of_first_steps_and_last_nodes() -> None:
    problem = free("loops/four_bar", {"scheme": "se1"}, has_rates=False)
    bounds, T = StepLengths(has_clock=True).state_bounds(problem), problem.duration
    (shortest, _), (earliest, latest) = bounds["h"], bounds["t"]
    assert np.flatnonzero(np.isfinite(shortest)).tolist() == [0, BEGINS]
    assert np.flatnonzero(np.isfinite(latest)).tolist() == [N - 1]
    assert shortest[0, 0] == pytest.approx(1e-3 / 3)
    assert (earliest[-1, 0], latest[-1, 0]) == pytest.approx((1 / 3, 3.0))
    described = formulate(problem).programme.describe_row
    words = {described(n, row) for n in range(N) for row in range(formulate(problem).layout.ndx)}
    assert f"length in step {BEGINS + 1} of {N}" in words
    assert f"time in step 1 of {N}" in words
    assert pytest.approx(problem.timeline.times()[-1]) == T


def test_any_phases_can_be_made_of_nodes_with_times() -> None:
    """What phases are does not know of via points."""
    nodes = [TimedNode(3, FreeTime(0.1, 0.8, 0.5), "lift off"), TimedNode(7, FreeTime(0.6, 1.2, 0.55))]
    phases = phases_between(nodes, Horizon(10, 1.5, (1.0, 2.0)))
    assert [(p.first, p.last, p.steps) for p in phases] == [(0, 3, 3), (3, 7, 4), (7, 10, 3)]
    assert [p.duration for p in phases] == pytest.approx([0.5, 0.1, 0.9])
    assert [p.sides for p in phases] == [(1e-3 * steps * 0.1, np.inf) for steps in (3, 4, 3)]
    nodes = [TimedNode(3, FreeTime(0.0, 9.0, 0.5)), TimedNode(7, FreeTime(0.0, 9.0, 0.2))]
    crowded = phases_between(nodes, Horizon(10, 1.0, None))
    ends = np.cumsum([p.duration for p in crowded])
    assert ends[0] == 0.5
    assert 0.5 < ends[1] < ends[2] == 1.0

"""What states remember: the rows of a step and the functions of limited rates, and their derivatives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from mbocp import Problem, load_problem
from mbocp.formulation import Motion, formulate
from mbocp.formulation.base import Formulation
from mbocp.formulation.features.memory import RULES, memory_units, order_blocks
from mbocp.integrators import SCHEMES
from mbocp.mechanics.motion_rates import rates_along
from mbocp.problem.first_motion import find_holding_controls

EXAMPLES = Path(__file__).parents[2] / "examples"
N = 5
CASES: list[tuple[str, dict[str, Any]]] = [
    ("loops/four_bar", {"scheme": "se1"}),
    ("loops/four_bar", {"scheme": "midpoint"}),
    ("loops/four_bar", {"scheme": "heun"}),
    ("free_flyer/drone_flip", {"scheme": "se2"}),
    ("free_flyer/drone_flip", {"scheme": "rk4", "lie": "munthe_kaas"}),
]
LIMITS = {"acceleration": 40.0, "jerk": 300.0, "effort_rate": 50.0, "power": 20.0}


def limited(name: str, integrator: dict[str, Any], *, is_free: bool = True) -> Problem:
    problem = load_problem(EXAMPLES / f"{name}.toml")
    T = problem.duration
    duration = {"min": T / 3, "max": 3 * T, "guess": T} if is_free else T
    points = {"points": [[0, 0, 0], [0.1, 0, 0.1], [0.2, 0, 0]], "relative": True, "tolerance": 1.0}
    path = [{"kind": "follow", "frame": problem.robot.frame_names[-1], "until": {"share": 0.5}, **points}]
    if has_forces(problem, integrator):
        path.append({"kind": "contact_force", "constraint": problem.robot.constraints[0].name, "max": 1e3})
    words = {"steps": N, "integrator": integrator, "duration": duration, "limits": LIMITS, "path": path}
    return problem.with_(**words, cost={"control_rate": 0.1}, solver={"method": "monolithic"})


def has_forces(problem: Problem, integrator: dict[str, Any]) -> bool:
    """Whether forces of constraints are unknowns."""
    return bool(problem.robot.nc) and SCHEMES[integrator["scheme"]].solves_constraints


@pytest.fixture(params=CASES, ids=lambda case: "-".join(map(str, (case[0], *case[1].values()))))
def problem(request: pytest.FixtureRequest) -> Problem:
    return limited(*request.param)


def near(formulation: Formulation) -> tuple[list[np.ndarray], np.ndarray]:
    """States beside the start, unknowns and multipliers of a step."""
    rng, kind = np.random.default_rng(3), formulation.programme.kind
    x0 = formulation.programme.x_start + 0.05 * rng.standard_normal(kind.nx)
    x1 = x0 + 0.1 * rng.standard_normal(kind.nx)
    y, u = rng.standard_normal(kind.ny), 0.3 * rng.standard_normal(kind.nu)
    return [x0, x1, y, u], rng.standard_normal(kind.ndx + kind.ny)


@pytest.mark.parametrize("stage", [0, 3])
def test_derivatives_of_steps(problem: Problem, stage: int) -> None:
    """Against those of CasADi through the values alone, the step taken as one function; with a free start."""
    problem = problem.with_(start={"free": True})
    formulation = formulate(problem)
    programme, at = formulation.programme, formulation.layout
    point, m = near(formulation)
    rho = programme.rho.reshape(N, -1)[stage]
    absent = set() if has_forces(problem, {"scheme": problem.scheme}) else {"reaction"}
    absent |= set() if problem.robot.nc else {"start"}
    moves = at.controls["moves"]
    assert moves.stop - moves.start == 2 * problem.robot.nv
    names = [*RULES, "progress", "reaction", "start", "h"]
    assert list(at.states) == [name for name in names if name not in absent]
    values, complete = (programme.functions.function(name) for name in ("values", "complete"))
    _, _, dc, dl, upper = (np.array(o.full()) for o in complete(*point, m, programme.theta, rho))
    hessian = np.triu(upper) + np.triu(upper, 1).T
    x0, x1, y, u = (ca.SX.sym(name, piece.size) for name, piece in zip("abcd", point, strict=True))
    c, cost = values.call([x0, x1, y, u, ca.SX(ca.DM(programme.theta)), ca.SX(ca.DM(rho))])
    z = ca.vertcat(x1, y, x0, u)
    wanted = ca.Function(
        "wanted",
        [x0, x1, y, u],
        [ca.jacobian(c, z), ca.jacobian(cost, z), ca.hessian(cost + ca.dot(ca.DM(m), c), z)[0]],
    )(*point)
    for found, expected in zip((dc, dl, hessian), wanted, strict=True):
        expected = np.asarray(expected)
        assert np.allclose(found, expected, rtol=1e-9, atol=1e-9 * (1.0 + np.abs(expected).max()))


def test_derivatives_of_limited_rates(problem: Problem) -> None:
    """First ones against differences of values, second ones against differences of first ones."""
    formulation = formulate(problem)
    programme = formulation.programme
    (_, x, _, u), _ = near(formulation)
    function = programme.functions.function("path")
    m = np.random.default_rng(0).standard_normal(programme.bounds.nh)

    def call(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        h, J, upper = (o.full() for o in function(x, m, u, programme.theta))
        return h.ravel(), J, np.triu(upper) + np.triu(upper, 1).T

    _, J, H = call(x)
    step = 1e-5
    for i in range(x.size):
        d = step * np.eye(x.size)[i]
        (ahead, J_ahead, _), (behind, J_behind, _) = call(x + d), call(x - d)
        assert np.allclose((ahead - behind) / (2 * step), J[:, i], atol=1e-7 * (1 + np.abs(J).max()))
        bend = m @ (J_ahead - J_behind) / (2 * step)
        assert np.allclose(bend, H[:, i], atol=1e-7 * (1 + np.abs(H).max()))


@pytest.mark.parametrize("is_free", [True, False])
@pytest.mark.parametrize(("name", "integrator"), CASES[1:4])
def test_rows_and_rates_of_a_motion(name: str, integrator: dict[str, Any], is_free: bool) -> None:
    """States of a motion fulfil the rows of memory, and what is limited are its rates."""
    problem = limited(name, integrator, is_free=is_free)
    formulation, robot = formulate(problem), problem.robot
    programme, at, rng = formulation.programme, formulation.layout, np.random.default_rng(2)
    moves = 0.1 * rng.standard_normal((N + 1, robot.nv))
    qs = np.array([robot.integrate(problem.q_start, d) for d in moves])
    vs, us = 0.3 * rng.standard_normal((N + 1, robot.nv)), rng.standard_normal((N, robot.nu))
    qs[0], vs[0] = problem.q_start, problem.v_start
    dts = np.full(N, (0.8 if is_free else 1.0) * problem.dt)
    motion = Motion(qs, vs, us, dts)
    iterate = formulation.iterate_of(motion, np.zeros((N, robot.nc)))
    rates = rates_along(robot, qs, vs, us, dts, u_start=problem.u_before) | {"control": us}
    rates["held"] = np.array([find_holding_controls(robot, q) for q in qs[1:]])  # each step as the last
    path = programme.functions.function("path")
    limits = (*problem.rate_limits, *problem.end_limits)
    wanted = np.hstack([c.values_of(rates, dts) / c.scale for c in limits])
    rho = programme.rho.reshape(N, -1)
    for n in range(N):
        x0, x1, u = iterate.xs[n], iterate.xs[n + 1], iterate.us[n]
        h = path(x1, np.zeros(programme.bounds.nh), u, programme.theta)[0]
        of_rates = np.asarray(h).ravel()[-wanted.shape[1] :]  # those of the path come before
        assert np.allclose(of_rates, wanted[n], rtol=1e-9, atol=1e-9)
        if not programme.rows_are_gaps:  # there velocities after the step are those that it reaches
            c = programme.functions.function("values")(x0, x1, iterate.ys[n], u, programme.theta, rho[n])[0]
            assert np.abs(np.asarray(c).ravel()[at.dr]).max() < 1e-9


def test_blocks_come_with_those_that_they_need() -> None:
    assert order_blocks({"jerk"}) == ("acceleration", "jerk")
    assert order_blocks({"control_rate", "acceleration"}) == ("control", "control_rate", "acceleration")
    assert order_blocks(set()) == ()


def test_units_are_those_of_the_limits() -> None:
    problem = limited("loops/four_bar", {"scheme": "se1"})
    features = formulate(problem).pieces.signature.features
    units = {name: unit for feature in features for name, unit in feature.units(problem).items()}
    assert units == {"control_rate": 64.0, "acceleration": 32.0, "jerk": 256.0, "reaction": 16.0}
    assert {limit.key: limit.scale for limit in problem.rate_limits}["power"] == 16.0
    goal = {"q": problem.goal.q, "v": 0}
    alone = Problem.create(problem.robot, 2.0, N, goal=goal, limits={"jerk": 300.0}, scheme="se1")
    assert memory_units(alone)["acceleration"] == 256.0 * 2.0 / 8.0


def test_only_what_is_asked_for_is_remembered() -> None:
    problem = limited("loops/four_bar", {"scheme": "se1"}).with_(cost={"control_rate": 0.0, "effort": 1.0})
    for limits, names in (
        ({"acceleration": 40.0}, ["acceleration"]),
        ({"jerk": 40.0}, ["acceleration", "jerk"]),
        ({"power": 40.0}, ["control"]),
        ({"effort_rate": 40.0}, ["control", "control_rate"]),
        ({"effort": 40.0}, []),
    ):
        fresh = Problem.create(
            problem.robot, 1.0, N, goal={"q": problem.goal.q, "v": 0}, limits=limits, scheme="se1"
        )
        assert list(formulate(fresh).layout.states) == names

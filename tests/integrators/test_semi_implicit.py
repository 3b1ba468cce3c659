"""Semi-implicit Euler against a roll-out by Pinocchio's articulated-body algorithm, and optima by it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mbocp
from mbocp._arrays import Array
from mbocp.formulation import formulate
from mbocp.guesses import make_guess
from mbocp.problem import Problem
from mbocp.robot import Robot, load_robot
from tests.mechanics.models import chain
from tests.mechanics.models import robot as robot_of

SCHEME = "semi_implicit_euler"
ROBOTS: dict[str, Callable[[], Robot]] = {
    "plain": lambda: load_robot("double_pendulum", damping=False),
    "free body": lambda: load_robot("hector", actuated=["root_joint"], damping=False),
    "continuous joint": lambda: robot_of(chain("RUBZ RY")[0]),
    "ball joint": lambda: robot_of(chain("Spherical PX")[0]),
}


def rolled_out(robot: Robot, q: Array, v: Array, us: Array, dt: float) -> tuple[Array, Array]:
    """The recursion as a simulator writes it."""
    model, data = robot.model, robot.model.createData()
    qs, vs = [q], [v]
    for u in us:
        v = v + dt * pin.aba(model, data, q, v, robot.actuation_matrix(q) @ u)
        q = pin.integrate(model, q, dt * v)
        qs.append(q)
        vs.append(v)
    return np.array(qs), np.array(vs)


@pytest.mark.parametrize("name", ROBOTS)
@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1), steps=st.integers(1, 12), duration=st.floats(0.01, 0.3))
def test_a_simulation_is_the_roll_out(name: str, seed: int, steps: int, duration: float) -> None:
    robot, rng = ROBOTS[name](), np.random.default_rng(seed)
    q = pin.integrate(robot.model, robot.q0, rng.standard_normal(robot.nv))
    v, u = rng.standard_normal(robot.nv), 0.05 * rng.standard_normal(robot.nu)
    problem = Problem.create(
        robot,
        duration,
        steps,
        start={"q": q, "v": v},
        goal={"v": np.zeros(robot.nv)},
        guess={"u": u},
        scheme=SCHEME,
        cost={},
    )
    iterate, _ = make_guess("control", formulate(problem))
    qs, vs = rolled_out(robot, q, v, np.tile(u, (steps, 1)), problem.dt)
    speed = 1.0 + np.abs(vs).max()
    assert np.abs(iterate.xs[:, robot.nq :] - vs).max() < 1e-9 * speed
    for found, expected in zip(iterate.xs, qs, strict=True):
        assert np.abs(robot.difference(expected, found[: robot.nq])).max() < 1e-9 * speed


@pytest.mark.parametrize("coordinates", ["joint", "natural"])
def test_a_constraint_holds_and_pushes_where_the_step_begins(coordinates: str) -> None:
    """SHAKE on the sphere, for a bob of 1 kg, whose forces are gravity, control and the rod's."""
    robot = load_robot("rigid_pendulum")
    problem = Problem.create(
        robot,
        1.0,
        40,
        start={"q": [3.0, 0.0, -4.0], "v": [0.0, 1.0, 0.0]},
        goal={"q": [0.0, 3.0, -4.0], "enforce": "penalty"},
        scheme=SCHEME,
        coordinates=coordinates,
        cost={"effort": 1.0, "terminal": 1.0},
    )
    s, dt = mbocp.solve(problem, check=True), problem.dt
    gravity = np.asarray(robot.model.gravity.linear)
    assert np.abs(np.linalg.norm(s.qs, axis=1) - 5.0).max() < 1e-9
    pushes = np.diff(s.vs, axis=0) / dt - gravity - s.us
    assert np.abs(np.cross(pushes, s.qs[:-1])).max() < 1e-7 * np.abs(pushes).max()
    assert np.abs(s.qs[:-1] + dt * s.vs[1:] - s.qs[1:]).max() < 1e-9


@pytest.mark.parametrize("name", ROBOTS)
def test_an_optimum_is_a_roll_out_with_the_cost_of_its_starts(name: str) -> None:
    robot = ROBOTS[name]()
    goal = pin.integrate(robot.model, robot.q0, np.linspace(0.3, -0.4, robot.nv))
    weights = {"effort": 1.0, "velocity": 0.5}
    ends = {"start": {"q": robot.q0}, "goal": {"q": goal, "v": np.zeros(robot.nv)}}
    problem = Problem.create(robot, 1.0, 30, **ends, scheme=SCHEME, cost=weights)
    s = mbocp.solve(problem, check=True)
    qs, vs = rolled_out(robot, s.qs[0], s.vs[0], s.us, problem.dt)
    assert np.abs(robot.difference(goal, qs[-1])).max() < 1e-7
    assert np.abs(vs[-1]).max() < 1e-7
    cost = problem.dt / 2 * (np.sum(s.us**2) + 0.5 * np.sum(vs[:-1] ** 2))
    assert s.cost == pytest.approx(cost, rel=1e-8)  # residuals of 1e-9 beside a cost of 0.07
    assert "strict local minimum" in s.advice
    again = mbocp.solve(problem, warm_start=s)
    assert again.iterations <= 2
    assert again.cost == pytest.approx(s.cost, rel=1e-11)


@pytest.mark.parametrize("limits", [None, {"effort": [6, 50, 23, 6, 4.5, 1.1]}], ids=["free", "limited"])
def test_costs_that_others_found(limits: dict[str, list[float]] | None) -> None:
    """UR5 from side to side: Crocoddyl, IPOPT and fatrop end at these costs."""
    problem = Problem.create(
        "ur5",
        1.5,
        100,
        start={"q": [-1.2, -2.2, 1.8, -1.2, -1.5, 0.3]},
        goal={"q": [1.4, -0.6, -1.2, 0.8, 1.3, -1.6], "v": np.zeros(6)},
        cost={"effort": 1.0, "velocity": 10.0},
        scheme=SCHEME,
        limits=limits,
    )
    s = mbocp.solve(problem, check=True)
    assert s.cost == pytest.approx(460.39759 if limits else 456.10444, abs=5e-5)

"""Damped motions: against closed forms, scipy's integrator, balances of energy; and optima with losses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import mbocp
from mbocp._arrays import Array
from mbocp.formulation import formulate
from mbocp.problem import Problem
from mbocp.problem.problem import problem_from_tables
from mbocp.programme.kernel import kernel_programme
from mbocp.robot import Robot, load_robot
from mbocp.solution import Solution
from tests.robot import urdfs
from tests.robot.urdfs import joint, link, losses

ORDER = {"se1": 1, "se2": 1, "midpoint": 2, "rk4": 4}


def simulated(
    robot: Robot, scheme: str, duration: float, steps: int, q: Any, v: Any, coordinates: str = "joint"
) -> tuple[Array, Array]:
    """Configurations and velocities at the nodes, without controls."""
    problem = problem_from_tables(
        {
            "robot": dict(robot.spec),
            "coordinates": coordinates,
            "horizon": {"duration": duration, "steps": steps},
            "integrator": {"scheme": scheme},
            "start": {"q": list(q), "v": list(v)},
            "goal": {"v": [0.0] * robot.nv},  # nothing is solved
        }
    )
    formulation = formulate(problem)
    made = formulation.programme
    native = kernel_programme(made)
    native.u = np.zeros(native.u.shape)
    xs = np.zeros((steps + 1, formulation.layout.nx))
    xs[0] = made.x_start
    native.x = xs.ravel()
    assert native.simulate(1e-13, 50).ok
    xs = native.x.reshape(xs.shape)
    zs, ws = xs[:, formulation.layout.z], xs[:, formulation.layout.s]
    if coordinates == "natural":
        return formulation.space.configurations(zs), formulation.space.velocities(zs, ws)
    return zs, ws


def slope(errors: list[float]) -> float:
    return float(np.log2(errors[-2] / errors[-1]))


@pytest.fixture(scope="module")
def oscillator(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """2 kg on a spring of 8 N/m, 0.8 N s/m in the rail: damping ratio 0.1, 2 rad/s."""
    urdf = urdfs.robot(
        link("base", None),
        link("mass", 2.0),
        '<joint name="rail" type="prismatic"><parent link="base"/><child link="mass"/><axis xyz="1 0 0"/>'
        + urdfs.LIMIT
        + losses(0.8)
        + "</joint>",
    )
    toml = '[[spring_damper]]\nframes = ["mass", "base"]\nstiffness = 8.0\nlength = 0.0\n'
    return load_robot(urdfs.write(tmp_path_factory.mktemp("oscillator"), urdf, toml))


@pytest.mark.parametrize("scheme", ORDER)
def test_a_damped_oscillator_has_its_closed_form(oscillator: Robot, scheme: str) -> None:
    T, x0, v0, decay = 3.0, 0.3, -0.2, 0.8 / (2 * 2.0)
    omega = np.sqrt(8.0 / 2.0 - decay**2)
    exact = np.exp(-decay * T) * (x0 * np.cos(omega * T) + (v0 + decay * x0) / omega * np.sin(omega * T))
    errors = [
        abs(float(simulated(oscillator, scheme, T, n, [x0], [v0])[0][-1, 0]) - exact) for n in (200, 400)
    ]
    assert slope(errors) == pytest.approx(ORDER[scheme], abs=0.2)


def test_the_midpoint_rule_loses_exactly_what_the_damper_takes(oscillator: Robot) -> None:
    """Energy is quadratic, so that its balance holds in every step: E_n - E_{n-1} = - dt d v_tau^2."""
    qs, vs = simulated(oscillator, "midpoint", 3.0, 50, [0.3], [-0.2])
    energies = 0.5 * 2.0 * vs[:, 0] ** 2 + 0.5 * 8.0 * qs[:, 0] ** 2
    taken = 3.0 / 50 * 0.8 * (0.5 * (vs[1:, 0] + vs[:-1, 0])) ** 2
    np.testing.assert_allclose(np.diff(energies), -taken, rtol=0, atol=1e-14)
    assert energies[-1] < 0.4 * energies[0]


@pytest.fixture(scope="module")
def reference() -> tuple[Robot, Array, Array, float]:
    """The double pendulum with the damping of its URDF, by scipy on Pinocchio's forward dynamics."""
    robot = load_robot("double_pendulum")
    model, data, d = robot.model, robot.model.createData(), 0.05  # [N m s/rad], as the URDF says
    start = np.array([0.9, -0.4, 0.5, 0.3])

    def rate(_: float, x: Array) -> Array:
        q, v = x[:2], x[2:4]
        return np.concatenate([v, pin.aba(model, data, q, v, -d * v), [d * v @ v]])

    found = solve_ivp(rate, (0.0, 1.0), [*start, 0.0], method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return robot, start, found[:4], float(found[4])


@pytest.mark.parametrize("scheme", ORDER)
def test_a_damped_double_pendulum_against_scipy(
    reference: tuple[Robot, Array, Array, float], scheme: str
) -> None:
    robot, start, end, _ = reference
    errors = []
    for n in (100, 200, 400):
        qs, vs = simulated(robot, scheme, 1.0, n, start[:2], start[2:])
        errors.append(float(np.abs(np.concatenate([qs[-1], vs[-1]]) - end).max()))
    assert slope(errors) == pytest.approx(ORDER[scheme], abs=0.25)


@pytest.mark.parametrize("scheme", ["se1", "midpoint"])
def test_natural_coordinates_tend_to_the_same_motion(
    reference: tuple[Robot, Array, Array, float], scheme: str
) -> None:
    robot, start, end, _ = reference
    errors = []
    for n in (200, 400):
        qs, _ = simulated(robot, scheme, 1.0, n, start[:2], start[2:], "natural")
        errors.append(float(np.abs(qs[-1] - end[:2]).max()))
    assert slope(errors) == pytest.approx(ORDER[scheme], abs=0.35)


def test_energy_that_is_lost_is_the_work_of_the_dampers(
    reference: tuple[Robot, Array, Array, float],
) -> None:
    robot, start, end, work = reference

    def energy(q: Array, v: Array) -> float:
        return float(0.5 * v @ robot.momentum(q, v)) + robot.potential_energy(q)

    lost = energy(start[:2], start[2:]) - energy(end[:2], end[2:])
    assert lost == pytest.approx(work, rel=1e-9)
    gaps = []
    for n in (100, 200):
        qs, vs = simulated(robot, "midpoint", 1.0, n, start[:2], start[2:])
        middle = 0.5 * (vs[1:] + vs[:-1])
        taken = sum(-robot.force_elements(q, v) @ v for q, v in zip(qs[:-1], middle, strict=True)) * (1.0 / n)
        gaps.append(abs(taken - (energy(qs[0], vs[0]) - energy(qs[-1], vs[-1]))))
    assert slope(gaps) == pytest.approx(2.0, abs=0.3)


def test_friction_stops_a_sliding_block(tmp_path: Path) -> None:
    """1 m/s against 0.5 N on 2 kg: a constant deceleration, then rest after 4 s."""
    urdf = urdfs.robot(
        link("base", None),
        link("mass", 2.0),
        '<joint name="rail" type="prismatic"><parent link="base"/><child link="mass"/><axis xyz="1 0 0"/>'
        + urdfs.LIMIT
        + losses(0.0, 0.5)
        + "</joint>",
    )
    block = load_robot(urdfs.write(tmp_path, urdf), friction="smooth", friction_speed=1e-2)
    _, vs = simulated(block, "se1", 6.0, 600, [0.0], [1.0])
    t = np.linspace(0.0, 6.0, 601)
    early = t < 3.8
    np.testing.assert_allclose(vs[early, 0], 1.0 - 0.25 * t[early], atol=1e-4)
    assert 0.0 <= vs[-1, 0] < 1e-9


@pytest.fixture(scope="module")
def crane(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mast that turns about the vertical and a jib, both damped, the mast with friction."""
    urdf = urdfs.robot(
        link("base", None),
        link("mast"),
        '<joint name="slew" type="revolute"><parent link="base"/><child link="mast"/><axis xyz="0 0 1"/>'
        + urdfs.LIMIT
        + losses(0.6, 0.3)
        + "</joint>",
        link("jib"),
        joint("luff", "revolute", "mast", "jib", axis="0 1 0", extra=urdfs.LIMIT + losses(0.4)),
    )
    return urdfs.write(tmp_path_factory.mktemp("crane"), urdf)


def reach(crane: Path, **tables: Any) -> Problem:
    robot = {"name": str(crane), "friction": "smooth", "friction_speed": 0.2, **tables.pop("robot", {})}
    document = {
        "robot": robot,
        "horizon": {"duration": 1.0, "steps": 20},
        "goal": {"q": {"slew": 0.8, "luff": 0.5}, "v": [0.0, 0.0]},
        "integrator": {"scheme": "se1"},
    }
    return problem_from_tables({**document, **tables})


def solved(problem: Problem, **options: Any) -> Solution:
    solution = mbocp.solve(problem, **options)
    assert solution.converged, solution.advice
    return solution


@pytest.mark.parametrize("scheme", ["se1", "se2", "midpoint"])
def test_the_controls_pay_for_the_losses(crane: Path, scheme: str) -> None:
    s = solved(reach(crane, integrator={"scheme": scheme}))
    robot = load_robot(crane, friction="none")
    model, data, tau = (
        robot.model,
        robot.model.createData(),
        {"se1": 1.0, "se2": 0.0, "midpoint": 0.5}[scheme],
    )
    dt = s.t[1]
    for n, u in enumerate(s.us):
        v = (1 - tau) * s.vs[n] + tau * s.vs[n + 1]
        q = s.qs[n] + tau * dt * v
        torque = pin.rnea(model, data, q, v, (s.vs[n + 1] - s.vs[n]) / dt)
        torque += [0.6 * v[0] + 0.3 * np.tanh(v[0] / 0.2), 0.4 * v[1]]
        np.testing.assert_allclose(u, torque, rtol=0, atol=1e-8)


def test_losses_cost_and_break_no_rotation(crane: Path) -> None:
    """The mast's angle stays cyclic: its adjoint is conserved."""
    lossy = solved(reach(crane))
    free = solved(reach(crane, robot={"damping": False, "friction": "none"}))
    assert lossy.cost > free.cost
    (pan,) = lossy.conserved
    assert pan.name == "rotation about z"
    assert pan.relative_drift < 1e-9


@pytest.mark.parametrize("solver", ["fbsm_newton", "ipopt", "fatrop"])
def test_solvers_agree(crane: Path, solver: str) -> None:
    assert solved(reach(crane), solver=solver).cost == pytest.approx(solved(reach(crane)).cost, rel=1e-8)


def test_natural_coordinates_tend_to_the_same_optimum(crane: Path) -> None:
    gaps = []
    for steps in (20, 80):
        horizon = {"duration": 1.0, "steps": steps}
        costs = [solved(reach(crane, coordinates=c, horizon=horizon)).cost for c in ("joint", "natural")]
        gaps.append(abs(costs[1] / costs[0] - 1.0))
    assert gaps[1] < gaps[0] / 3.0

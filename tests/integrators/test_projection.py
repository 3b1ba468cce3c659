"""The midpoint rule with projected velocities: its equations by Pinocchio, its order, what it is free of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.formulation import formulate
from mbocp.guesses import make_guess
from mbocp.integrators.schemes import what_errs_less
from mbocp.problem import Guess, Problem
from tests.integrators.test_partitioned import slope_of_errors
from tests.integrators.test_schemes import CASES, load

SCHEME = "projected_midpoint"


def still(path: str, scheme: str, steps: int) -> Problem:
    """An example of a robot without losses."""
    problem = load(path, scheme, f"horizon.steps={steps}", "horizon.duration=0.3")
    return problem.with_(robot=replace(problem.robot, resistances=()))


@pytest.mark.parametrize("name", ["paper/rigid_pendulum", "loops/four_bar", "loops/delta", "loops/stewart"])
def test_steps_obey_their_equations(name: str) -> None:
    problem = still(f"{name}.toml", SCHEME, 8)
    robot, dt, rng = problem.robot, problem.dt, np.random.default_rng(3)
    u = rng.uniform(0.5, 1.0, robot.nu)
    formulation = formulate(problem)
    iterate, _ = make_guess("control", formulate(problem.with_(guess=Guess(kind="control", u=u))))
    motion, nv, nc = formulation.motion_of(iterate), robot.nv, robot.nc
    data, size = robot.model.createData(), 1.0 + np.abs(motion.vs).max()
    assert np.abs(iterate.ys[:, :nv]).max() > 1e-6  # there is something to project
    for n, y in enumerate(iterate.ys):
        q0, v0, q1, v1 = motion.qs[n], motion.vs[n], motion.qs[n + 1], motion.vs[n + 1]
        leap, impulse, last = y[:nv], y[nv : nv + nc], y[nv + nc :]
        mean, change = (v0 + v1 + leap) / 2, (v1 + leap - v0) / dt
        middle = robot.integrate(q0, dt / 2 * mean)
        assert np.abs(robot.difference(q1, robot.integrate(q0, dt * mean))).max() < 1e-11 * size
        push = robot.actuation_matrix(middle) @ u - robot.constraint_jacobian(middle).T @ impulse / dt
        inertial = pin.rnea(robot.model, data, middle, mean, change)
        assert np.abs(inertial - push).max() < 1e-8 * (1.0 + np.abs(push).max())
        jacobian = robot.constraint_jacobian(q1)
        assert np.abs(robot.mass_matrix(q1) @ leap - jacobian.T @ last).max() < 1e-10
        assert np.abs(jacobian @ v1).max() < 1e-10 * size
        assert np.abs(robot.constraint_residual(q1)).max() < 1e-11


def test_its_order_is_two() -> None:
    path, settings, _ = CASES["rigid_pendulum"]
    made = {n: load(path, SCHEME, *settings, f"horizon.steps={n}") for n in (20, 40, 80)}
    assert slope_of_errors(made) == pytest.approx(2.0, abs=0.2)


def test_without_constraints_it_is_the_midpoint_rule() -> None:
    found = [mbocp.solve(load("arms/ur5_reach.toml", scheme)) for scheme in (SCHEME, "midpoint")]
    assert np.array_equal(found[0].qs, found[1].qs)
    assert np.array_equal(found[0].us, found[1].us)


def test_velocities_of_optima_keep_to_the_constraints() -> None:
    rates = []
    for scheme in ("midpoint", SCHEME):
        problem = load("loops/delta.toml", scheme, "horizon.steps=12")
        s = mbocp.solve(problem, check=True)
        across = [problem.robot.constraint_jacobian(q) @ v for q, v in zip(s.qs, s.vs, strict=True)]
        rates.append(np.abs(across).max())
    assert rates[1] < 1e-12 < 1e-5 < rates[0]


def test_what_errs_less_names_a_scheme_that_takes_holds() -> None:
    assert SCHEME in what_errs_less("se1")
    assert "order" in what_errs_less("gauss2")
    assert what_errs_less(SCHEME) == "more steps"

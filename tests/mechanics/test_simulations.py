"""The same motion of SE1 in joint and in natural coordinates: for any robot they differ by O(dt)."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
import scipy.sparse.linalg as spla

from mbocp.integrators import State, evaluation_point, step_rows
from mbocp.mechanics import JointMechanics, Mechanics, NaturalMechanics
from mbocp.mechanics.natural_coordinates.space import NaturalSpace
from mbocp.robot import Robot
from mbocp.robot.loading.readers import example_robots as examples
from tests.mechanics.natural_coordinates.test_mechanics import LARGEST, loaded, state

DURATION = 0.02  # [s]
STEPS = (10, 20, 40, 80)
ROUND_OFF = 1e-7  # [rad] of links of a few grams with stiff dampers: hands
FEW = ("double_pendulum", "ur5", "hector", "zoo")


def stepper(mechanics: Mechanics) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """Step of SE1 by Newton's method, with the scheme's own rows."""
    nq, nv, nc = mechanics.nq, mechanics.nv, mechanics.nc
    q0, v0, q1, v1 = (ca.SX.sym(n, k) for n, k in (("q0", nq), ("v0", nv), ("q1", nq), ("v1", nv)))
    y, u, dt, move = ca.SX.sym("y", nc), ca.SX.sym("u", mechanics.nu), ca.SX.sym("dt"), ca.SX.sym("move", nv)
    before, after = State(q0, v0), State(mechanics.integrate(q1, move), v1)
    at = evaluation_point(mechanics, "se1", before, after, dt)
    rows = ca.densify(ca.vertcat(*step_rows(mechanics, "se1", before, after, at, y, u, dt)))
    jacobian = ca.jacobian(rows, ca.vertcat(move, v1, y))
    arguments = [q0, v0, q1, v1, y, u, dt]
    here = ca.Function("here", [*arguments, move], [rows, jacobian], {"cse": True})
    moved = ca.Function("moved", [q1, move], [mechanics.integrate(q1, move)])
    still = np.zeros(nv)

    def step(q: np.ndarray, v: np.ndarray, control: np.ndarray, length: float):
        z, w = np.asarray(moved(q, length * v)).ravel(), v.copy()
        impulse = np.zeros(nc)
        for _ in range(20):
            c, derivative = here(q, v, z, w, impulse, control, length, still)
            found = spla.splu(derivative.sparse().tocsc()).solve(-np.asarray(c).ravel())
            z = np.asarray(moved(z, found[:nv])).ravel()
            w, impulse = w + found[nv : 2 * nv], impulse + found[2 * nv :]
            if np.abs(found[:nv]).max() < 1e-12:
                return z, w
        raise AssertionError("the step has no solution")

    return step


def gaps(robot: Robot) -> list[float]:
    """Distance of the ends of both simulations over `STEPS`."""
    mechanics = NaturalMechanics(robot)
    q, v, _ = state(robot)
    u = np.zeros(robot.nu)  # fingers of a gram go round and round under any torque
    space = NaturalSpace(mechanics, q)
    in_joints, in_bodies = stepper(JointMechanics(robot)), stepper(mechanics)
    found = []
    for steps in STEPS:
        joint, natural = (q, v), (space.coordinates(q[None])[0], space.rates(q[None], v[None])[0])
        for _ in range(steps):
            joint = in_joints(*joint, u, DURATION / steps)
            natural = in_bodies(*natural, u, DURATION / steps)
        violation = ca.Function("Phi", [z := ca.SX.sym("z", mechanics.nq)], [mechanics.constraints(z)])
        assert np.abs(np.asarray(violation(natural[0]))).max(initial=0.0) < 1e-10
        end = space.configurations(natural[0][None])[0]
        found.append(float(np.abs(robot.difference(joint[0], end)).max()))
    return found


def check(robot: Robot) -> None:
    found = gaps(robot)
    if max(found) < ROUND_OFF:
        return  # the same equations, or joints so damped that they stop within the first step
    assert 1.8 < found[-2] / found[-1] < 2.2, found
    assert abs(2.0 * found[-1] - found[-2]) < 1e-3, found  # Richardson: the limit is the same motion


@pytest.mark.parametrize("name", FEW)
def test_simulations_converge_to_each_other(name: str, tmp_path) -> None:
    check(loaded(name, tmp_path))


@pytest.mark.slow
@pytest.mark.parametrize("name", [n for n in examples.names() if n not in FEW])
def test_simulations_of_many_converge_to_each_other(name: str, tmp_path) -> None:
    robot = loaded(name, tmp_path)
    if robot.model.njoints - 1 > LARGEST:
        pytest.skip(f"{robot.model.njoints - 1} links")
    check(robot)

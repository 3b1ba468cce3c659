"""What symplectic partitioned methods keep over many steps without controls, by the kernel's simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.formulation import formulate
from mbocp.guesses.simulated import simulated
from mbocp.integrators import PAIRS
from mbocp.problem import Problem
from mbocp.robot import Robot
from tests.mechanics.models import chain
from tests.mechanics.models import robot as robot_of

ON_CONSTRAINTS = [name for name, pair in PAIRS.items() if pair.holds_constraints]
TO_ROUND_OFF = 1e-15  # residual of a step in its unit of force; what is left of it adds up
CHUNK = 10_000  # steps of one simulation: all of them would take gigabytes


@pytest.fixture(autouse=True)
def to_round_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """A guess is simulated to 1e-12, which would be what momenta are wrong by."""
    monkeypatch.setattr("mbocp.guesses.simulated._SWEEP_TOLERANCE", TO_ROUND_OFF)


def arm(gravity: float) -> Robot:
    """Two links, the axis of the first vertical, nothing that dissipates."""
    model = chain("RZ RX")[0]
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    return robot_of(model)


def motion(robot: Robot, scheme: str, dt: float, q: Array, v: Array, num_steps: int) -> tuple[Array, Array]:
    """Configurations and velocities of all nodes without controls."""
    problem = Problem.create(
        robot,
        num_steps * dt,
        num_steps,
        start={"q": q, "v": v},
        goal={"v": np.zeros(robot.nv), "enforce": "penalty"},
        cost={"effort": 1.0, "terminal": 1.0},
        scheme=scheme,
    )
    formulation = formulate(problem)
    found = formulation.motion_of(simulated(formulation, np.zeros(robot.nu)))
    return found.qs, found.vs


def energies(robot: Robot, qs: Array, vs: Array) -> Array:
    model, data = robot.model, robot.model.createData()
    return np.array([pin.computeMechanicalEnergy(model, data, q, v) for q, v in zip(qs, vs, strict=True)])


def momenta(robot: Robot, qs: Array, vs: Array, component: int) -> Array:
    return np.array([robot.momentum(q, v)[component] for q, v in zip(qs, vs, strict=True)])


@pytest.mark.parametrize("scheme", PAIRS)
def test_momentum_of_a_cyclic_joint_over_ten_thousand_steps(scheme: str) -> None:
    """Nothing pulls at a joint whose axis is vertical, though the other swings in gravity."""
    robot = arm(9.81)
    qs, vs = motion(robot, scheme, 0.02, np.array([0.3, -0.9]), np.array([1.0, -2.0]), CHUNK)
    kept = momenta(robot, qs, vs, 0)
    single = momenta(robot, qs, vs, 1)
    assert np.abs(kept / kept[0] - 1.0).max() < 1e-13
    assert np.ptp(single) > 0.1 * np.abs(single).max()  # that of the other joint varies


@pytest.mark.parametrize("scheme", ON_CONSTRAINTS)
def test_momentum_on_a_sphere_over_ten_thousand_steps(scheme: str) -> None:
    """Angular momentum of the rigid pendulum about the vertical; the rod and its speed stay, too."""
    robot = replace(mbocp.load_robot("rigid_pendulum"), resistances=())
    q = np.array([3.0, 0.0, -4.0])
    qs, vs = motion(robot, scheme, 0.02, q, np.array([0.0, 2.0, 0.0]), CHUNK)
    kept = qs[:, 0] * vs[:, 1] - qs[:, 1] * vs[:, 0]
    assert np.abs(kept / kept[0] - 1.0).max() < 1e-13
    assert np.abs(np.linalg.norm(qs, axis=1) / 5.0 - 1.0).max() < 1e-12
    assert np.abs(np.einsum("ij,ij->i", qs, vs)).max() < 1e-11


@pytest.mark.slow
@pytest.mark.parametrize("scheme", PAIRS)
def test_energy_stays_within_bounds_over_a_hundred_thousand_steps(scheme: str) -> None:
    """Ten times as many steps have no larger errors, and no trend."""
    robot = arm(9.81)
    dt = 0.02 if scheme == "lobatto2" else 0.05
    q, v = np.array([0.5, -0.3]), np.zeros(2)
    start = energies(robot, q[None], v[None])[0]
    largest, means = [], []
    for _ in range(10):
        qs, vs = motion(robot, scheme, dt, q, v, CHUNK)
        errors = energies(robot, qs, vs) - start
        largest.append(np.abs(errors).max())
        means.append(errors.mean())
        q, v = qs[-1], vs[-1]
    assert max(largest) < 1.2 * largest[0] + 1e-11
    assert np.ptp(means) < 0.2 * largest[0] + 1e-11

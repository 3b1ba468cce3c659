"""Pontryagin's conditions in continuous time by scipy's `solve_bvp`, against optima with ever shorter steps.

Nothing of mbocp is in the reference: the equations of motion and of the adjoint are written out by hand.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_bvp

import mbocp
from mbocp._arrays import Array

ORDERS = {
    "se1": 1,
    "se2": 1,
    "midpoint": 2,
    "rk4": 2,
}  # of optima with controls that are constant in each step
STEPS = (40, 80, 160)

# A uniform rod on a hinge: the angle is zero where it points up.
LENGTH, MASS, EFFORT, TURN, TIME = 0.8, 1.5, 0.7, 2.0, 1.2  # m, kg, 1/(N m)^2 s, rad, s
ROD = f"""<robot name="rod"><link name="base"/><link name="rod"><inertial>
<origin xyz="0 0 {LENGTH / 2}"/><mass value="{MASS}"/>
<inertia ixx="{MASS * LENGTH**2 / 12}" iyy="{MASS * LENGTH**2 / 12}" izz="1e-3" ixy="0" ixz="0" iyz="0"/>
</inertial></link><joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/>
<axis xyz="0 1 0"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint></robot>"""

# The bob of the first paper's section 6.1, 1 kg on a spring with V = k/(8 l^2) (|q|^2 - l^2)^2.
SPRING, REST, GRAVITY = 0.6, 5.0, 9.8  # N/m, m, m/s^2
BOB_FROM, BOB_TO, BOB_SPEED, BOB_TIME = (-2.0, -5.0, -5.0), (2.0, -6.0, -4.0), (-1.0, 0.0, 0.5), 2.0


@dataclass(frozen=True, eq=False)
class Reference:
    """Cost, adjoint of (q, p) at both ends, Hamiltonian."""

    cost: float
    first: Array
    last: Array
    hamiltonian: float


def rod_problem(folder: Any, gravity: float, scheme: str, steps: int) -> mbocp.Problem:
    file = folder / "rod.urdf"
    file.write_text(ROD)
    return mbocp.Problem.create(
        mbocp.load_robot(file, gravity=[0, 0, -gravity]),
        TIME,
        steps,
        start={"q": [0.4]},
        goal={"q": [0.4 + TURN], "v": [0.0]},
        cost={"effort": EFFORT},
        scheme=scheme,
    )


@cache
def rod_reference(gravity: float) -> Reference:
    inertia, weight = MASS * LENGTH**2 / 3, MASS * gravity * LENGTH / 2

    def rates(_: Any, x: Array) -> Array:
        angle, momentum, a, b = x
        torque = -b / EFFORT
        return np.array(
            [momentum / inertia, torque + weight * np.sin(angle), -b * weight * np.cos(angle), -a / inertia]
        )

    def ends(x0: Array, x1: Array) -> Array:
        return np.array([x0[0] - 0.4, x0[1], x1[0] - 0.4 - TURN, x1[1]])

    t = np.linspace(0.0, TIME, 41)
    s = t / TIME
    guess = np.array([0.4 + TURN * s, 0 * s, 0 * s, 0 * s])
    return reference(rates, ends, t, guess, lambda x: 0.5 * x[3] ** 2 / EFFORT, 2, lambda x, f: f[:2])


def bob_problem(_: Any, __: float, scheme: str, steps: int) -> mbocp.Problem:
    return mbocp.Problem.create(
        mbocp.load_robot("elastic_pendulum", gravity=[0, 0, -GRAVITY]),
        BOB_TIME,
        steps,
        start={"q": BOB_FROM, "v": BOB_SPEED},
        goal={"q": BOB_TO, "v": [0.0, 0.0, 0.0]},
        scheme=scheme,
        cost={},
    )


@cache
def bob_reference(_: float) -> Reference:
    stiff = SPRING / (2 * REST**2)

    def rates(_: Any, x: Array) -> Array:
        q, p, a, b = x.reshape(4, 3, -1)
        stretch = np.sum(q * q, axis=0) - REST**2
        force = -stiff * stretch * q - b
        force[2] -= GRAVITY
        pulled = stiff * (stretch * b + 2 * q * np.sum(q * b, axis=0))
        return np.vstack([p, force, pulled, -a])

    def ends(x0: Array, x1: Array) -> Array:
        return np.concatenate([x0[:6] - (*BOB_FROM, *BOB_SPEED), x1[:6] - (*BOB_TO, 0, 0, 0)])

    t = np.linspace(0.0, BOB_TIME, 41)
    s = t / BOB_TIME
    start, goal = np.array(BOB_FROM)[:, None], np.array(BOB_TO)[:, None]
    guess = np.vstack([start + (goal - start) * s, np.zeros((9, t.size))])
    return reference(rates, ends, t, guess, lambda x: 0.5 * np.sum(x[9:] ** 2, axis=0), 6, lambda x, f: f[:6])


def reference(
    rates: Any, ends: Any, t: Array, guess: Array, running: Any, half: int, moved: Any
) -> Reference:
    """Solve the two-point problem; the cost is one more state."""

    def with_cost(time: Any, x: Array) -> Array:
        return np.vstack([rates(time, x[:-1]), running(x[:-1])])

    def with_start(x0: Array, x1: Array) -> Array:
        return np.append(ends(x0[:-1], x1[:-1]), x0[-1])

    found = solve_bvp(with_cost, with_start, t, np.vstack([guess, 0 * t]), tol=1e-10, max_nodes=40000)
    assert found.success, found.message
    x = found.y[:-1]
    f = rates(None, x)
    hamiltonians = running(x) + np.sum(x[half:] * f[:half], axis=0)
    assert np.ptp(hamiltonians) < 1e-7 * np.abs(hamiltonians).max()
    return Reference(float(found.y[-1, -1]), x[half:, 0], x[half:, -1], float(hamiltonians.mean()))


PROBLEMS = {
    "a double integrator": (rod_problem, rod_reference, 0.0),
    "an arm of one link": (rod_problem, rod_reference, 9.81),
    "a bob on a spring": (bob_problem, bob_reference, GRAVITY),
}


def extrapolated(values: list[Any], order: int) -> tuple[Any, Any]:
    """Limit of values with steps that halve, and how uncertain it is."""
    once = [(2**order * b - a) / (2**order - 1) for a, b in pairwise(values)]
    return once[-1], np.abs(np.asarray(once[-1]) - once[-2])


@pytest.mark.parametrize("scheme", ORDERS)
@pytest.mark.parametrize("name", PROBLEMS)
def test_optima_tend_to_the_two_point_problem(name: str, scheme: str, tmp_path: Any) -> None:
    make, refer, gravity = PROBLEMS[name]
    wanted, order = refer(gravity), ORDERS[scheme]
    found = [mbocp.solve(make(tmp_path, gravity, scheme, n), check=True) for n in STEPS]

    cost, doubt = extrapolated([s.cost for s in found], order)
    assert cost == pytest.approx(wanted.cost, abs=4 * doubt + 1e-9 * wanted.cost)
    assert doubt < 1e-3 * wanted.cost
    errors = [abs(s.cost - wanted.cost) for s in found]
    if errors[-1] > 1e-8 * wanted.cost:  # the reference's own accuracy
        assert np.log2(errors[0] / errors[-1]) / 2 > order - 0.35

    size = float(np.abs(wanted.first).max())
    for row, adjoint in ((0, wanted.first), (-1, wanted.last)):
        if row == -1 and scheme == "se1":
            continue  # whose adjoints belong to the steps
        limit, doubt = extrapolated([s.mus[row] for s in found], order)
        assert np.all(np.abs(limit - adjoint) <= 4 * doubt + 1e-6 * size), (limit - adjoint, doubt)

    mean, doubt = extrapolated([s.control_hamiltonian["mean"] for s in found], 1)
    drift = [s.control_hamiltonian["max"] - s.control_hamiltonian["min"] for s in found]
    size = abs(wanted.hamiltonian) + wanted.cost
    assert mean == pytest.approx(wanted.hamiltonian, abs=8 * doubt + 1e-3 * size)
    assert drift[-1] < 0.6 * drift[0] or drift[0] < 1e-9 * size

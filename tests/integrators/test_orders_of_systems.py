"""Orders of symplectic partitioned methods under given controls: states, multipliers, adjoints.

Adjoints of the first node are those of the last times the derivative of the last state in the first. So where
controls are given they converge as this derivative does. Controls that are constant in each step and optimal
are another matter: see `test_orders_of_optima.py`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

from mbocp import load_problem
from mbocp._arrays import Array
from mbocp.formulation import formulate
from mbocp.guesses.make import guess_by_simulation
from mbocp.integrators import PAIRS, Pair
from mbocp.problem import Problem
from mbocp.robot import Robot, Rod, load_robot
from tests.integrators.stepping import Run, Steps, Truth
from tests.integrators.test_schemes import rate_of_quaternion
from tests.integrators.test_symplecticity import null_space
from tests.mechanics.models import chain
from tests.mechanics.models import robot as robot_of
from tests.robot.test_unicycle import closed_form, driven_acceleration

EXAMPLES = Path(__file__).parents[2] / "examples"

ORDER = {name: pair.order for name, pair in PAIRS.items()}
SYMPLECTIC = [name for name, pair in PAIRS.items() if pair.is_symplectic]
ON_CONSTRAINTS = [name for name, pair in PAIRS.items() if pair.holds_constraints]
TOLERANCE = {False: 3e-14, True: 1e-11}  # of the motion they approximate; on constraints by differences


@dataclass(frozen=True)
class Case:
    """A robot without losses, and the size of its first velocities and of its controls."""

    name: str
    duration: float  # [s]
    rate: float
    force: float

    @property
    def robot(self) -> Robot:
        if self.name in ("FreeFlyer", "Spherical"):
            return robot_of(chain(self.name)[0])
        return replace(load_robot(self.name), resistances=())

    def start(self, robot: Robot) -> tuple[Array, Array]:
        """State that agrees with the constraints, and controls."""
        rng = np.random.default_rng(5)
        q = robot.q0 if robot.nc else robot.integrate(robot.q0, 0.3 * rng.standard_normal(robot.nv))
        v = rng.standard_normal(robot.nv)
        if robot.nc:
            v = null_space(robot.constraint_jacobian(q)) @ rng.standard_normal(robot.nv - robot.nc)
        return np.append(q, self.rate * v), self.force * rng.uniform(-1.0, 1.0, robot.nu)


FREE = {
    "elastic_pendulum": Case("elastic_pendulum", 2.0, 1.0, 1.0),
    "double_pendulum": Case("double_pendulum", 0.2, 1.0, 0.0),
    "SO(3)": Case("Spherical", 1.5, 1.0, 1.0),
    "SE(3)": Case("FreeFlyer", 1.5, 1.0, 1.0),
    "ur5": Case("ur5", 0.2, 1.0, 0.5),
}
HELD = {
    "rigid_pendulum": Case("rigid_pendulum", 1.0, 1.0, 1.0),
    "four_bar": Case("four_bar", 0.2, 1.0, 0.5),
    "slider_crank": Case("slider_crank", 0.3, 8.0, 5.0),
    "stewart": Case("stewart", 0.2, 1.0, 20.0),
}
STEPS = {
    "gauss1": (20, 40, 80),
    "gauss2": (5, 10, 20),
    "gauss3": (6, 12, 24),
    "radau2": (40, 80, 160),
    "radau3": (8, 16, 32),
    "lobatto2": (20, 40, 80),
    "lobatto3": (8, 16, 32),
}
HEAVY = pytest.mark.slow  # seconds to write the functions


def is_heavy(name: str, pair: Pair) -> bool:
    """A free body turns as on SO(3), where all schemes are asked."""
    return name == "ur5" or (name == "SE(3)" and pair.num_stages > 1)


@cache
def steps_of(name: str, scheme: str) -> Steps:
    """The functions of all tests of a robot."""
    return Steps((FREE | HELD)[name].robot, scheme)


def order(errors: list[float]) -> float:
    """From the last two of errors with halved steps."""
    return float(np.log2(errors[-2] / errors[-1]))


def off(robot: Robot, x: Array, true: Array) -> float:
    nq = robot.nq
    return float(np.abs(np.append(robot.difference(true[:nq], x[:nq]), x[nq:] - true[nq:])).max())


def changes(values: list[Array]) -> list[float]:
    return [float(np.abs(b - a).max()) for a, b in pairwise(values)]


@pytest.mark.parametrize(
    ("name", "scheme"),
    [
        pytest.param(name, scheme, marks=[HEAVY] if is_heavy(name, pair) else [])
        for name in FREE
        for scheme, pair in PAIRS.items()
    ],
)
def test_states_and_adjoints(name: str, scheme: str) -> None:
    case, steps = FREE[name], steps_of(name, scheme)
    robot = steps.robot
    x, u = case.start(robot)
    (true,) = Truth(robot, u).states(x, np.array([case.duration]), TOLERANCE[False])
    runs = [steps.run(x, u, case.duration, n) for n in STEPS[scheme]]
    assert order([off(robot, run.xs[-1], true) for run in runs]) == pytest.approx(ORDER[scheme], abs=0.2)
    assert order(changes([run.slope for run in runs])) == pytest.approx(ORDER[scheme], abs=0.2)


def check_constraints(robot: Robot, run: Run) -> None:
    for x in run.xs:
        q, v = x[: robot.nq], x[robot.nq :]
        assert np.abs(robot.constraint_residual(q)).max() < 1e-12
        assert np.abs(robot.constraint_jacobian(q) @ v).max() < 1e-12


@pytest.mark.parametrize("scheme", ON_CONSTRAINTS)
@pytest.mark.parametrize("name", [*list(HELD)[:3], pytest.param("stewart", marks=HEAVY)])
def test_states_multipliers_and_adjoints_on_constraints(name: str, scheme: str) -> None:
    """Multipliers of the last stage are of half the order, those that follow from the last state of it."""
    case, steps = HELD[name], steps_of(name, scheme)
    robot = steps.robot
    x, u = case.start(robot)
    truth = Truth(robot, u)
    (true,) = truth.states(x, np.array([case.duration]), TOLERANCE[True])
    # What the platform is compared with is wrong by 5e-9, a fifth of the error of order 4 in 24 steps. Its
    # slopes, which are compared with each other, are of their order in finer steps alone.
    numbers = (4, 8, 16, 32) if name == "stewart" else (10, 20, 40)
    every_run = [steps.run(x, u, case.duration, n) for n in numbers]
    for run in every_run:
        check_constraints(robot, run)
    runs = every_run[:3]
    lam = truth.accelerations(true[: robot.nq], true[robot.nq :])[1]
    of_states = [truth.accelerations(r.xs[-1][: robot.nq], r.xs[-1][robot.nq :])[1] for r in runs]
    along = steps.consistent_tangents(x)
    assert order([off(robot, run.xs[-1], true) for run in runs]) == pytest.approx(ORDER[scheme], abs=0.2)
    slopes = [run.slope @ along for run in every_run[-3:]]
    assert order(changes(slopes)) == pytest.approx(ORDER[scheme], abs=0.2)
    assert order([float(np.abs(f - lam).max()) for f in of_states]) == pytest.approx(ORDER[scheme], abs=0.2)
    at_stage = order([float(np.abs(run.forces[-1, -1] - lam).max()) for run in runs])
    assert at_stage == pytest.approx(ORDER[scheme] / 2, abs=0.2)


@pytest.mark.parametrize("scheme", SYMPLECTIC)
@pytest.mark.parametrize("name", ["SO(3)", "SE(3)"])
def test_steps_on_groups_keep_the_canonical_form(name: str, scheme: str) -> None:
    """Without controls: a force in the axes of a body has no potential."""
    steps = steps_of(name, scheme)
    x, u = FREE[name].start(steps.robot)
    assert steps.symplectic_defect(x, 0 * u, 0.05) < 1e-9
    assert steps.symplectic_defect(x, u, 0.05) > 1e-6


@pytest.mark.parametrize("scheme", SYMPLECTIC)
@pytest.mark.parametrize("name", ["elastic_pendulum", pytest.param("ur5", marks=HEAVY)])
def test_steps_of_joints_keep_the_canonical_form(name: str, scheme: str) -> None:
    """Under controls, too, which are constant forces along coordinates."""
    steps = steps_of(name, scheme)
    x, u = FREE[name].start(steps.robot)
    assert steps.symplectic_defect(x, u, 0.02) < 1e-9


def held_by_a_rod(kind: str) -> Robot:
    """A body on one joint, a point of it on a rod to the world."""
    model, body = chain(kind)
    aside = pin.SE3(np.eye(3), np.array([0.3, 0.5, -0.4]))
    hook = model.addFrame(pin.Frame("hook", 1, body, aside, pin.FrameType.OP_FRAME))
    anchor = pin.SE3(np.eye(3), np.array([1.0, 0.4, 0.7]))
    wall = model.addFrame(pin.Frame("wall", 0, 0, anchor, pin.FrameType.OP_FRAME))
    length = float(np.linalg.norm(aside.translation - anchor.translation))  # at the neutral pose
    return robot_of(model, constraints=(Rod("rod", hook, wall, length),))


@pytest.mark.parametrize("scheme", ON_CONSTRAINTS)
@pytest.mark.parametrize("kind", ["Spherical", "FreeFlyer", "Spherical RX"])
def test_steps_on_groups_with_constraints_keep_the_canonical_form(kind: str, scheme: str) -> None:
    """On tangents of states that agree with the constraint; not where forces have no potential."""
    steps = Steps(held_by_a_rod(kind), scheme)
    robot = steps.robot
    rng = np.random.default_rng(7)
    v = null_space(robot.constraint_jacobian(robot.q0)) @ rng.standard_normal(robot.nv - robot.nc)
    x, u = np.append(robot.q0, v), rng.standard_normal(robot.nu)
    assert steps.consistent_tangents(x).shape == (2 * robot.nv, 2 * (robot.nv - robot.nc))
    assert steps.symplectic_defect(x, 0 * u, 0.05) < 1e-9
    assert steps.symplectic_defect(x, u, 0.05) > 1e-6


@pytest.mark.parametrize("scheme", ON_CONSTRAINTS)
@pytest.mark.parametrize("name", [*list(HELD)[:3], pytest.param("stewart", marks=HEAVY)])
def test_steps_of_loops_keep_the_canonical_form(name: str, scheme: str) -> None:
    """The platform of the last is a free-flyer on six loops."""
    case, steps = HELD[name], steps_of(name, scheme)
    x, u = case.start(steps.robot)
    assert steps.symplectic_defect(x, 0 * u, 0.01) < 1e-9


def driven(scheme: str, steps: int) -> Problem:
    """The unicycle at constant yaw rate and acceleration, its pendulum turning."""
    settings = (
        f"integrator.scheme={scheme}",
        "horizon.duration=1.0",
        f"horizon.steps={steps}",
        "start.v=[0, 0, 1, -2, 0.5, 0]",
        "guess.u=[1.5, 0.8]",
    )
    return load_problem(EXAMPLES / "so3/unicycle_pendulum.toml", settings)


def rate_of_unicycle(_: float, x: Array) -> Array:
    """Eqs. (4), (5), (27) of the second paper: x, y, quaternion, yaw, angular velocity, speed."""
    quaternion, s, u = x[2:6] / np.linalg.norm(x[2:6]), x[7:], np.array([1.5, 0.8])
    q = np.concatenate([x[:2], quaternion, x[6:7]])
    a_B = driven_acceleration(s, u, x[6], 0.0)[:2]
    towards = s[3] * np.array([np.cos(x[6]), np.sin(x[6])])
    turning = rate_of_quaternion(quaternion, s[:3])
    return np.concatenate([towards, turning, u[:1], closed_form(q, s, a_B), u[1:]])


@pytest.mark.parametrize(
    ("scheme", "expected", "steps"),
    [
        ("heun", 2, (40, 80)),
        ("rk4", 4, (20, 40)),
        pytest.param("rkf5", 5, (20, 40), marks=pytest.mark.slow),
    ],
)
def test_states_of_the_unicycle(scheme: str, expected: int, steps: tuple[int, int]) -> None:
    errors = []
    for count in steps:
        formulation = formulate(driven(scheme, count))
        at, xs = formulation.layout, guess_by_simulation(formulation, np.array([1.5, 0.8])).xs
        start, end = (np.append(x[at.z], x[at.s]) for x in (xs[0], xs[-1]))
        out = solve_ivp(rate_of_unicycle, (0.0, 1.0), start, method="DOP853", rtol=1e-13, atol=1e-13)
        errors.append(float(np.abs(end - out.y[:, -1]).max()))
    assert order(errors) == pytest.approx(expected, abs=0.2)

"""Explicit steps as functions, robots for them, and the motion that they approximate."""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from mbocp._arrays import Array
from mbocp.integrators.chain import Affine, Chain
from mbocp.integrators.runge_kutta import CoordinateState as StepState
from mbocp.integrators.runge_kutta import ExplicitStep, Gains
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.robot import Robot, Rod, SpringDamper, load_robot
from tests.mechanics.models import BODY, ORIGIN, POINT, chain, spherical_pendulum
from tests.mechanics.models import robot as robot_of

GAMMAS = (2.0, 1.0, 0.0)  # [1/s] quaternion, matrix, constraint: the defaults


def heavy_top() -> Robot:
    """Rigid body on a ball joint, its centre of mass beside the joint."""
    return robot_of(chain("Spherical")[0])


def several_groups() -> Robot:
    """Free-flyer, ball joint, joint without limits and planar joint in a row, a body at each."""
    model, parent = pin.Model(), 0
    inertia = pin.Inertia(0.8, np.array([0.1, -0.05, 0.2]), np.diag([0.3, 0.4, 0.5]))
    placement = pin.SE3(pin.exp3(np.array([0.2, -0.3, 0.1])), np.array([0.1, 0.2, -0.3]))
    for name in ("FreeFlyer", "Spherical", "RUBZ", "Planar"):
        parent = model.addJoint(parent, getattr(pin, f"JointModel{name}")(), placement, name)
        model.appendBodyToJoint(parent, inertia, ORIGIN)
    return robot_of(model)


def towed_body() -> Robot:
    """Free body on a spring, and a point mass on a rod to it."""
    model, body = chain("FreeFlyer", BODY)
    hook = model.addFrame(
        pin.Frame("hook", 1, body, pin.SE3(np.eye(3), np.array([0.2, 0, 0.1])), pin.FrameType.OP_FRAME)
    )
    model, bob = chain("PX PY PZ", POINT, model=model, prefix="bob_")
    spring = SpringDamper("spring", hook, 0, 3.0, damping=0.4, length=0.5)
    return robot_of(model, constraints=(Rod("rod", hook, bob, 1.5),), forces=(spring,))


def hector() -> Robot:
    return load_robot("hector", actuated=["root_joint"])


ROBOTS = {
    "heavy top": heavy_top,
    "hector": hector,
    "several groups": several_groups,
    "towed body": towed_body,
    "spherical pendulum": spherical_pendulum,
}


@cache
def robot_named(name: str) -> Robot:
    return ROBOTS[name]()


@cache
def mechanics_of(name: str, rotations: str) -> ForwardMechanics:
    return ForwardMechanics(robot_named(name), rotations)


@cache
def step_function(name: str, rotations: str, scheme: str, lie: str, substeps: int = 1) -> ca.Function:
    """One step of a `ROBOTS` entry: (z, s, u, dt, gammas) -> z, s."""
    mechanics = mechanics_of(name, rotations)
    z, s, u = ca.SX.sym("z", mechanics.nq), ca.SX.sym("s", mechanics.ns), ca.SX.sym("u", mechanics.nu)
    dt, gammas = ca.SX.sym("dt"), ca.SX.sym("gammas", 3)
    step = ExplicitStep(mechanics, scheme, lie, substeps)
    chain_of_values = Chain(ca.SX(0, 1))  # nothing is differentiated
    reached = step(
        chain_of_values,
        StepState(Affine(z, {}), Affine(s, {})),
        Affine(u, {}),
        dt,
        Gains(gammas[0], gammas[1], gammas[2]),
    )
    outputs = ca.cse([ca.densify(reached.z.value), ca.densify(reached.s.value)])
    return ca.Function("step", [z, s, u, dt, gammas], outputs)


class Simulation:
    """Forward simulation of one of `ROBOTS` with a constant control."""

    def __init__(self, name: str, rotations: str, scheme: str, lie: str, substeps: int = 1) -> None:
        self.robot = robot_named(name)
        self.space = ConfigurationSpace(self.robot.model, rotations)
        self.step = step_function(name, rotations, scheme, lie, substeps)

    def __call__(
        self, z: Array, s: Array, u: Array, duration: float, steps: int, gammas: tuple[float, ...] = GAMMAS
    ) -> tuple[Array, Array]:
        """Coordinates (steps + 1, nz) and speeds (steps + 1, ns) at all nodes."""
        at = ca.SX.sym("x", z.size + s.size)
        given = ca.SX.sym("given", u.size + 4)
        pieces = ca.vertsplit(at, [0, z.size, at.numel()])
        controls, dt, rates = ca.vertsplit(given, [0, u.size, u.size + 1, u.size + 4])
        once = ca.Function("once", [at, given], [ca.vertcat(*self.step(*pieces, controls, dt, rates))])
        numbers = np.concatenate([u, [duration / steps], gammas])
        xs = once.mapaccum("many", steps)(np.concatenate([z, s]), ca.repmat(ca.DM(numbers), 1, steps))
        whole = np.vstack([np.concatenate([z, s]), np.asarray(xs).T])
        return whole[:, : z.size], whole[:, z.size :]

    def coordinates(self, q: Array) -> Array:
        """Coordinates of one configuration."""
        z: Array = self.space.coordinates(q[None])[0]
        return z


def start_of(robot: Robot, seed: int = 3) -> tuple[Array, Array, Array]:
    """Configuration, velocity and constant control with nothing special about them."""
    rng = np.random.default_rng(seed)
    q = robot.integrate(robot.q0, rng.uniform(-1.0, 1.0, robot.nv))
    return q, rng.uniform(-1.0, 1.0, robot.nv), rng.uniform(-1.0, 1.0, robot.nu)


def reference(name: str, q: Array, v: Array, u: Array, duration: float) -> tuple[Array, Array]:
    """State at the end by an adaptive method on Pinocchio's own algorithms, in tangent space of the start.

    q(t) = q exp(w): the rate of w is J^-1(w) v with the Jacobian of Pinocchio's `integrate`.
    """
    robot = robot_named(name)
    model, data = robot.model, robot.model.createData()

    def rhs(_: float, x: Array) -> Array:
        w, speed = x[: robot.nv], x[robot.nv :]
        at = pin.integrate(model, q, w)
        along = pin.dIntegrate(model, q, w, pin.ArgumentPosition.ARG1)
        force = robot.actuation_matrix(at) @ u + robot.force_elements(at, speed)
        return np.concatenate([np.linalg.solve(along, speed), pin.aba(model, data, at, speed, force)])

    x = np.concatenate([np.zeros(robot.nv), v])
    out = solve_ivp(rhs, (0.0, duration), x, method="DOP853", rtol=3e-14, atol=1e-14)
    end = out.y[:, -1]
    return pin.integrate(model, q, end[: robot.nv]), end[robot.nv :]

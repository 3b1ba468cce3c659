"""Steps of symplectic partitioned methods one after another, by Newton's method on the stage functions."""

from __future__ import annotations

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.schemes.symplectic import PartitionedSteps
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.stage import build_functions
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import JointMechanics
from mbocp.robot import Robot
from mbocp.terms.kinds import Effort, ExactGoal

_SMALL = 1e-10  # of rows: from there on Newton's method ends where they fall no more


class Stepper:
    """Steps of a robot without controls, in (q, v)."""

    def __init__(self, robot: Robot, scheme: str, dt: float) -> None:
        steps, mechanics = PartitionedSteps(scheme), JointMechanics(robot)
        signature = FunctionSignature("", steps, ExactGoal("p", 0, 0), (Effort(),))
        self.robot = robot
        self.functions = build_functions(mechanics, signature, ("jacobian", "retract"))
        self.theta = np.concatenate([[dt, 1.0], np.zeros(robot.nu)])
        self.ndx, self.ny = 2 * robot.nv, steps.num_algebraic(mechanics, 0)
        self.u = np.zeros(robot.nu)
        q, v = ca.SX.sym("q", robot.nq), ca.SX.sym("v", robot.nv)
        p = mechanics.momentum(q, v)
        d = ca.SX.sym("d", robot.nv)
        slope = ca.jacobian(mechanics.momentum(mechanics.integrate(q, d), v), d)
        self._momentum = ca.Function("momentum", [q, v, d], [p, ca.substitute(slope, d, 0 * d)])
        energy = ca.dot(v, p) / 2 + mechanics.potential_energy(q)
        self._energy = ca.Function("energy", [q, v], [energy])

    def step(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """State and unknowns after a step, and the derivative of this state, shape (2 nv, 2 nv)."""
        x1, before = x, np.inf
        for _ in range(40):
            out = self.functions["jacobian"](x, x1, y, self.u, self.theta, np.zeros(0))
            c, dc = (np.asarray(ca.DM(out[i])) for i in (0, 2))
            own, size = dc[:, : self.ndx + self.ny], np.abs(c).max()
            if size < _SMALL and size >= 0.1 * before:
                break
            change, before = -np.linalg.solve(own, c.ravel()), size
            x1 = np.asarray(self.functions["retract"](x1, change[: self.ndx])).ravel()
            y = y + change[self.ndx :]
        assert size < _SMALL
        slope = -np.linalg.solve(own, dc[:, self.ndx + self.ny : 2 * self.ndx + self.ny])
        return x1, y, slope[: self.ndx]

    def run(self, x: Array, num_steps: int) -> Array:
        """States of all nodes, shape (num_steps + 1, nq + nv)."""
        xs, y = [x], np.zeros(self.ny)
        for _ in range(num_steps):
            x, y, _ = self.step(x, y)
            xs.append(x)
        return np.array(xs)

    def momentum(self, x: Array) -> Array:
        """p = M(q) v, shape (nv,)."""
        q, v = x[: self.robot.nq], x[self.robot.nq :]
        return np.asarray(self._momentum(q, v, np.zeros(self.robot.nv))[0]).ravel()

    def energy(self, x: Array) -> float:
        """Kinetic and potential energy [J]."""
        return float(self._energy(x[: self.robot.nq], x[self.robot.nq :]))

    def to_momenta(self, x: Array) -> Array:
        """From (dq, dv) to (dq, dp), shape (2 nv, 2 nv)."""
        q, v, nv = x[: self.robot.nq], x[self.robot.nq :], self.robot.nv
        slope = np.asarray(self._momentum(q, v, np.zeros(nv))[1])
        return np.block([[np.eye(nv), np.zeros((nv, nv))], [slope, self.robot.mass_matrix(q)]])

    def two_form(self, x: Array) -> Array:
        """Canonical two-form at a state."""
        return two_form_of(self.robot, self.momentum(x))


def two_form_of(robot: Robot, p: Array) -> Array:
    """Canonical two-form on (dq, dp) in body frames: dq . dp' - dq' . dp + p . [dq, dq']."""
    nv, space = robot.nv, ConfigurationSpace(robot.model)
    every = np.eye(nv)
    form = np.block([[np.zeros((nv, nv)), every], [-every, np.zeros((nv, nv))]])
    a, b = ca.SX.sym("a", nv), ca.SX.sym("b", nv)
    along = ca.Function("along", [a, b], [ca.dot(ca.DM(p), space.bracket(a, b))])
    for i, j in np.ndindex(nv, nv):
        form[i, j] += float(along(every[i], every[j]))
    return form

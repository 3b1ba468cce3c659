"""Steps of symplectic partitioned methods from their rows alone, and the motion that they approximate.

No stage functions with their Hessians are made: large mechanisms are quick.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from mbocp._arrays import Array
from mbocp.integrators import PAIRS
from mbocp.integrators.chain import Affine, Chain
from mbocp.integrators.partitioned_runge_kutta import ChainNode, PartitionedStep, Stage
from mbocp.mechanics import JointMechanics
from mbocp.robot import Robot
from tests.integrators.partitioned import two_form_of
from tests.integrators.test_symplecticity import null_space

_SMALL = 1e-9  # of rows: from there on Newton's method ends where they fall no more
_SHIFT = 2e-5  # of a difference quotient [s]


@dataclass(frozen=True)
class Run:
    """Nodes of a simulation.

    Attributes
    ----------
    xs : ndarray, shape (N + 1, nq + nv)
    forces : ndarray, shape (N, s, nc)
        Multipliers of the constraints at the stages.
    slope : ndarray, shape (2 nv, 2 nv)
        Derivative of the last state in the first, in tangents: adjoints of the first are those of the last
        times this.
    """

    xs: Array
    forces: Array
    slope: Array


class Steps:
    """Steps of a robot under constant controls."""

    def __init__(self, robot: Robot, scheme: str) -> None:
        mechanics, self.pair, self.robot = JointMechanics(robot), PAIRS[scheme], robot
        self._rows, self._moved = _functions(mechanics, scheme)
        self.nv, self.nc, self.num_stages = robot.nv, robot.nc, self.pair.num_stages
        self.ny = self.num_stages * (self.nv + self.nc)
        self._momentum, self._consistency = _momentum(mechanics), _consistency(mechanics)

    def step(self, x: Array, y: Array, u: Array, h: float) -> tuple[Array, Array, Array]:
        """State and unknowns after a step, and the derivative of this state, shape (2 nv, 2 nv)."""
        x1, before, ndx = x, np.inf, 2 * self.nv
        for _ in range(60):
            c, dc = (out.full() for out in self._rows(x, x1, y, u, h))
            own, size = dc[:, : ndx + self.ny], np.abs(c).max()
            if size < _SMALL and size >= 0.2 * before:
                break
            change, before = -np.linalg.solve(own, c.ravel()), size
            x1 = self._moved(x1, change[:ndx]).full().ravel()
            y = y + change[ndx:]
        assert size < _SMALL
        slope: Array = -np.linalg.solve(own, dc[:, ndx + self.ny :])[:ndx]
        return x1, y, slope

    def run(self, x: Array, u: Array, duration: float, num_steps: int) -> Run:
        """Simulate with steps of equal length."""
        xs, y, h, slope, forces = [x], np.zeros(self.ny), duration / num_steps, np.eye(2 * self.nv), []
        held = self.num_stages * self.nv
        for _ in range(num_steps):
            x, y, own = self.step(x, y, u, h)
            xs.append(x)
            slope = own @ slope
            forces.append(y[held:].reshape(self.num_stages, self.nc) / h)
        return Run(np.array(xs), np.array(forces), slope)

    def symplectic_defect(self, x: Array, u: Array, h: float) -> float:
        """Largest entry of F' J F - J by that of J, F the derivative of a step in (q, p).

        On tangents of states that agree with the constraints.
        """
        x1, _, slope = self.step(x, np.zeros(self.ny), u, h)
        along = self.consistent_tangents(x)
        start, end = self._to_momenta(x) @ along, self._to_momenta(x1) @ slope @ along
        before, after = start.T @ self._two_form(x) @ start, end.T @ self._two_form(x1) @ end
        return float(np.abs(after - before).max() / (1.0 + np.abs(before).max()))

    def consistent_tangents(self, x: Array) -> Array:
        """Basis of the tangents of states that agree with the constraints, shape (2 nv, 2 (nv - nc))."""
        if not self.nc:
            return np.eye(2 * self.nv)
        _, slopes = self._consistency(*self._parts(x))
        return null_space(slopes.full())

    def _to_momenta(self, x: Array) -> Array:
        _, slope, mass = (out.full() for out in self._momentum(*self._parts(x)))
        return np.block([[np.eye(self.nv), np.zeros((self.nv, self.nv))], [slope, mass]])

    def _two_form(self, x: Array) -> Array:
        return two_form_of(self.robot, self._momentum(*self._parts(x))[0].full().ravel())

    def _parts(self, x: Array) -> tuple[Array, Array]:
        return x[: self.robot.nq], x[self.robot.nq :]


def _functions(mechanics: JointMechanics, scheme: str) -> tuple[ca.Function, ca.Function]:
    """Rows of a step with their derivatives in (d1, y, d0); and states moved along tangents."""
    nq, nv, nc, s = mechanics.nq, mechanics.nv, mechanics.nc, PAIRS[scheme].num_stages
    x0, x1 = ca.SX.sym("x0", nq + nv), ca.SX.sym("x1", nq + nv)
    u, h = ca.SX.sym("u", mechanics.nu), ca.SX.sym("h")
    d1, y, d0 = ca.SX.sym("d1", 2 * nv), ca.SX.sym("y", s * (nv + nc)), ca.SX.sym("d0", 2 * nv)

    def moved(x: ca.SX, d: ca.SX) -> tuple[ca.SX, ca.SX]:
        return mechanics.integrate(x[:nq], d[:nv]), x[nq:] + d[nv:]

    chain = Chain(ca.vertcat(ca.SX.zeros(2 * nv), y, ca.SX.zeros(2 * nv)))
    root = chain.root()
    own = root.split(2 * nv, y.numel(), 2 * nv)
    pieces = own[1].split(*[nv] * s, *[nc] * s)

    def node(x: ca.SX, d: ca.SX, at: Affine) -> ChainNode:
        function = ca.Function("node", [d, x], list(moved(x, d)))
        return ChainNode(*chain.apply(function, [at], [x]))

    stages = [Stage(*pair) for pair in zip(pieces[:s], pieces[s:], strict=True)]
    step = PartitionedStep(mechanics, scheme, compares_coordinates=False)
    rows = step(chain, node(x0, d0, own[2]), node(x1, d1, own[0]), stages, [Affine(u, {})] * s, h)
    c = Affine.join([rows.kinematic, rows.momentum, *rows.stages, *rows.constraints])
    out = [ca.densify(c.value), ca.densify(chain.jacobian(c))]
    d = ca.SX.sym("d", 2 * nv)
    return (
        ca.Function("rows", [x0, x1, y, u, h], out),
        ca.Function("moved", [x0, d], [ca.vertcat(*moved(x0, d))]),
    )


def _momentum(mechanics: JointMechanics) -> ca.Function:
    """p = M(q) v, and its derivatives in tangents of q and in v."""
    q, v = ca.SX.sym("q", mechanics.nq), ca.SX.sym("v", mechanics.nv)
    d = ca.SX.sym("d", mechanics.nv)
    p = mechanics.momentum(mechanics.integrate(q, d), v)
    out = [ca.substitute(e, d, 0 * d) for e in (p, ca.jacobian(p, d), ca.jacobian(p, v))]
    return ca.Function("momentum", [q, v], [ca.densify(e) for e in out])


def _consistency(mechanics: JointMechanics) -> ca.Function:
    """What vanishes in states that agree with the constraints, and its derivative in (dq, dv)."""
    q, v = ca.SX.sym("q", mechanics.nq), ca.SX.sym("v", mechanics.nv)
    d = ca.SX.sym("d", 2 * mechanics.nv)
    moved = mechanics.integrate(q, d[: mechanics.nv])
    rate = mechanics.constraint_jacobian(moved) @ (v + d[mechanics.nv :])
    rows = ca.vertcat(mechanics.constraints(moved), rate)
    out = [ca.densify(ca.substitute(e, d, 0 * d)) for e in (rows, ca.jacobian(rows, d))]
    return ca.Function("consistency", [q, v], out)


class Truth:
    """The motion of a robot under constant controls, by Pinocchio's own algorithms."""

    def __init__(self, robot: Robot, u: Array) -> None:
        self.robot, self.u, self._data = robot, u, robot.model.createData()

    def accelerations(self, q: Array, v: Array) -> tuple[Array, Array]:
        """dv/dt, and the multipliers of the constraints."""
        robot, nc = self.robot, self.robot.nc
        force = robot.actuation_matrix(q) @ self.u + robot.force_elements(q, v)
        left = force - pin.nonLinearEffects(robot.model, self._data, q, v)
        if not nc:
            return np.linalg.solve(robot.mass_matrix(q), left), np.zeros(0)
        at = robot.constraint_jacobian(q)

        def rate(t: float) -> Array:
            found: Array = robot.constraint_jacobian(robot.integrate(q, t * v)) @ v
            return found

        bias = (rate(_SHIFT) - rate(-_SHIFT)) / (2 * _SHIFT)
        block = np.block([[robot.mass_matrix(q), at.T], [at, np.zeros((nc, nc))]])
        found = np.linalg.solve(block, np.append(left, -bias))
        return found[: robot.nv], found[robot.nv :]

    def states(self, x: Array, times: Array, tolerance: float) -> Array:
        """States at times, shape (k, nq + nv), by an adaptive method in the tangent space of the start."""
        robot, q0, nv = self.robot, x[: self.robot.nq], self.robot.nv

        def rhs(_: float, z: Array) -> Array:
            w, v = z[:nv], z[nv:]
            along = pin.dIntegrate(robot.model, q0, w, pin.ArgumentPosition.ARG1)
            q = pin.integrate(robot.model, q0, w)
            return np.append(np.linalg.solve(along, v), self.accelerations(q, v)[0])

        start = np.append(np.zeros(nv), x[robot.nq :])
        out = solve_ivp(
            rhs, (0.0, times[-1]), start, method="DOP853", t_eval=times, rtol=tolerance, atol=tolerance
        )
        return np.array([np.append(pin.integrate(robot.model, q0, z[:nv]), z[nv:]) for z in out.y.T])

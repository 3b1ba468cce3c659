r"""A stage of many integration steps that grows by none of them in code: one step compiled, called in turn.

Figure 12 of [Manara2017]_ varies the number of integration steps within an interval up to where a stage
written out in one piece takes many minutes to compile. Here values, Jacobian and Hessian of one step are
compiled, and the chain rule joins them, step after step,

.. math::
    T_{k+1} = J_k T_k, \qquad
    H = \sum_k T_k^T\, \nabla^2 (m_k \cdot \phi)\, T_k, \qquad m_k = A_k^T m_{k+1},

with the derivatives :math:`J_k = (A_k, B_k)` of a step in state and control.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.formulation import Formulation, formulate
from mbocp.formulation.signature import sources_digest
from mbocp.integrators.chain import Affine, Chain
from mbocp.integrators.runge_kutta import CoordinateState, ExplicitStep, Gains
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.problem import Problem
from mbocp.programme import StagewiseProgramme
from mbocp.programme.compilation import CompiledFunctions, load_functions
from mbocp.robot import Robot
from mbocp.solvers.reachability import dependent_end_rows


@dataclass(frozen=True)
class Method:
    """How an interval is integrated.

    Attributes
    ----------
    scheme : {"euler", "heun", "rk4", "rkf5"}
    lie : {"plain", "baumgarte", "munthe_kaas"}
    substeps : int
    """

    scheme: str
    lie: str
    substeps: int


@dataclass(frozen=True, eq=False)
class SteppedProgramme:
    """A programme and the step that it is made of.

    Attributes
    ----------
    problem : Problem
        Its robot, horizon, cost and goal; what it says of the integrator does not matter.
    formulation : Formulation
        What states and controls are.
    programme : StagewiseProgramme
        As for a solver, with stage functions made of this step.
    step : casadi.Function
        (state and control, length of a step, gains) -> state.
    method : Method
    """

    problem: Problem
    formulation: Formulation
    programme: StagewiseProgramme
    step: ca.Function
    method: Method

    def simulate(self, us: Array) -> Array:
        """States (z, s) at the ends of the intervals, from the start, shape (N + 1, nz + ns)."""
        at, h = self.formulation.layout, self.problem.dt / self.method.substeps
        states = [self.programme.x_start[: at.nz + at.ns]]
        for u in us:
            state = states[-1]
            for _ in range(self.method.substeps):
                state = np.asarray(self.step(np.concatenate([state, u]), h, _gains(self.problem))).ravel()
            states.append(state)
        return np.array(states)


def stepped_programme(problem: Problem, method: Method) -> SteppedProgramme:
    """Programme of a problem, whose intervals are integrated by a method with any number of steps.

    Parameters
    ----------
    problem : Problem
        With an explicit scheme and an interior-point solver; its own scheme serves for the costs alone, so
        "euler" is compiled fastest.
    method : Method
    """
    base = formulate(problem)
    left_out = dependent_end_rows(base.programme, base.end_rows.of_joints)
    base = formulate(problem, left_out) if left_out else base
    kernels = _kernels(problem.robot, method)
    functions = CompiledFunctions.interpret(_Stage(problem, base, kernels, method.substeps).functions())
    programme = replace(base.programme, functions=functions)
    return SteppedProgramme(problem, base, programme, kernels.function("step"), method)


def _kernels(robot: Robot, method: Method) -> CompiledFunctions:
    """One step as machine code."""
    sources = sources_digest() + hashlib.sha256(Path(__file__).read_bytes()).hexdigest()
    key = f"so3 step {robot.fingerprint} {robot.rotations} {method.scheme} {method.lie} {sources}"
    return load_functions(key, lambda: _build(robot, method))


def _build(robot: Robot, method: Method) -> dict[str, ca.Function]:
    """Functions of one step: values; values and Jacobian; upper Hessian of m'values."""
    mechanics = ForwardMechanics(robot, robot.rotations)
    nz, ns, nu = mechanics.nq, mechanics.ns, mechanics.nu
    x, m = ca.SX.sym("x", nz + ns + nu), ca.SX.sym("m", nz + ns)
    h, gains = ca.SX.sym("h"), ca.SX.sym("gains", 3)
    chain = Chain(x)
    root = chain.root()
    z, s, u = root.split(nz, ns, nu)
    before = CoordinateState(z, s)
    one = ExplicitStep(mechanics, method.scheme, method.lie, 1)
    after = Affine.join(one(chain, before, u, h, Gains(gains[0], gains[1], gains[2])))
    value, jacobian, hessian = after.value, chain.jacobian(after), chain.hessian(after, m)
    return {
        "step": ca.Function("step", [x, h, gains], ca.cse([value])),
        "step_jacobian": ca.Function("step_jacobian", [x, h, gains], ca.cse([value, jacobian])),
        "step_hessian": ca.Function("step_hessian", [x, m, h, gains], ca.cse([ca.triu(hessian)])),
    }


def _gains(problem: Problem) -> Array:
    rates = problem.stabilisation
    return np.array([rates.gamma_quaternion, rates.gamma_dcm, rates.gamma_constraint])


class _Stage:
    """Stage functions like those of `mbocp.formulation.stage`, made of calls."""

    def __init__(
        self, problem: Problem, formulation: Formulation, kernels: CompiledFunctions, substeps: int
    ) -> None:
        base = formulation.programme
        self._at, self._nu, self._substeps = formulation.layout, problem.robot.nu, substeps
        self._h, self._gains = problem.dt / substeps, ca.DM(_gains(problem))
        names = ("values", "gradient", "jacobian", "complete", "retract", "difference")
        self._base = {name: base.functions.function(name) for name in names}
        self._step = {name: kernels.function(name) for name in ("step", "step_jacobian", "step_hessian")}
        at = self._at
        nx = at.nx
        self.x0, self.x1 = ca.MX.sym("x0", nx), ca.MX.sym("x1", nx)
        self.y, self.u = ca.MX.sym("y", 0), ca.MX.sym("u", self._nu)
        self.m = ca.MX.sym("m", nx)
        self.theta = ca.MX.sym("theta", base.theta.size)
        self.rho = ca.MX.sym("rho", base.kind.nr)
        self._num = at.nz + at.ns  # what a step moves

    def functions(self) -> dict[str, ca.Function]:
        """By name."""
        before = [self.x0, self.x1, self.y, self.u]
        given = [*before, self.theta, self.rho]
        with_m = [*before, self.m, self.theta, self.rho]
        costs = self._base["values"].call(given)
        slopes = self._base["jacobian"].call(given)
        zero = ca.MX.zeros(self.m.shape)
        curved = self._base["complete"].call([*before, zero, self.theta, self.rho])
        states, jacobians = self._forward()
        c, dc_dz = self._rows(states[-1]), self._row_slopes(self._chain_up(jacobians)[-1])
        hessian = ca.triu(curved[4] + self._hessian(states, jacobians))
        return {
            "values": ca.Function("values", given, [self._rows(self._last()), costs[1]]),
            "gradient": ca.Function("gradient", given, [self._base["gradient"].call(given)[0]]),
            "jacobian": ca.Function("jacobian", given, [c, slopes[1], dc_dz, slopes[3]]),
            "complete": ca.Function("complete", with_m, [c, curved[1], dc_dz, curved[3], hessian]),
            "retract": self._base["retract"],
            "difference": self._base["difference"],
        }

    def _last(self) -> ca.MX:
        state = self.x0[: self._num]
        for _ in range(self._substeps):
            state = self._step["step"](ca.vertcat(state, self.u), self._h, self._gains)
        return state

    def _forward(self) -> tuple[list[ca.MX], list[ca.MX]]:
        """States before and after each step, and each step's Jacobian."""
        states, jacobians = [self.x0[: self._num]], []
        for _ in range(self._substeps):
            state, jacobian = self._step["step_jacobian"].call(
                [ca.vertcat(states[-1], self.u), self._h, self._gains]
            )
            states.append(state)
            jacobians.append(jacobian)
        return states, jacobians

    def _chain_up(self, jacobians: list[ca.MX]) -> list[ca.MX]:
        """Derivatives of the states in the first state and the control."""
        size = self._num + self._nu
        first = ca.DM.eye(size)[: self._num, :]
        below = ca.DM.eye(size)[self._num :, :]
        slopes = [ca.MX(first)]
        for jacobian in jacobians:
            slopes.append(jacobian @ ca.vertcat(slopes[-1], below))
        return slopes

    def _rows(self, reached: ca.MX) -> ca.MX:
        return ca.vertcat(reached - self.x1[: self._num], self.u - self.x1[self._at.r])

    def _row_slopes(self, slope: ca.MX) -> ca.MX:
        """Derivative of the rows in (x1, x0, u)."""
        at, n, nr = self._at, self._num, self._at.nr
        minus = -ca.DM.eye(at.nx)
        moved = ca.horzcat(slope[:, :n], ca.MX(n, nr), slope[:, n:])
        kept = ca.horzcat(ca.DM(nr, at.nx), ca.DM.eye(self._nu) if nr else ca.DM(0, self._nu))
        return ca.horzcat(minus, ca.vertcat(moved, kept))

    def _hessian(self, states: list[ca.MX], jacobians: list[ca.MX]) -> ca.MX:
        """Second derivative of m'c in (x1, x0, u)."""
        at, n, size = self._at, self._num, self._num + self._nu
        slopes, below = self._chain_up(jacobians), ca.DM.eye(size)[n:, :]
        adjoint, total = self.m[:n], ca.MX(size, size)
        for k in reversed(range(self._substeps)):
            upper = self._step["step_hessian"](ca.vertcat(states[k], self.u), adjoint, self._h, self._gains)
            curvature = upper + ca.triu(upper, False).T
            direction = ca.vertcat(slopes[k], below)
            total += direction.T @ (curvature @ direction)
            adjoint = jacobians[k][:, :n].T @ adjoint
        place = np.concatenate([at.nx + np.arange(n), 2 * at.nx + np.arange(self._nu)])
        chosen = ca.DM(
            ca.Sparsity.triplet(size, 2 * at.nx + self._nu, list(range(size)), place.tolist()), 1.0
        )
        return chosen.T @ (total @ chosen)

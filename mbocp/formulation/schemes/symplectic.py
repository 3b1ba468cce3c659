"""Joint coordinates on their Lie groups with symplectic partitioned methods: Gauss, and Lobatto's pair.

Rates of stages and impulses at them are unknowns of the step.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.base import Duals
from mbocp.formulation.build import needs_plain_states, signature_of
from mbocp.formulation.end_rows import end_condition_rows
from mbocp.formulation.features.accelerations import acceleration_at, mean_acceleration
from mbocp.formulation.motion import Motion
from mbocp.formulation.pieces import Algebraic, Pieces, RowLabels
from mbocp.formulation.schemes.joint_states import (
    JointFormulation,
    boundary_duals,
    joint_pieces,
    tangent_duals,
)
from mbocp.formulation.steps import StepDerivatives, Steps, StepSymbols
from mbocp.integrators import PAIRS, Pair, State
from mbocp.integrators.chain import Affine, Chain
from mbocp.integrators.partitioned_runge_kutta import ChainNode, PartitionedRows, PartitionedStep, Stage
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import JointMechanics, Mechanics, duals_of_momenta
from mbocp.problem import Problem
from mbocp.programme import Iterate, zero_multipliers
from mbocp.robot import Label
from mbocp.robot.nodes import steps_between

_INSIDE = 1e-9  # of a step: what is nearer to an end is the end, but for round-off
_OPERATIONS = 1500  # of "complete" by nv^2 and stage of the method, with arms and chains


@dataclass(frozen=True)
class PartitionedSteps(Steps):
    """Equations between two states in joint coordinates, with stages between them; see `Steps`."""

    tau = 0.5
    remedy = "Take a scheme of fewer stages, or lock joints"

    def operations(self, nv: int) -> float:
        """Second derivatives of a tree are dense, and those of each stage are its own."""
        return float(_OPERATIONS * nv**2 * PAIRS[self.scheme].num_stages)

    def num_algebraic(self, mechanics: Mechanics, num_held: int) -> int:
        """The rates of the stages, then one impulse for each constraint at each stage."""
        return PAIRS[self.scheme].num_stages * (mechanics.nv + mechanics.nc)

    def derivatives(self, symbols: StepSymbols) -> StepDerivatives:
        """Rows and cost of a step, with exact first and second derivatives."""
        mechanics = symbols.mechanics_of_links
        if not isinstance(mechanics, JointMechanics):
            raise TypeError("a partitioned scheme needs JointMechanics")
        is_flat = symbols.space.layout.is_flat
        step = PartitionedStep(mechanics, self.scheme, compares_coordinates=is_flat)
        return _Derivation(mechanics, step, symbols).derivatives()


class _Derivation:
    """One step as a chain from its unknowns z = (x1, y, x0, u) to its rows and its cost."""

    def __init__(self, mechanics: JointMechanics, step: PartitionedStep, at: StepSymbols) -> None:
        self._mechanics, self._step, self._at = mechanics, step, at
        ndx = at.space.layout.ndx
        ny, nu = at.y.numel(), at.space.layout.num_own
        self._symbols = [at.d1, at.y, at.d0, at.inputs]
        still, is_flat = ca.SX.zeros(ndx), at.space.layout.is_flat
        self._given = [at.theta, at.rho] if is_flat else [at.x0, at.x1, at.theta, at.rho]
        values = self._symbols if is_flat else [still, at.y, still, at.inputs]
        self._chain = Chain(ca.vertcat(*values), may_call=True)
        root = self._chain.root()
        self._root = root.split(ndx, ny, ndx, at.inputs.numel())
        self._y, self._u = self._root[1], self._root[3].take(slice(nu))

    def derivatives(self) -> StepDerivatives:
        """Rows in the order kinematics, momentum, memory, length, stages, constraints."""
        at, chain = self._at, self._chain
        rows = self._rows()
        in_units = 1.0 / at.given["force"]
        more = ca.vertcat(at.memory_rows, at.own_rows)
        kept = [self._link(more)] if more.numel() else []
        stages = [in_units * row for row in rows.stages]
        pieces = [rows.kinematic, in_units * rows.momentum, *kept, *stages, *rows.constraints]
        c, cost = Affine.join(pieces), self._cost(rows.points)
        both = Affine.join([c, cost])
        hessian = ca.triu(chain.hessian(both, ca.vertcat(at.m, 1)))
        slopes = chain.jacobian(c), chain.jacobian(cost)
        found = ca.densify(c.value), cost.value, *slopes, hessian
        return StepDerivatives(*found, partial(self._compute_lengthening, found[:2]), chain.resolve)

    def _compute_lengthening(self, c_and_cost: Sequence[ca.SX]) -> ca.SX:
        at, (c, cost) = self._at, self._chain.resolve(c_and_cost)
        by_theta = ca.gradient(cost + ca.dot(at.m, c), at.theta)
        return at.given["dt"] * (ca.jacobian(at.given["dt"], at.theta) @ by_theta)

    def _rows(self) -> PartitionedRows:
        at = self._at
        before, after = (self._node(state) for state in (at.at0, at.at1))
        pushed = self._controls()
        h = self._link(at.dt) if at.has_free_length else at.dt
        found = [self._link(at.found)] if at.found.numel() else []
        return self._step(self._chain, before, after, self._stages(), pushed, h, found)

    def _controls(self) -> list[Affine]:
        """Those of each stage."""
        at, pair = self._at, self._step.pair
        if at.shares:
            return [self._link(at.controls_at(c)) for c in pair.c]
        units = ca.diag(at.units_of_u)
        pushed = Affine(units @ self._u.value, {k: units @ m for k, m in self._u.parts.items()})
        return [pushed] * pair.num_stages

    def _stages(self) -> list[Stage]:
        nv, nc, s = self._mechanics.nv, self._mechanics.nc, self._step.pair.num_stages
        pieces = self._y.split(*[nv] * s, *[nc] * s)
        force = self._at.given["force"]
        return [Stage(rate, force * impulse) for rate, impulse in zip(pieces[:s], pieces[s:], strict=True)]

    def _node(self, state: ca.SX) -> ChainNode:
        layout = self._at.space.layout
        return ChainNode(self._link(state[layout.z]), self._link(state[layout.s]))

    def _cost(self, points: tuple[ChainNode, ...]) -> Affine:
        """Quadrature of the running cost with the weights of the method."""
        at, pair, s = self._at, self._step.pair, self._at.space.layout.s
        layout = at.space.layout
        before, after = (State(x[layout.z], x[layout.s]) for x in (at.at0, at.at1))
        qs = [ca.SX.sym("q", self._mechanics.nq) for _ in points]
        vs = [ca.SX.sym("v", s.stop - s.start) for _ in points]
        inner = [
            (c, State(q, v)) for c, q, v in zip(pair.c, qs, vs, strict=True) if _INSIDE < c < 1.0 - _INSIDE
        ]
        between = [(0.0, before), *inner, (1.0, after)]
        cost = ca.SX(0)
        for weight, c, q, v in zip(pair.b, pair.c, qs, vs, strict=True):
            if not at.shares:
                acceleration = partial(mean_acceleration, self._mechanics, before, after, at.dt)
                cost += weight * at.running_cost(q, v, acceleration, share=c)
                continue
            acceleration = partial(acceleration_at, self._mechanics, c, between, at.dt)
            cost += weight * at.running_cost(q, v, acceleration, share=c, control=at.controls_at(c))
        moving = [*self._symbols, *qs, *vs]
        function = ca.Function("cost", [*moving, *self._given], [ca.densify(cost)])
        nodes = [*(point.q for point in points), *(point.v for point in points)]
        return self._chain.apply(function, [*self._root, *nodes], self._given)[0]

    def _link(self, expression: ca.SX) -> Affine:
        """An expression in the symbols of the step as a link."""
        function = ca.Function("made", [*self._symbols, *self._given], [ca.densify(expression)])
        return self._chain.apply(function, self._root, self._given)[0]


@dataclass(frozen=True, eq=False)
class PartitionedFormulation(JointFormulation):
    """States are (q, v) of the joints; steps have stages, whose rates are unknowns."""

    # Adjoints are not kept: rows of stages have multipliers that a solution does not store.
    tau = force_tau = 0.5

    @classmethod
    def pieces_of(cls, problem: Problem) -> Pieces:
        """See `Formulation.pieces_of`."""
        robot, pair = problem.robot, PAIRS[problem.scheme]
        space = ConfigurationSpace(robot.model, "quaternion")
        rows = end_condition_rows(robot, problem.goal)
        is_flat = needs_plain_states(problem) or robot.is_vector_space
        signature = signature_of(problem, space, rows, PartitionedSteps(problem.scheme), is_flat=is_flat)
        words = RowLabels(
            robot.v_labels,
            "momentum balance",
            robot.v_labels,
            tuple(robot.constraint_labels) * pair.num_stages,
            _words_of_stages(pair, robot.v_labels),
        )
        algebraic = _algebraic(pair, robot.nv, robot.nc, problem.dt)
        own = (algebraic, problem.v_start, problem.limits_along()["v"])
        return joint_pieces(problem, signature, space, rows, *own, words)

    @property
    def pair(self) -> Pair:
        """Coefficients of the scheme."""
        return PAIRS[self.problem.scheme]

    def iterate_of(self, motion: Motion, lams: Array) -> Iterate:
        """Iterate at a motion, with rates of stages of the cubic through both nodes; adjoints are zero."""
        dts = motion.dts[:, None]
        xs, us = self.states_and_controls(motion, motion.vs, lams)
        rates = self._rates(motion)
        ys = np.hstack([*rates, *[dts * lams] * self.pair.num_stages])
        return zero_multipliers(self.programme, xs, ys, us)

    def _rates(self, motion: Motion) -> list[Array]:
        vs = motion.vs
        mean = steps_between(self.problem.robot, motion.qs) / motion.dts[:, None]
        return [
            6 * c * (1 - c) * mean + (1 - c) * (1 - 3 * c) * vs[:-1] + c * (3 * c - 2) * vs[1:]
            for c in self.pair.c
        ]

    def duals_of(self, iterate: Iterate, motion: Motion) -> Duals:
        """Multipliers and adjoints of an iterate and its motion.

        The constraints' multipliers are the means over the stages; zeta is that of the row at the end.
        """
        problem, dts, nc = self.problem, motion.dts[:, None], self.problem.robot.nc
        nv, s, b = problem.robot.nv, self.pair.num_stages, np.array(self.pair.b)
        states = boundary_duals(self.programme, iterate)
        costates = tangent_duals(self.space, self.layout, iterate.xs[:, self.layout.z], states)
        stages = iterate.ys[:, s * nv :].reshape(len(dts), s, nc)
        of_end = iterate.ms[:, self.layout.ndx + s * nv + max(s - 2, 0) * nc :][:, :nc]
        return Duals(
            lams=np.einsum("s,nsc->nc", b, stages) / dts,
            zetas=of_end / dts**2,
            states=states,
            costates=costates,
            mus=duals_of_momenta(problem.robot, motion.qs, motion.vs, costates),
        )

    def hamiltonians(self, iterate: Iterate, motion: Motion, duals: Duals) -> Array:
        """Derivative of the Lagrangian in the length of each step, shape (N,); NaN where functions fail.

        It is what H is constant for: with a free duration its mean vanishes.
        """
        programme, N = self.programme, len(motion.us)
        arguments = (iterate.xs[:-1], iterate.xs[1:], iterate.ys, iterate.us, iterate.ms)
        theta, rho = np.tile(programme.theta[:, None], (1, N)), programme.rho.reshape(N, -1)
        slopes = programme.functions.function("lengthening").map(N)
        try:
            found = np.asarray(slopes(*(a.T for a in arguments), theta, rho.T)).ravel()
        except RuntimeError:  # what CasADi raises where a compiled function reports that it failed
            return np.full(N, np.nan)
        return found / motion.dts


def _algebraic(pair: Pair, nv: int, nc: int, dt: float) -> Algebraic:
    """Rates of stages, then impulses; their rows are momenta of stages, Phi / dt, and Phi_q v at the end."""
    rates, held = pair.num_stages * nv, pair.num_stages * nc
    is_rate = np.arange(rates + held) < rates
    is_drift = np.arange(rates + held) >= rates + held - nc
    return Algebraic(
        scale_c=np.where(is_rate | is_drift, 1.0, dt),
        scale_y=np.where(is_rate, 1.0, 1 / dt),
        scale_m=np.where(is_rate, 1.0, 1 / dt),
        is_force=~is_rate,
        is_balance=is_rate,
    )


def _words_of_stages(pair: Pair, labels: Sequence[Label]) -> tuple[str, ...]:
    return tuple(
        f"momentum balance of {label.name} at stage {i + 1}"
        for i in range(pair.num_stages)
        for label in labels
    )

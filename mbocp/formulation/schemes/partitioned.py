"""Joint coordinates on their Lie groups with symplectic partitioned methods: Gauss, and Lobatto's pair."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.base import Duals
from mbocp.formulation.build import needs_plain_states, signature_of
from mbocp.formulation.goal import end_condition_rows
from mbocp.formulation.motion import Motion
from mbocp.formulation.pieces import RowLabels
from mbocp.formulation.schemes.algebraic import Algebraic
from mbocp.formulation.schemes.joint import (
    JointFormulation,
    boundary_duals,
    joint_pieces,
    tangent_duals,
)
from mbocp.formulation.schemes.partitioned_steps import PartitionedSteps
from mbocp.integrators import PAIRS, Pair
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import duals_of_momenta
from mbocp.programme import Iterate, zero_multipliers
from mbocp.robot import Label
from mbocp.robot.nodes import steps_between

if TYPE_CHECKING:
    from mbocp.problem import Problem


@dataclass(frozen=True, eq=False)
class PartitionedFormulation(JointFormulation):
    """States are (q, v) of the joints; steps have stages, whose rates are unknowns."""

    # Adjoints are not kept: rows of stages have multipliers that a solution does not store.
    tau = force_tau = 0.5

    @classmethod
    def of(cls, problem: Problem, *, deadline: float = math.inf) -> PartitionedFormulation:
        """See `mbocp.formulation.formulate`."""
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
        return cls.made_of(joint_pieces(problem, signature, space, rows, *own, words), deadline)

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
        by_length: Array = found / motion.dts
        return by_length


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

"""Joint coordinates on their Lie groups with the implicit schemes of the tau family."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.base import Duals
from mbocp.formulation.build import needs_plain_states, signature_of
from mbocp.formulation.end_rows import consistent_velocity, end_condition_rows
from mbocp.formulation.features.changing_constraints import (
    active_values,
    add_held_columns,
    fill_impulses,
    fill_lengths,
    labels_of,
    repeat_at_impacts,
    ties_at_end,
)
from mbocp.formulation.motion import Motion
from mbocp.formulation.pieces import Algebraic, Pieces, RowLabels, impulses
from mbocp.formulation.schemes.implicit_steps import ImplicitSteps, ProjectedSteps
from mbocp.formulation.schemes.joint_states import (
    JointFormulation,
    boundary_duals,
    joint_pieces,
    stage_costs,
    tangent_duals,
)
from mbocp.integrators import SCHEMES
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import dual_of_momentum, duals_of_momenta
from mbocp.problem import Problem
from mbocp.programme import Iterate, zero_multipliers
from mbocp.robot.kinematics import momenta_of


@dataclass(frozen=True, eq=False)
class ImplicitFormulation(JointFormulation):
    """States are (q, v) of the joints; steps are equations that hold between two of them."""

    @classmethod
    def pieces_of(cls, problem: Problem) -> Pieces:
        """See `Formulation.pieces_of`."""
        robot = problem.robot
        space = ConfigurationSpace(robot.model, "quaternion")
        rows = end_condition_rows(robot, problem.goal, ties=ties_at_end(problem, problem.goal.q))
        is_flat = needs_plain_states(problem) or robot.is_vector_space
        labels = labels_of(problem)
        balance = (robot.v_labels, "momentum balance", robot.v_labels)
        steps: ImplicitSteps
        if SCHEMES[problem.scheme].projects and labels:
            steps, algebraic = ProjectedSteps(problem.scheme), _leaps(robot.nv, len(labels), problem.dt)
            leaps = tuple(f"projection of {label.name}" for label in robot.v_labels)
            words = RowLabels(*balance, labels * 2, leaps)
        else:
            steps, algebraic = ImplicitSteps(problem.scheme), impulses(len(labels), problem.dt)
            words = RowLabels(*balance, labels)
        signature = signature_of(problem, space, rows, steps, is_flat=is_flat)
        own = (algebraic, consistent_velocity(problem), problem.limits_along()["v"])
        return joint_pieces(problem, signature, space, rows, *own, words)

    @property
    def keeps_adjoints(self) -> bool:
        """Whether rows are in tangent spaces, as a solution's adjoints are."""
        return not self.layout.is_flat or self.problem.robot.is_vector_space

    @property
    def start_velocity(self) -> Array:
        """Velocity of the joints with which the steps begin, shape (nv,)."""
        return self.programme.x_start[self.layout.s]

    def iterate_of(self, motion: Motion, lams: Array) -> Iterate:
        """Iterate at a motion; adjoints are zero."""
        held = add_held_columns(self.problem, lams)
        xs, us = self.states_and_controls(motion, motion.vs, held)
        ys = np.zeros((len(us), self.pieces.algebraic.size))
        ys[:, self._own_rows] = fill_impulses(self.problem, motion.dts) * held
        return zero_multipliers(self.programme, xs, ys, us)

    @property
    def _own_rows(self) -> slice:
        """Impulses of steps, without those of projections, among their unknowns and their rows."""
        size = len(self.constraint_labels)
        first = self._num_leaps
        return slice(first, first + size)

    @property
    def _num_leaps(self) -> int:
        """Velocities that a projection changes."""
        return self.problem.robot.nv if self.pieces.algebraic.size > len(self.constraint_labels) else 0

    def motion_of(self, iterate: Iterate) -> Motion:
        """Motion of the joints that an iterate stands for."""
        motion = super().motion_of(iterate)
        return replace(motion, us=repeat_at_impacts(motion.us, self.problem.timeline.is_impact))

    def duals_of(self, iterate: Iterate, motion: Motion) -> Duals:
        """Multipliers and adjoints of an iterate and its motion."""
        problem, dts = self.problem, fill_impulses(self.problem, motion.dts)
        states = boundary_duals(self.programme, iterate)
        costates = tangent_duals(self.space, self.layout, iterate.xs[:, self.layout.z], states)
        return Duals(
            lams=self._impulses(iterate) / dts,
            zetas=active_values(problem, iterate.ms[:, self.layout.ndx :][:, self._own_rows] / dts**2),
            states=states,
            costates=costates,
            mus=self._adjoints(iterate, motion, costates)
            if problem.scheme == "se1"
            else duals_of_momenta(problem.robot, motion.qs, motion.vs, costates),
        )

    def _impulses(self, iterate: Iterate) -> Array:
        steps = self.pieces.signature.steps
        return steps.impulses_of(iterate.ys.T, len(self.constraint_labels)).T

    def _adjoints(self, iterate: Iterate, motion: Motion, costates: Array) -> Array:
        """mu_0 ... mu_N of SE1: the multipliers of the steps' rows (Box 1); the last follows from the end.

        For a constant mass matrix they and the boundary duals in (q, p) are the adjoint of Box 1 and of
        Appendix B.
        """
        end = dual_of_momentum(self.problem.robot, motion.qs[-1], motion.vs[-1], costates[-1])
        return np.vstack([self._row_duals(iterate), end])

    def _row_duals(self, iterate: Iterate) -> Array:
        """Multipliers of the kinematic and momentum rows as duals of tangent vectors, shape (N, 2 nv)."""
        at = self.layout
        return tangent_duals(self.space, at, iterate.xs[1:, at.z], iterate.ms[:, : at.ndx])

    def hamiltonians(self, iterate: Iterate, motion: Motion, duals: Duals) -> Array:
        """H at (y_tau, mu_{1 - tau}, u) of every step, eq. (11) and Appendix B.

        In (q, v) and its duals mu . f is c_q . v + mu_p . M a; for constant M, mu_q . v + mu_p . dp/dt.
        The momentum row's multiplier is mu_p at 1 - tau; c_q is the boundary dual before the step and the
        kinematic row's multiplier after it, before the constraint at the node acts on it.
        """
        robot, nv, tau = self.problem.robot, self.problem.robot.nv, self.force_tau
        dts = fill_lengths(self.problem, motion.dts)
        q_taus, _ = self.evaluation_points(motion.qs, motion.vs, dts)
        landed = motion.vs[1:].copy()
        landed[:, : self._num_leaps] += iterate.ys[:, : self._num_leaps]
        velocities = (1.0 - self.tau) * motion.vs[:-1] + self.tau * landed
        rows = self._row_duals(iterate)
        along = tau * duals.costates[:-1, :nv] + (1.0 - tau) * rows[:, :nv]
        inertial = momenta_of(robot.model, q_taus, (landed - motion.vs[:-1]) / dts[:, None])
        hamiltonians: Array = (
            stage_costs(self.programme, iterate) / dts
            + np.einsum("ni,ni->n", along, velocities)
            + np.einsum("ni,ni->n", rows[:, nv:], inertial)
        )
        if robot.nc:
            residuals = np.array([robot.constraint_residual(q) for q in motion.qs[1:]])
            hamiltonians += np.einsum("ni,ni->n", duals.zetas[:, : robot.nc], residuals)
        return repeat_at_impacts(hamiltonians, self.problem.timeline.is_impact)


def _leaps(nv: int, rows: int, dt: float) -> Algebraic:
    """Leaps of velocities, impulses of steps and of projections; rows: balances, Phi / dt, and J v."""
    step = impulses(rows, dt)
    leaps, drifts = np.ones(nv), np.ones(rows)
    is_leap = np.arange(nv + 2 * rows) < nv
    return Algebraic(
        scale_c=np.concatenate([leaps, step.scale_c, drifts]),
        scale_y=np.concatenate([leaps, step.scale_y, step.scale_y]),
        scale_m=np.concatenate([leaps, step.scale_m, step.scale_m]),
        is_force=~is_leap,
        is_balance=is_leap,
    )

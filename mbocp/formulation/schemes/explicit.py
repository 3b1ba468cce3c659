"""Joint coordinates with explicit Runge-Kutta schemes, and with drives, whose controls are velocities."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from itertools import pairwise

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.base import Duals
from mbocp.formulation.build import needs_plain_states, signature_of
from mbocp.formulation.end_rows import end_condition_rows, parts_to_guard
from mbocp.formulation.motion import Motion, NodeSlopes
from mbocp.formulation.pieces import Pieces, RowLabels, impulses
from mbocp.formulation.schemes.explicit_steps import ExplicitSteps
from mbocp.formulation.schemes.joint_states import (
    JointFormulation,
    boundary_duals,
    joint_pieces,
    stage_costs,
    tangent_duals,
)
from mbocp.formulation.state_bounds import free_speed_bounds
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import duals_of_momenta
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.problem import Problem
from mbocp.programme import Iterate, zero_multipliers
from mbocp.robot import Robot
from mbocp.robot.drives import control_velocity_maps, speed_maps
from mbocp.robot.kinematics import difference


@dataclass(frozen=True, eq=False)
class ExplicitFormulation(JointFormulation):
    """States are coordinates and speeds; a step gives the next state. Schemes may leave the groups.

    Speeds s are the velocities v, unless controls prescribe some of them: v = V(q) s + U(q) u then.
    """

    end_rows_may_depend = True
    solves_for_lams = False
    tau = force_tau = 1.0  # of a guess: velocities of a line lag by half a step, no more

    @classmethod
    def pieces_of(cls, problem: Problem) -> Pieces:
        """See `Formulation.pieces_of`."""
        robot = problem.robot
        space = ConfigurationSpace(robot.model, robot.rotations)
        guarded = parts_to_guard(problem, space)
        speeds = robot.speed_map if robot.drives else None
        rows = end_condition_rows(robot, problem.goal, speeds)
        leaves_the_group = problem.lie != "munthe_kaas"
        signature = signature_of(
            problem,
            space,
            rows,
            ExplicitSteps(problem.scheme, robot.rotations, problem.lie, problem.substeps),
            is_flat=leaves_the_group or needs_plain_states(problem) or robot.is_vector_space,
            guarded=guarded,
        )
        words = RowLabels(robot.v_labels, "rate", robot.speed_labels)
        start_speeds = robot.speeds(problem.q_start, problem.v_start)
        own = (impulses(0, problem.dt), start_speeds, free_speed_bounds(problem))
        return joint_pieces(problem, signature, space, rows, *own, words)

    def start_state(self, q: Array, v: Array) -> Array:
        """First state of the programme at a state of the robot, without what it remembers."""
        return np.concatenate([self.space.coordinates(q[None])[0], self.problem.robot.speeds(q, v)])

    def evaluation_points(self, qs: Array, vs: Array, dts: Array) -> tuple[Array, Array]:
        """Where each step begins."""
        return qs[:-1], vs[:-1]

    def iterate_of(self, motion: Motion, lams: Array) -> Iterate:
        """Where speeds are fewer than velocities, those nearest to them; multipliers are no unknowns."""
        robot, speeds = self.problem.robot, motion.vs
        if robot.drives:
            # The columns of V are unit vectors on different components: V' takes the nearest speeds.
            speeds = np.einsum("nij,ni->nj", speed_maps(robot, motion.qs), motion.vs)
        xs, us = self.states_and_controls(motion, speeds)
        return zero_multipliers(self.programme, xs, np.zeros((len(us), 0)), us)

    def motion_of(self, iterate: Iterate) -> Motion:
        """Motion of the joints that an iterate stands for."""
        robot, motion = self.problem.robot, super().motion_of(iterate)
        if not robot.drives:
            return motion
        # Velocities that a control prescribes are the ones after the node.
        qs, speeds, us = motion.qs, motion.vs, motion.us
        prescribed = np.einsum("nij,nj->ni", control_velocity_maps(robot, qs), np.vstack([us, us[-1:]]))
        velocities: Array = np.einsum("nij,nj->ni", speed_maps(robot, qs), speeds) + prescribed
        return replace(motion, vs=velocities)

    def node_slopes(self, iterate: Iterate, motion: Motion) -> NodeSlopes:
        """With drives velocities depend on configurations and controls, too."""
        found, robot, at = super().node_slopes(iterate, motion), self.problem.robot, self.layout
        if robot.drives:
            us = np.vstack([motion.us, motion.us[-1:]])
            given = (motion.qs.T, iterate.xs[:, at.s].T, us.T)
            slopes = np.asarray(_velocity_slopes(robot).map(len(us))(*given))
            rows = slopes.reshape(robot.nv, len(us), -1).transpose(1, 0, 2)
            in_q, in_s, in_u = np.split(rows, [robot.nv, robot.nv + at.ns], axis=2)
            found.in_states[:, robot.nv :] = in_q @ found.in_states[:, : robot.nv]
            found.in_states[:, robot.nv :, at.ds] += in_s
            found.in_us[:, robot.nv :] = in_u
        return found

    def duals_of(self, iterate: Iterate, motion: Motion) -> Duals:
        """With drives the adjoints are duals of (q, v): there is no momentum that belongs to all of them."""
        problem, robot, at, dts = self.problem, self.problem.robot, self.layout, motion.dts[:, None]
        qs, vs = motion.qs, motion.vs
        states = boundary_duals(self.programme, iterate)
        costates = self._velocity_duals(tangent_duals(self.space, at, iterate.xs[:, at.z], states), qs)
        lams, zetas = iterate.ys / dts, iterate.ms[:, at.ndx :] / dts**2
        if robot.nc:
            lams, zetas = self._compute_projected_multipliers(motion), np.zeros((len(motion.us), robot.nc))
        mus = costates if robot.drives else duals_of_momenta(problem.robot, qs, vs, costates)
        return Duals(lams, zetas, states, costates, mus)

    def _velocity_duals(self, duals: Array, qs: Array) -> Array:
        """Duals of (q, v); where speeds are fewer than velocities, those of least norm.

        The columns of V are unit vectors on different components: V itself is the pseudo-inverse of V'.
        """
        robot = self.problem.robot
        if not robot.drives:
            return duals
        nv, maps = robot.nv, speed_maps(robot, qs)
        return np.hstack([duals[:, :nv], np.einsum("nij,nj->ni", maps, duals[:, nv:])])

    def _compute_projected_multipliers(self, motion: Motion) -> Array:
        """Multipliers of the constraints at the beginning of each step, from the projected accelerations."""
        problem, robot = self.problem, self.problem.robot
        mechanics = ForwardMechanics(robot)
        q, v, u = ca.SX.sym("q", robot.nq), ca.SX.sym("v", robot.nv), ca.SX.sym("u", robot.nu)
        lam = mechanics.multipliers(q, v, u, ca.SX(problem.stabilisation.gamma_constraint))
        function = ca.Function("multipliers", [q, v, u], [ca.densify(lam)]).map(len(motion.us))
        return np.asarray(function(motion.qs[:-1].T, motion.vs[:-1].T, motion.us.T)).T

    def hamiltonians(self, iterate: Iterate, motion: Motion, duals: Duals) -> Array:
        """With the step's own increment for f and the adjoint after it, to first order in dt."""
        at, dts = self.layout, motion.dts
        turned = np.array([difference(self.problem.robot.model, a, b) for a, b in pairwise(motion.qs)])
        speeds = iterate.xs[:, at.s] if self.problem.robot.drives else motion.vs
        moved = np.hstack([turned, np.diff(speeds, axis=0)])
        rows = tangent_duals(self.space, at, iterate.xs[1:, at.z], iterate.ms[:, : at.ndx])
        values: Array = np.einsum("ni,ni->n", rows, moved) / dts
        return values + stage_costs(self.programme, iterate) / dts

    def velocity_multipliers(self, multipliers: Array) -> Array:
        """Those of the velocities that no control prescribes; they come first among the speeds."""
        robot, speeds = self.problem.robot, multipliers[:, self.layout.s]
        free = [i for i in range(robot.nv) if i not in set(robot.driven)]
        found = np.zeros((len(speeds), robot.nv))
        found[:, free] = speeds[:, : len(free)]
        return found


@lru_cache(maxsize=16)
def _velocity_slopes(robot: Robot) -> ca.Function:
    """(q, s, u) -> derivatives of the velocity, of q along the tangent, shape (nv, nv + ns + nu)."""
    mechanics = ForwardMechanics(robot)
    q, s, u = ca.SX.sym("q", robot.nq), ca.SX.sym("s", mechanics.ns), ca.SX.sym("u", robot.nu)
    dq = ca.SX.sym("dq", robot.nv)
    slopes = ca.jacobian(mechanics.velocity(mechanics.integrate(q, dq), s, u), ca.vertcat(dq, s, u))
    at_zero = ca.Function("at_zero", [dq, q, s, u], [ca.densify(slopes)])
    return ca.Function("velocity_slopes", [q, s, u], [at_zero(ca.SX.zeros(robot.nv), q, s, u)])

"""Natural coordinates, points and directors of bodies, with the implicit schemes of the tau family."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp.formulation.base import Duals, Formulation
from mbocp.formulation.build import check_size, signature_of
from mbocp.formulation.end_rows import EndRows, EndTarget, consistent_velocity, end_condition_rows
from mbocp.formulation.features.changing_constraints import (
    breaks_symmetries,
    fill_impulses,
    fill_lengths,
    measure_switched_violation,
    repeat_at_impacts,
    ties_at_end,
    worse_of,
)
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.motion import Motion, NodeSlopes
from mbocp.formulation.pieces import Pieces, RowLabels, impulses
from mbocp.formulation.schemes.implicit_steps import NaturalSteps
from mbocp.formulation.schemes.joint_states import (
    boundary_duals,
    find_weighed_components,
    stage_costs,
    weighs_control_changes,
)
from mbocp.formulation.states import States
from mbocp.integrators import VELOCITY_TAU
from mbocp.mechanics import NaturalMechanics, NaturalSpace, duals_of_momenta, natural_mechanics
from mbocp.mechanics.diagnostics import ConstraintViolation, find_kept_symmetries, worst_violation
from mbocp.problem import Problem
from mbocp.programme import Iterate, StagewiseProgramme, zero_multipliers
from mbocp.robot import Label


@dataclass(frozen=True, eq=False)
class NaturalFormulation(Formulation):
    """States are coordinates z of bodies and their rates w; constraints keep bodies rigid and joined.

    What people say of joints is said in terms of bodies, and read back. Bodies have no limits, angles or
    turns: a step of Newton's method bends the constraints, and the line search sees that.
    """

    space: NaturalSpace

    counts_turns = False
    can_drift = True

    @classmethod
    def pieces_of(cls, problem: Problem) -> Pieces:
        """See `Formulation.pieces_of`."""
        robot = problem.robot
        mechanics = natural_mechanics(robot)
        joints, space = mechanics.joint_space, NaturalSpace(mechanics, problem.q_start)
        rows = end_condition_rows(robot, problem.goal, ties=ties_at_end(problem, problem.goal.q))
        signature = signature_of(
            problem, joints, rows, NaturalSteps(problem.scheme), is_flat=True, has_joint_goal=True
        )
        at = signature.state_layout(space.nz, space.nv, space.nv, robot.nu)
        labels = _labels(problem, mechanics)
        check_size(problem, signature, at, len(labels))
        unbounded = np.full(at.ns, np.inf)
        names = mechanics.coordinate_labels
        start = _start(problem, space, problem.q_start, consistent_velocity(problem))
        return Pieces(
            problem=problem,
            joints=joints,
            space=space,
            signature=signature,
            layout=at,
            algebraic=impulses(len(labels), problem.dt),
            groups=mechanics.groups if _is_structured(problem, at) else (),
            end_rows=rows,
            end=_natural_end(problem, mechanics, rows),
            turning=np.zeros(at.ndx),
            x_start=States(problem, signature.features, at).first(*start),
            speed_bounds=(-unbounded, unbounded),
            labels=RowLabels(names, "momentum balance", names, labels),
        )

    @property
    def constraint_labels(self) -> tuple[Label, ...]:
        """Name and unit of each holonomic constraint."""
        return _labels(self.problem, self.space.mechanics)

    def start_state(self, q: Array, v: Array) -> Array:
        """First state of the programme at a state of the robot, without what it remembers."""
        return np.concatenate(_start(self.problem, self.space, q, v))

    def iterate_of(self, motion: Motion, lams: Array) -> Iterate:
        """All bodies where the joints put them.

        Velocities are those of the scheme's kinematics: for SE1 chords, (q_n - q_{n-1})/dt, which the joints'
        velocities are not. The robot's constraints are few of the bodies': their multipliers are not used.
        Those that are balance the momenta best, in the least-squares sense.
        """
        at, programme = self.layout, self.programme
        zs = self.space.coordinates(motion.qs)
        if self.tau == 1.0:
            lengths = fill_lengths(self.problem, motion.dts)[:, None]
            rates = repeat_at_impacts(np.diff(zs, axis=0) / lengths, self.problem.timeline.is_impact)
            ws = np.vstack([programme.x_start[at.s], rates])
        else:
            ws = self.space.rates(motion.qs, motion.vs)
        xs, us = self.states.of_motion(motion, (zs, ws), programme.x_start)
        acts = _active_rows(self.problem, self.space.mechanics)
        ys = _impulses(programme, at, xs, us, acts)  # what is remembered has no part in the balance
        loops = ys[:, self.space.mechanics.nc - self.problem.robot.nc :]
        xs = self.states.remember(xs, us, loops / fill_impulses(self.problem, motion.dts))
        return zero_multipliers(programme, xs, ys, us)

    def motion_of(self, iterate: Iterate) -> Motion:
        """Motion of the joints that an iterate stands for."""
        at, xs = self.layout, iterate.xs
        zs, ws = xs[:, at.z], xs[:, at.s]
        qs_and_vs = (self.space.configurations(zs), self.space.velocities(zs, ws))
        motion = self.states.read(qs_and_vs, xs, iterate.us)
        return replace(motion, us=repeat_at_impacts(motion.us, self.problem.timeline.is_impact))

    def node_slopes(self, iterate: Iterate, motion: Motion) -> NodeSlopes:
        """Of the joints that bodies are read back to."""
        at, nv = self.layout, self.problem.robot.nv
        in_states = np.zeros((len(iterate.xs), 2 * nv, at.ndx))
        of_bodies = self.space.slopes(iterate.xs[:, at.z], iterate.xs[:, at.s])
        in_states[:, :, : at.nw + at.ns] = of_bodies
        return NodeSlopes(in_states, np.zeros((len(in_states), 2 * nv, self.problem.robot.nu)))

    def duals_of(self, iterate: Iterate, motion: Motion) -> Duals:
        """Multipliers and adjoints of an iterate and its motion."""
        at, dts = self.layout, fill_impulses(self.problem, motion.dts)
        states = boundary_duals(self.programme, iterate)
        costates = self.space.costates(iterate.xs[:, at.z], motion.vs, states[:, : at.nw + at.ns])
        return Duals(
            lams=iterate.ys / dts,
            zetas=np.where(
                _active_rows(self.problem, self.space.mechanics), iterate.ms[:, at.ndx :] / dts**2, 0.0
            ),
            states=states,
            costates=costates,
            mus=duals_of_momenta(self.problem.robot, motion.qs, motion.vs, costates),
        )

    def hamiltonians(self, iterate: Iterate, motion: Motion, duals: Duals) -> Array:
        """The mass matrix is constant; the kinematic row's dual is taken as in joint coordinates."""
        at, dts, tau = self.layout, fill_lengths(self.problem, motion.dts), self.tau
        before = self.force_tau
        ws, rows = iterate.xs[:, at.s], iterate.ms
        velocity = tau * ws[1:] + (1.0 - tau) * ws[:-1]
        along = before * duals.states[:-1, : at.nw] + (1.0 - before) * rows[:, : at.nw]
        inertial = np.diff(ws, axis=0) / dts[:, None] @ self.space.mechanics.mass_at(iterate.xs[0, at.z])
        values = stage_costs(self.programme, iterate) / dts + np.einsum("ni,ni->n", along, velocity)
        return repeat_at_impacts(
            values + np.einsum("ni,ni->n", rows[:, at.ds], inertial), self.problem.timeline.is_impact
        )

    def control_momenta(
        self, iterate: Iterate, motion: Motion, duals: Duals
    ) -> tuple[Array, tuple[str, ...]]:
        """Sums of q x mu^q + p x mu^p over all points and directors.

        In the duals c of (z, w) it is c . (X z, X w) with the rotation X: exactly what a step keeps.
        """
        at, problem, nodes = self.layout, self.problem, len(iterate.xs)
        if problem.inequalities or breaks_symmetries(problem):
            return np.zeros((nodes, 0)), ()
        changes = weighs_control_changes(problem)
        kept = find_kept_symmetries(problem.robot, find_weighed_components(problem), weighs_changes=changes)
        zs, ws = iterate.xs[:, at.z], iterate.xs[:, at.s]
        states = duals.states[:, : at.nw + at.ns]
        columns = [np.einsum("ni,ni->n", states, self.space.generator(s, zs, ws)) for s in kept]
        momenta: Array = np.array(columns).T if columns else np.zeros((nodes, 0))
        return momenta, tuple(s.name for s in kept)

    def violation(self, iterate: Iterate, motion: Motion) -> ConstraintViolation:
        """Of any constraint, those of rigid bodies and joints included."""
        mechanics, at = self.space.mechanics, self.layout
        z, w = ca.SX.sym("z", mechanics.nq), ca.SX.sym("w", mechanics.nq)
        rows = ca.densify(mechanics.constraints(z))
        both = ca.Function("Phi", [z, w], [rows, ca.densify(ca.jtimes(rows, z, w))]).map(len(iterate.xs))
        found = both(iterate.xs[:, at.z].T, iterate.xs[:, at.s].T)
        position, velocity = (np.asarray(values).T for values in found)
        table, names = self.problem.timeline.switches, [label.name for label in mechanics.constraint_labels]
        if table is None:
            return worst_violation(position, velocity, names)
        own = mechanics.nc - self.problem.robot.nc
        acts = np.ones_like(position)
        acts[1:, own:] = table.own
        found = worst_violation(position * acts, velocity * acts, names)
        return worse_of(found, measure_switched_violation(table, motion.qs, motion.vs))

    def velocity_multipliers(self, multipliers: Array) -> Array:
        """Zeros: bodies have no limits."""
        return np.zeros((len(multipliers), self.problem.robot.nv))


def _labels(problem: Problem, mechanics: NaturalMechanics) -> tuple[Label, ...]:
    """Name and unit of the rows of bodies, joints and loops, and of what is held."""
    return (
        *mechanics.constraint_labels,
        *(problem.timeline.switches.labels if problem.timeline.switches else ()),
    )


def _is_structured(problem: Problem, at: StateLayout) -> bool:
    """Whether the kernel eliminates bodies one by one; rows that are switched it takes as dense."""
    return problem.scheme == "se1" and at.nr == 0 and problem.timeline.switches is None


def _start(problem: Problem, space: NaturalSpace, q: Array, v: Array) -> tuple[Array, Array]:
    z = space.coordinates(q[None])[0]
    w = space.rates(q[None], v[None])[0]
    if VELOCITY_TAU[problem.scheme] == 0.0 and np.any(v):  # the chord, whose end is where bodies are rigid
        dt = problem.timeline.lengths()[0]
        w = (space.coordinates(problem.robot.integrate(q, dt * v)[None])[0] - z) / dt
    return z, w


def _natural_end(problem: Problem, mechanics: NaturalMechanics, rows: EndRows) -> EndTarget:
    """End condition of bodies that is that of joints, to first order about the goal.

    With J the derivative of the coordinates z in the joints' motions at the goal, joints move by
    :math:`J^+ (z - z_d)` and have momenta :math:`J^T p`: the rows D of the joints become :math:`D J^+` and
    :math:`D J^T`. All of them together are the null-space projection of eq. (14).
    """
    robot, goal = problem.robot, problem.goal
    J = mechanics.tree.jacobian(goal.q)
    inverse = np.linalg.pinv(J)
    if goal.rate == "v":
        return EndTarget(rows.D_q @ inverse, rows.D_rate @ inverse, J @ goal.value)
    rate = J @ robot.velocity_from_momentum(goal.q, goal.value)
    momentum = mechanics.mass_at(mechanics.tree.coordinates(goal.q[None])[0]) @ rate
    return EndTarget(rows.D_q @ inverse, rows.D_rate @ J.T, momentum)


def _active_rows(problem: Problem, mechanics: NaturalMechanics) -> BoolArray:
    """Which rows act in which step, those of bodies always, shape (N, ny)."""
    table = problem.timeline.switches
    if table is None:
        return np.ones((problem.num_steps, mechanics.nc), dtype=np.bool_)
    bodies = np.ones((problem.num_steps, mechanics.nc - problem.robot.nc), dtype=np.bool_)
    return np.hstack([bodies, table.own, table.rows])


def _impulses(programme: StagewiseProgramme, at: StateLayout, xs: Array, us: Array, acts: BoolArray) -> Array:
    """Impulses y of the rows that act, by least squares of the momentum rows, shape (N, ny)."""
    from scipy import sparse  # slow to import, and wanted only for this
    from scipy.sparse.linalg import spsolve

    N, ny = programme.num_steps, programme.kind.ny
    theta, rho = np.tile(programme.theta[:, None], (1, N)), programme.rho.reshape(N, -1)
    step = programme.functions.function("jacobian").map(N)
    c, _, derivatives, _ = step(xs[:-1].T, xs[1:].T, np.zeros((ny, N)), us.T, theta, rho.T)
    rows = np.asarray(c)[at.ds].T
    side_by_side = derivatives.sparse().tocsc()
    width = side_by_side.shape[1] // N
    columns = (np.arange(N)[:, None] * width + at.ndx + np.arange(ny)).ravel()
    blocks = side_by_side[at.ds][:, columns].tocoo()
    places = (blocks.row + blocks.col // ny * rows.shape[1], blocks.col)  # one below the other
    push = sparse.csc_matrix((-blocks.data, places), shape=(rows.size, N * ny))  # G' of all steps
    push = push[:, acts.ravel()]
    found = np.zeros((N, ny))
    found[acts] = spsolve(push.T @ push, push.T @ rows.ravel(), permc_spec="MMD_AT_PLUS_A")
    return found

"""What all schemes in joint coordinates have in common, whichever family they are of."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation.base import Duals, Formulation
from mbocp.formulation.build import check_size
from mbocp.formulation.end_rows import EndRows, EndTarget
from mbocp.formulation.features.changing_constraints import (
    breaks_symmetries,
    labels_of,
    measure_switched_violation,
)
from mbocp.formulation.layout import StateLayout
from mbocp.formulation.motion import Motion, NodeSlopes
from mbocp.formulation.pieces import Algebraic, Pieces, RowLabels
from mbocp.formulation.signature import FunctionSignature
from mbocp.formulation.states import States
from mbocp.formulation.term_numbers import term_numbers
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics.diagnostics import ConstraintViolation, constraint_violation, control_momenta
from mbocp.problem import Problem
from mbocp.programme import Iterate, StagewiseProgramme
from mbocp.programme.kernel import kernel_programme
from mbocp.robot import Label
from mbocp.terms.own_parts import collect_running_terms

_KEPT = 16  # functions of configuration spaces


@dataclass(frozen=True, eq=False)
class JointFormulation(Formulation):
    """States are coordinates and speeds of the joints; schemes say what is otherwise with theirs."""

    space: ConfigurationSpace

    @property
    def constraint_labels(self) -> tuple[Label, ...]:
        """Name and unit of each holonomic constraint."""
        return labels_of(self.problem)

    def states_and_controls(
        self, motion: Motion, speeds: Array, lams: Array | None = None
    ) -> tuple[Array, Array]:
        """States and controls of the programme at a motion, see `mbocp.formulation.states`."""
        z_and_speeds = (self.space.coordinates(motion.qs), speeds)
        motion = motion if lams is None else replace(motion, lams=lams)
        xs, us = self.states.of_motion(motion, z_and_speeds, self.programme.x_start)
        return self.states.remember(xs, us, lams), us

    def motion_of(self, iterate: Iterate) -> Motion:
        """Motion of the joints that an iterate stands for; speeds in the place of velocities."""
        at, xs = self.layout, iterate.xs
        zs = xs[:, at.z]
        qs = self.space.configurations(zs) if at.is_flat or at.nz != self.problem.robot.nq else zs
        return self.states.read((qs, xs[:, at.s]), xs, iterate.us)

    def node_slopes(self, iterate: Iterate, motion: Motion) -> NodeSlopes:
        """States that are taken by their tangent say it by themselves."""
        at, nv, zs = self.layout, self.problem.robot.nv, iterate.xs[:, self.layout.z]
        in_states = np.zeros((len(zs), 2 * nv, at.ndx))
        in_states[:, :nv, : at.nw] = self.space.slopes_of_configurations(zs) if at.is_flat else np.eye(nv)
        if at.ns == nv:
            in_states[:, nv:, at.ds] = np.eye(nv)
        return NodeSlopes(in_states, np.zeros((len(zs), 2 * nv, self.problem.robot.nu)))

    def control_momenta(
        self, iterate: Iterate, motion: Motion, duals: Duals
    ) -> tuple[Array, tuple[str, ...]]:
        """Control momenta of the problem's symmetries, and their names."""
        return momenta_of_symmetries(self.problem, motion.qs, motion.vs, duals.costates)

    def violation(self, iterate: Iterate, motion: Motion) -> ConstraintViolation:
        """Largest violation of the robot's constraints."""
        table = self.problem.timeline.switches
        if table is not None:
            return measure_switched_violation(table, motion.qs, motion.vs)
        return constraint_violation(self.problem.robot, motion.qs, motion.vs)

    def velocity_multipliers(self, multipliers: Array) -> Array:
        """Multipliers of limits of velocities from those of states."""
        return multipliers[:, self.layout.s]


def joint_pieces(
    problem: Problem,
    signature: FunctionSignature,
    space: ConfigurationSpace,
    rows: EndRows,
    algebraic: Algebraic,
    start_speeds: Array,
    speed_bounds: tuple[Array, Array],
    labels: RowLabels,
) -> Pieces:
    """Return what a programme with states (z, s) of the joints is made of.

    Raises
    ------
    TooManyOperations, MemoryLimitExceeded
        If it would be too large.
    """
    robot, goal = problem.robot, problem.goal
    at = signature.state_layout(space.nz, space.nv, len(start_speeds), robot.nu)
    check_size(problem, signature, at, algebraic.size)
    z = space.coordinates(problem.q_start[None])[0]
    return Pieces(
        problem=problem,
        joints=space,
        space=space,
        signature=signature,
        layout=at,
        algebraic=algebraic,
        groups=(),
        end_rows=rows,
        end=EndTarget(rows.D_q, rows.D_rate, np.asarray(goal.value)),
        turning=find_turning_factors(robot.turns, space, at),
        x_start=States(problem, signature.features, at).first(z, start_speeds),
        speed_bounds=speed_bounds,
        labels=labels,
    )


def find_turning_factors(turns: Array, space: ConfigurationSpace, layout: StateLayout) -> Array:
    """Angle [rad] by unit of each entry of a state's tangent, shape (ndx,); 0: not an angle.

    The joints' own angles only. Attitudes of free-flyers and ball joints have none. `turns` are those of the
    robot, see `RobotModel.turns`.
    """
    factors = np.zeros(layout.ndx)
    for part in space.parts:
        at = part.at_z if layout.is_flat else part.at_v
        if part.group.is_vector:
            factors[at] = turns[part.at_v]
        elif part.group.nv == 1:
            factors[at] = 1.0  # cosine and sine, or the angle
    return factors


def boundary_duals(programme: StagewiseProgramme, iterate: Iterate) -> Array:
    """Derivatives of the Lagrangian of what follows each node in its state, shape (N + 1, ndx)."""
    native = kernel_programme(programme)
    iterate.load_into(native)
    native.evaluate()
    return native.costates.reshape(programme.num_steps + 1, -1)


def stage_costs(programme: StagewiseProgramme, iterate: Iterate) -> Array:
    """Running cost of every step, from the stage functions, shape (N,); NaN where they fail."""
    N = programme.num_steps
    arguments = (iterate.xs[:-1], iterate.xs[1:], iterate.ys, iterate.us)
    theta, rho = np.tile(programme.theta[:, None], (1, N)), programme.rho.reshape(N, -1)
    values = programme.functions.function("values").map(N)
    try:
        costs: Array = np.asarray(values(*(a.T for a in arguments), theta, rho.T)[1]).ravel()
    except RuntimeError:  # what CasADi raises where a compiled function reports that it failed
        return np.full(N, np.nan)
    return costs


def tangent_duals(space: ConfigurationSpace, at: StateLayout, zs: Array, duals: Array) -> Array:
    """Duals of the coordinates as duals of tangent vectors; those of previous controls are left out."""
    along = duals[:, : at.nw]
    if at.is_flat and not space.is_vector:
        along = np.asarray(_pull_back(space).map(len(zs))(zs.T, along.T)).T
    return np.hstack([along, duals[:, at.ds]])


@lru_cache(maxsize=_KEPT)
def _pull_back(space: ConfigurationSpace) -> ca.Function:
    """From coordinates and their dual to the dual of the tangent vector."""
    z, c, v = ca.SX.sym("z", space.nz), ca.SX.sym("c", space.nz), ca.SX.sym("v", space.nv)
    return ca.Function("pulled", [z, c], [ca.gradient(ca.dot(c, space.rate(z, v)), v)])


def momenta_of_symmetries(
    problem: Problem, qs: Array, vs: Array, costates: Array
) -> tuple[Array, tuple[str, ...]]:
    """Control momenta; none where drives, path constraints or limits of rates are: not looked for there.

    Holds and impacts keep them: what is held where it is moves along with the robot. Linear controls are
    part of the state, and forces in axes of the world turn with it: their part is not looked for either.
    """
    has_more = problem.robot.drives or problem.inequalities or problem.controls == "linear"
    if has_more or breaks_symmetries(problem):
        return np.zeros((len(qs), 0)), ()
    tracked, weighs_changes = find_weighed_components(problem), weighs_control_changes(problem)
    return control_momenta(problem.robot, qs, vs, costates, tracked=tracked, weighs_changes=weighs_changes)


def weighs_control_changes(problem: Problem) -> bool:
    """Whether the running cost weighs how controls change from step to step."""
    return bool(np.any(problem.heaviest_cost.control_rate))


def find_weighed_components(problem: Problem) -> Array | None:
    """Components of (q, p) that the running cost looks at; one on velocities counts as one on momenta."""
    robot, nv = problem.robot, problem.robot.nv
    joints = ConfigurationSpace(robot.model)
    given = term_numbers(problem, problem.heaviest_cost, joints)
    weights = np.zeros(2 * nv)
    for term in collect_running_terms(given):
        weights += term.touches(given)
    limits = problem.widest_limits
    for side in (limits.v_lower, limits.v_upper):
        weights[nv:] += np.isfinite(side)
    bounded = np.isfinite(limits.q_lower) | np.isfinite(limits.q_upper)
    for joint in problem.robot.joint_names:
        if bounded[problem.robot.configuration_indices(joint)].any():
            weights[:nv][problem.robot.velocity_indices(joint)] += 1.0
    return weights if weights.any() else None

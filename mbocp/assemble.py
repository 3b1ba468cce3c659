"""From a solver's iterate to trajectories in the paper's scaling, and what they prove about themselves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.formulation import Formulation
from mbocp.inequalities import inequalities
from mbocp.integrators import TAU, evaluation_points
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import NaturalSpace, dual_of_momentum
from mbocp.mechanics.forward import ForwardMechanics
from mbocp.natural import natural_hamiltonians, natural_momenta, natural_violation
from mbocp.problem import Problem
from mbocp.programme.kernel import kernel_programme
from mbocp.robot import Robot
from mbocp.robot.drives import control_velocity_maps, speed_maps
from mbocp.robot.kinematics import mass_matrices
from mbocp.solution.diagnostics import constraint_violation, control_momenta
from mbocp.solvers import Iterate
from mbocp.terms import TermNumbers, running_terms

__all__ = ["Trajectory", "assemble", "boundary_duals"]

_SWEEP_TOLERANCE = 1e-12  # of a step's residual; a Newton step below that is round-off
_SWEEP_ITERATIONS = 50
_KEPT = 16  # functions of configuration spaces


@dataclass(frozen=True)
class Trajectory:
    """Trajectories of a solution; see `mbocp.solution.Solution` for shapes and units."""

    t: Array
    qs: Array
    vs: Array
    ps: Array
    us: Array
    lams: Array
    mus: Array
    zetas: Array
    eta: Array
    control_hamiltonians: Array
    control_momenta: Array
    control_momentum_names: tuple[str, ...]
    constraint_violation: float
    velocity_violation: float
    manifold_drifts: Array
    manifold_drift: float
    manifold_drift_resimulated: float
    lam_us: Array
    lam_qs: Array
    lam_vs: Array
    lam_path: Array
    path_names: tuple[str, ...]
    limit_violation: float

    def fields(self) -> dict[str, Any]:
        """Fields by name, not copied."""
        return {name: getattr(self, name) for name in self.__dataclass_fields__}


def assemble(formulation: Formulation, iterate: Iterate) -> Trajectory:
    """Trajectories, multipliers, control Hamiltonian and control momentum of an iterate."""
    problem, programme = formulation.problem, formulation.programme
    robot, N, dt = problem.robot, problem.num_steps, problem.dt
    at = formulation.layout
    zs = iterate.xs[:, at.z]
    qs = formulation.space.configurations(zs) if at.is_flat or at.nz != robot.nq else zs
    lams, zetas = iterate.ys / dt, iterate.ms[:, at.ndx :] / dt**2
    if isinstance(formulation.space, NaturalSpace):
        return _natural(formulation, formulation.space, iterate, qs, lams, zetas)
    maps = _speed_maps(formulation, qs)
    vs = _velocities(problem, iterate.xs[:, at.s], iterate.us, qs, maps)
    if programme.is_explicit and robot.nc:
        lams, zetas = _projected_multipliers(problem, qs, vs, iterate.us), np.zeros((N, robot.nc))
    duals = boundary_duals(formulation, iterate)
    costates = _velocity_duals(_tangent_duals(formulation, zs, duals), maps, robot.nv)
    momenta, names = _momenta_of_symmetries(problem, qs, vs, costates)
    drifts, violation = _drifts(formulation, zs), constraint_violation(robot, qs, vs)
    return Trajectory(
        t=np.arange(N + 1, dtype=np.float64) * dt,
        qs=qs,
        vs=vs,
        ps=_momenta(robot, qs, vs),
        us=iterate.us,
        lams=lams,
        mus=_adjoints(formulation, iterate, qs, vs, costates),
        zetas=zetas,
        eta=iterate.eta,
        control_hamiltonians=_hamiltonians(formulation, iterate, qs, vs, costates, zetas),
        control_momenta=momenta,
        control_momentum_names=names,
        constraint_violation=violation.position,
        velocity_violation=violation.velocity,
        manifold_drifts=drifts,
        manifold_drift=float(drifts.max(initial=0.0)),
        manifold_drift_resimulated=_resimulated_drift(formulation, iterate),
        **inequalities(formulation, iterate, qs, vs),
    )


def _natural(
    formulation: Formulation,
    space: NaturalSpace,
    iterate: Iterate,
    qs: Array,
    lams: Array,
    zetas: Array,
) -> Trajectory:
    """Trajectories of the joints from an iterate in natural coordinates; constraints are the bodies'."""
    problem = formulation.problem
    robot, N, at = problem.robot, problem.num_steps, formulation.layout
    zs = iterate.xs[:, at.z]
    vs = space.velocities(zs, iterate.xs[:, at.s])
    duals = boundary_duals(formulation, iterate)[:, : at.nw + at.ns]
    costates = space.costates(zs, vs, duals)
    momenta, names = natural_momenta(formulation, iterate, duals, _weighed(problem))
    drifts, violation = _drifts(formulation, zs), natural_violation(formulation, zs, iterate.xs[:, at.s])
    return Trajectory(
        t=np.arange(N + 1, dtype=np.float64) * problem.dt,
        qs=qs,
        vs=vs,
        ps=_momenta(robot, qs, vs),
        us=iterate.us,
        lams=lams,
        mus=np.array([dual_of_momentum(robot, *row) for row in zip(qs, vs, costates, strict=True)]),
        zetas=zetas,
        eta=iterate.eta,
        control_hamiltonians=natural_hamiltonians(
            formulation, iterate, duals, _stage_costs(formulation, iterate)
        ),
        control_momenta=momenta,
        control_momentum_names=names,
        constraint_violation=violation.position,
        velocity_violation=violation.velocity,
        manifold_drifts=drifts,
        manifold_drift=float(drifts.max(initial=0.0)),
        manifold_drift_resimulated=_resimulated_drift(formulation, iterate),
        **inequalities(formulation, iterate, qs, vs),
    )


def _speed_maps(formulation: Formulation, qs: Array) -> Array | None:
    """V(q) at all nodes, shape (N + 1, nv, ns), where speeds are fewer than velocities."""
    problem, programme = formulation.problem, formulation.programme
    robot = problem.robot
    if not programme.is_explicit or not robot.drives:
        return None
    return speed_maps(robot, qs)


def _velocities(problem: Problem, speeds: Array, us: Array, qs: Array, maps: Array | None) -> Array:
    """Velocities at the nodes; those that a control prescribes are the ones after the node."""
    if maps is None:
        return speeds
    prescribed = np.einsum("nij,nj->ni", control_velocity_maps(problem.robot, qs), np.vstack([us, us[-1:]]))
    velocities: Array = np.einsum("nij,nj->ni", maps, speeds) + prescribed
    return velocities


def _projected_multipliers(problem: Problem, qs: Array, vs: Array, us: Array) -> Array:
    """Multipliers of the constraints at the beginning of each step, from the projected accelerations."""
    robot = problem.robot
    mechanics = ForwardMechanics(robot)
    q, v, u = ca.SX.sym("q", robot.nq), ca.SX.sym("v", robot.nv), ca.SX.sym("u", robot.nu)
    lam = mechanics.multipliers(q, v, u, ca.SX(problem.stabilisation.gamma_constraint))
    function = ca.Function("multipliers", [q, v, u], [ca.densify(lam)])
    found: Array = np.asarray(function.map(len(us))(qs[:-1].T, vs[:-1].T, us.T)).T
    return found


def _tangent_duals(formulation: Formulation, zs: Array, duals: Array) -> Array:
    """Duals of the coordinates as duals of tangent vectors; those of remembered controls are left out."""
    at = formulation.layout
    along = duals[:, : at.nw]
    if at.is_flat and isinstance(formulation.space, ConfigurationSpace) and not formulation.space.is_vector:
        along = np.asarray(_pull_back(formulation.space).map(len(zs))(zs.T, along.T)).T
    return np.hstack([along, duals[:, at.ds]])


@lru_cache(maxsize=_KEPT)
def _pull_back(space: ConfigurationSpace) -> ca.Function:
    """From coordinates and their dual to the dual of the tangent vector."""
    z, c, v = ca.SX.sym("z", space.nz), ca.SX.sym("c", space.nz), ca.SX.sym("v", space.nv)
    return ca.Function("pulled", [z, c], [ca.gradient(ca.dot(c, space.rate(z, v)), v)])


def _velocity_duals(duals: Array, maps: Array | None, nv: int) -> Array:
    """Duals of (q, v); where speeds are fewer than velocities, those of least norm.

    The columns of V are unit vectors on different components, so that V itself is the pseudo-inverse of V'.
    """
    if maps is None:
        return duals
    return np.hstack([duals[:, :nv], np.einsum("nij,nj->ni", maps, duals[:, nv:])])


def _momenta_of_symmetries(
    problem: Problem, qs: Array, vs: Array, costates: Array
) -> tuple[Array, tuple[str, ...]]:
    """Control momenta; none where drives or path constraints are, whose symmetries are not looked for."""
    if problem.robot.drives or problem.path:
        return np.zeros((len(qs), 0)), ()
    return control_momenta(problem.robot, qs, vs, costates, tracked=_weighed(problem))


def _drifts(formulation: Formulation, zs: Array) -> Array:
    """Largest defect of the groups' invariants at each node, shape (N + 1,)."""
    space = formulation.space
    defects = _kept_defects(space) if isinstance(space, ConfigurationSpace) else _defects(space)
    found = np.abs(np.asarray(defects.map(len(zs))(zs.T)))
    drifts: Array = found.max(axis=0, initial=0.0)
    return drifts


@lru_cache(maxsize=_KEPT)
def _kept_defects(space: ConfigurationSpace) -> ca.Function:
    return _defects(space)


def _defects(space: ConfigurationSpace | NaturalSpace) -> ca.Function:
    z = ca.SX.sym("z", space.nz)
    return ca.Function("defects", [z], [ca.densify(space.defects(z))])


def _resimulated_drift(formulation: Formulation, iterate: Iterate) -> float:
    """Largest drift of the forward simulation with the iterate's controls; NaN if it cannot be made."""
    programme = formulation.programme
    if formulation.space.is_vector and isinstance(formulation.space, ConfigurationSpace):
        return 0.0
    native = kernel_programme(programme)
    iterate.load_into(native)
    sweep = native.simulate(_SWEEP_TOLERANCE, _SWEEP_ITERATIONS)
    if not sweep.ok:
        return math.nan
    xs = native.x.reshape(iterate.xs.shape)
    return float(_drifts(formulation, xs[:, formulation.layout.z]).max(initial=0.0))


def boundary_duals(formulation: Formulation, iterate: Iterate) -> Array:
    """Derivatives of the Lagrangian of what follows each node in (q_n, v_n), shape (N + 1, 2 nv)."""
    programme = formulation.programme
    native = kernel_programme(programme)
    iterate.load_into(native)
    native.evaluate()
    costates: Array = native.costates.reshape(programme.num_steps + 1, -1)
    return costates


def _hamiltonians(
    formulation: Formulation,
    iterate: Iterate,
    qs: Array,
    vs: Array,
    costates: Array,
    zetas: Array,
) -> Array:
    """H = L + mu . f + zeta . Phi of every step, eq. (11).

    Explicit schemes: with the step's own increment for f and the adjoint after it, to first order in dt.
    """
    problem, programme = formulation.problem, formulation.programme
    if not programme.is_explicit:
        return _control_hamiltonians(formulation, iterate, qs, vs, costates, zetas)
    at, dt = formulation.layout, problem.dt
    turned = np.array([pin.difference(problem.robot.model, a, b) for a, b in pairwise(qs)])
    moved = np.hstack([turned, np.diff(iterate.xs[:, at.s], axis=0)])
    rows = _tangent_duals(formulation, iterate.xs[1:, at.z], iterate.ms[:, : at.ndx])
    values: Array = np.einsum("ni,ni->n", rows, moved) / dt
    return values + _stage_costs(formulation, iterate) / dt


def _stage_costs(formulation: Formulation, iterate: Iterate) -> Array:
    """Running cost of every step, from the stage functions, shape (N,)."""
    programme = formulation.programme
    N = programme.num_steps
    arguments = (iterate.xs[:-1], iterate.xs[1:], iterate.ys, iterate.us)
    theta = np.tile(programme.theta[:, None], (1, N))
    values = programme.functions.function("values").map(N)
    rho = programme.rho.reshape(N, -1)
    costs: Array = np.asarray(values(*(a.T for a in arguments), theta, rho.T)[1]).ravel()
    return costs


def _control_hamiltonians(
    formulation: Formulation,
    iterate: Iterate,
    qs: Array,
    vs: Array,
    costates: Array,
    zetas: Array,
) -> Array:
    """H at (y_tau, mu_{1 - tau}, u) of every step, eq. (11) and Appendix B.

    In (q, v) and its duals mu . f is c_q . v + mu_p . M a; for constant M that is mu_q . v + mu_p . dp/dt.
    The momentum row's multiplier is mu_p at 1 - tau; c_q is the boundary dual before the step and the
    kinematic row's multiplier after it, before the constraint at the node acts on it.
    """
    problem = formulation.problem
    robot, nv, tau = problem.robot, problem.robot.nv, TAU[problem.scheme]
    at = formulation.layout
    q_taus, v_taus = evaluation_points(robot, problem.scheme, qs, vs, problem.dt)
    rows = _tangent_duals(formulation, iterate.xs[1:, at.z], iterate.ms[:, : at.ndx])
    duals = tau * costates[:-1, :nv] + (1.0 - tau) * rows[:, :nv]
    inertial = _momenta(robot, q_taus, np.diff(vs, axis=0) / problem.dt)
    hamiltonians: Array = (
        _stage_costs(formulation, iterate) / problem.dt
        + np.einsum("ni,ni->n", duals, v_taus)
        + np.einsum("ni,ni->n", rows[:, nv:], inertial)
    )
    if robot.nc:
        residuals = np.array([robot.constraint_residual(q) for q in qs[1:]])
        hamiltonians += np.einsum("ni,ni->n", zetas, residuals)
    return hamiltonians


def _weighed(problem: Problem) -> Array | None:
    """Components of (q, p) that the running cost looks at; one on velocities counts as one on momenta."""
    robot, nv = problem.robot, problem.robot.nv
    given = TermNumbers(problem.cost, robot, ConfigurationSpace(robot.model), problem.num_steps)
    weights = np.zeros(2 * nv)
    for term in running_terms(given):
        weights += term.touches(given)
    limits = problem.limits
    for side in (limits.v_lower, limits.v_upper):
        weights[nv:] += np.isfinite(side)
    bounded = np.isfinite(limits.q_lower) | np.isfinite(limits.q_upper)
    for joint in problem.robot.joint_names:
        if bounded[problem.robot.configuration_indices(joint)].any():
            weights[:nv][problem.robot.velocity_indices(joint)] += 1.0
    return weights if weights.any() else None


def _momenta(robot: Robot, qs: Array, vs: Array) -> Array:
    """M(q) v of each row, once a solve on Pinocchio's own algorithm."""
    momenta: Array = np.einsum("nij,nj->ni", mass_matrices(robot.model, qs), vs)
    return momenta


def _adjoints(
    formulation: Formulation,
    iterate: Iterate,
    qs: Array,
    vs: Array,
    costates: Array,
) -> Array:
    """mu_0 ... mu_N: for SE1 the multipliers of the steps' rows (Box 1), else the boundary duals in (q, p).

    For a constant mass matrix both are the adjoint of Box 1 and of Appendix B. With drives, the duals of
    (q, v): there is no momentum that belongs to all of them.
    """
    problem = formulation.problem
    robot, at = problem.robot, formulation.layout
    if robot.drives:
        return costates
    if problem.scheme == "se1":
        end = dual_of_momentum(robot, qs[-1], vs[-1], costates[-1])
        rows = _tangent_duals(formulation, iterate.xs[1:, at.z], iterate.ms[:, : at.ndx])
        return np.vstack([rows, end])
    return np.array([dual_of_momentum(robot, q, v, c) for q, v, c in zip(qs, vs, costates, strict=True)])

"""Initial guesses: a trajectory to start the solver from, in the programme's unknowns.

Guesses are made once a solve from Pinocchio's numeric algorithms; their loops over the steps are not in the
hot path.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import DimensionMismatch, ProblemError, ResultFileError
from mbocp.formulation import Formulation, formulate
from mbocp.integrators import TAU, evaluation_points
from mbocp.lie import ConfigurationSpace
from mbocp.mechanics import NaturalSpace, dual_of_velocity
from mbocp.mechanisms.closed_path import closed_way, constraint_jacobians
from mbocp.mechanisms.consistency import project_on_constraints, tangent_space
from mbocp.natural import natural_iterate
from mbocp.problem import Guess, Problem
from mbocp.programme.iterate import BoundMultipliers
from mbocp.programme.kernel import kernel_programme
from mbocp.robot import Robot
from mbocp.robot.drives import speed_maps
from mbocp.robot.large import working_data
from mbocp.solution import Solution
from mbocp.solvers import Iterate, Methods, SolverResult, Status, pursue, zero_multipliers

__all__ = ["guess_candidates", "iterate_from_solution", "make_guess"]

_SWEEP_TOLERANCE = 1e-12  # of a step's residual; a Newton step below that is round-off
_SWEEP_ITERATIONS = 50
_NUDGE = 0.1  # [m/s, rad/s, m/s^2, rad/s^2] on drives, see `_driven_line`
_EXPLICIT_TAU = 1.0  # explicit schemes begin a line like SE1: its velocities lag by half a step, no more
_SAYS_ENOUGH = 1e-6  # part that written joints have in every motion that the constraints allow
_EQUILIBRIUM = 1e-8  # relative part of the gravity force that the controls may leave uncompensated


def guess_candidates(problem: Problem) -> tuple[str, ...]:
    """Kinds of guess to try in turn: the one that was asked for, or those that suit the problem.

    A goal that is given in full is approached on the straight line, with the controls that this takes. A
    robot that can hold still at its start may begin by doing so. Zero control and a forward simulation
    always satisfies the dynamics.
    """
    if problem.guess.kind != "auto":
        return (problem.guess.kind,)
    if problem.coordinates == "natural":  # far from a solution Newton's method gets on badly there
        return ("joint", *guess_candidates(problem.with_(coordinates="joint")))
    kinds = ["line"] if _is_whole(problem) else []
    if _can_hold(problem):
        kinds.append("hold")
    return (*kinds, "control")


def make_guess(kind: str, formulation: Formulation) -> tuple[Iterate, str]:
    """Iterate of the given kind, and words that say what was taken.

    Raises
    ------
    ProblemError
        If the forward simulation with a constant control fails, or a saved solution does not fit.
    """
    problem, programme = formulation.problem, formulation.programme
    if kind == "joint":
        return _from_joints(formulation)
    if kind == "control":
        u = np.zeros(problem.robot.nu) if problem.guess.u is None else problem.guess.u
        return _simulated(formulation, u), f"forward simulation with u = {np.array2string(u, precision=4)}"
    if kind == "line":
        if programme.is_explicit and problem.robot.drives:
            return _driven_line(formulation), "straight line in the configuration space"
        return _line(formulation), "straight line in the configuration space, inverse dynamics"
    if kind == "at_rest":
        return _at_rest(formulation), "straight line in the configuration space, nothing moves"
    if kind == "hold":
        return _hold(formulation), "hold the start, gravity compensated"
    if problem.guess.path is None:
        raise ProblemError('guess.kind = "solution" needs guess.file')
    saved = Solution.load(problem.guess.path)
    try:
        return iterate_from_solution(saved, formulation), f"saved solution {problem.guess.path.name}"
    except DimensionMismatch as error:
        raise ResultFileError(
            problem.guess.path, f"does not fit robot {problem.robot.name!r}: {error}"
        ) from error


def iterate_from_solution(saved: Solution, formulation: Formulation) -> Iterate:
    """Iterate from a solution with any number of steps, interpolated in time on the manifold.

    Raises
    ------
    DimensionMismatch
        If the solution belongs to a robot of other dimensions.
    """
    problem, programme = formulation.problem, formulation.programme
    robot, N, dt = problem.robot, problem.num_steps, programme.dt
    got = (saved.qs.shape[1], saved.vs.shape[1], saved.us.shape[1], saved.lams.shape[1])
    if saved.coordinates == "natural":  # whose multipliers belong to other constraints
        got = (*got[:3], robot.nc)
    if got != (robot.nq, robot.nv, robot.nu, robot.nc):
        raise DimensionMismatch("warm start (nq, nv, nu, nc)", got, (robot.nq, robot.nv, robot.nu, robot.nc))
    nodes = np.linspace(0.0, saved.num_steps, N + 1)
    left = np.minimum(nodes.astype(int), saved.num_steps - 1)
    share = nodes - left
    qs = np.array(
        [
            pin.interpolate(robot.model, saved.qs[i], saved.qs[i + 1], s)
            for i, s in zip(left, share, strict=True)
        ]
    )
    vs = _between(saved.vs, left, share)
    middle = np.minimum(((np.arange(N) + 0.5) * saved.num_steps / N).astype(int), saved.num_steps - 1)
    us = saved.us[middle]
    if isinstance(formulation.space, NaturalSpace):
        return natural_iterate(formulation, formulation.space, qs, vs, us)
    xs = _states(formulation, qs, vs, us)
    lams = saved.lams[middle] if saved.coordinates != "natural" else np.zeros((N, robot.nc))
    is_flat = formulation.layout.is_flat and not robot.is_vector_space
    if programme.is_explicit or is_flat or saved.coordinates == "natural":
        return zero_multipliers(programme, xs, dt * lams[:, : programme.kinds[0].ny], us)
    mus = _row_multipliers(saved, problem, left, share)
    return Iterate(
        xs=xs,
        ys=dt * saved.lams[middle],
        us=us,
        ms=np.hstack([mus, np.zeros((N, formulation.layout.nr)), dt**2 * saved.zetas[middle]]),
        eta=saved.eta if saved.eta.size == programme.ng else np.zeros(programme.ng),
        bounds=_bound_multipliers(saved, formulation, left, share, middle),
    )


def _bound_multipliers(
    saved: Solution, formulation: Formulation, left: Any, share: Array, middle: Any
) -> BoundMultipliers | None:
    """Multipliers of limits where states are (q, v); those of path constraints and guards begin anew."""
    programme = formulation.programme
    if not (saved.lam_us.any() or saved.lam_qs.any() or saved.lam_vs.any()):
        return None
    lam_xs = _between(np.hstack([saved.lam_qs, saved.lam_vs]), left, share)
    N, at = programme.num_steps, formulation.layout
    return BoundMultipliers(
        xs=np.hstack([lam_xs, np.zeros((N + 1, at.nr))]),
        us=saved.lam_us[middle],
        path=np.zeros((N, programme.bounds.nh)),
        guard=np.zeros(programme.num_guards),
    )


def _between(values: Array, left: Any, share: Array) -> Array:
    out: Array = values[left] + share[:, None] * (values[left + 1] - values[left])
    return out


def _row_multipliers(saved: Solution, problem: Problem, left: Any, share: Array) -> Array:
    """Multipliers of kinematic and momentum rows from the adjoints of a solution by any scheme.

    The kinematic row's is the dual of q at one end of the step, the momentum row's that of p at 1 - tau (to
    first order in dt where the mass matrix varies, which the first Newton step mends).
    """
    robot, nv, tau = problem.robot, problem.robot.nv, TAU[problem.scheme]
    duals_q, duals_p = saved.mus[:, :nv].copy(), saved.mus[:, nv:]
    # SE1 reports multipliers of rows already, but for the last node.
    for n in range(saved.num_steps + 1) if saved.scheme in ("se2", "midpoint") else [-1]:
        duals_q[n] = dual_of_velocity(robot, saved.qs[n], saved.vs[n], saved.mus[n])[:nv]
    duals_q, duals_p = _between(duals_q, left, share), _between(duals_p, left, share)
    along_q = duals_q[:-1] if tau == 1.0 else duals_q[1:]
    return np.hstack([along_q, tau * duals_p[:-1] + (1.0 - tau) * duals_p[1:]])


def _simulated(formulation: Formulation, u: Array) -> Iterate:
    """Constant control and forward simulation, the paper's guess (section 6)."""
    problem, programme = formulation.problem, formulation.programme
    native = kernel_programme(programme)
    native.u = np.tile(u, problem.num_steps)
    xs = np.zeros((problem.num_steps + 1, programme.x_start.size))
    xs[0] = programme.x_start
    native.x = xs.ravel()
    sweep = native.simulate(_SWEEP_TOLERANCE, _SWEEP_ITERATIONS)
    if not sweep.ok:
        when = (sweep.failed_stage + 1) * problem.dt
        raise ProblemError(
            f"guess: the forward simulation with constant control fails in the step to t = {when:g} s "
            f"(residual {sweep.residual:.1e}); take more steps, another guess.u, or another guess.kind"
        )
    return Iterate.read_from(native, programme)


def _states(formulation: Formulation, qs: Array, vs: Array, us: Array) -> Array:
    """States of the programme at configurations and velocities, beginning with the given one."""
    problem, programme = formulation.problem, formulation.programme
    robot, at = problem.robot, formulation.layout
    xs = np.zeros((len(qs), at.nx))
    xs[:, at.z] = formulation.space.coordinates(qs)
    if programme.is_explicit and robot.drives:
        # The columns of V are unit vectors on different components: its transpose takes the nearest speeds.
        xs[:, at.s] = np.einsum("nij,ni->nj", speed_maps(robot, qs), vs)
    else:
        xs[:, at.s] = vs
    if at.nr:
        xs[1:, at.r] = us
    xs[0] = programme.x_start
    return xs


def _hold(formulation: Formulation) -> Iterate:
    problem = formulation.problem
    robot, N = problem.robot, problem.num_steps
    still, G = np.zeros(robot.nv), robot.constraint_jacobian(problem.q_start)
    u, lam = _balance(robot, problem.q_start, still, still, G)
    qs = np.tile(problem.q_start, (N + 1, 1))
    us = np.tile(u, (N, 1))
    return _iterate(formulation, qs, np.tile(still, (N + 1, 1)), us, np.tile(lam, (N, 1)))


def _line(formulation: Formulation) -> Iterate:
    problem, programme = formulation.problem, formulation.programme
    robot, dt = problem.robot, problem.dt
    qs, vs = _line_states(formulation)
    if programme.is_explicit:
        q_taus, v_taus = qs[:-1], vs[:-1]
    else:
        q_taus, v_taus = evaluation_points(robot, problem.scheme, qs, vs, dt)
    accelerations = np.diff(vs, axis=0) / dt
    us, lams = _balances(robot, q_taus, v_taus, accelerations)
    return _iterate(formulation, qs, vs, us, lams)


def _iterate(formulation: Formulation, qs: Array, vs: Array, us: Array, lams: Array) -> Iterate:
    """Iterate at a motion of the joints with the multipliers of the robot's constraints, adjoints zero."""
    problem, programme = formulation.problem, formulation.programme
    if isinstance(formulation.space, NaturalSpace):
        return natural_iterate(formulation, formulation.space, qs, vs, us)
    ys = problem.dt * lams[:, : programme.kinds[0].ny]
    return zero_multipliers(programme, _states(formulation, qs, vs, us), ys, us)


def _from_joints(formulation: Formulation) -> tuple[Iterate, str]:
    """Optimum in joint coordinates, in natural ones; or what comes nearest to it."""
    problem = formulation.problem
    best: SolverResult | None = None
    joint = problem.with_(coordinates="joint", guess=Guess(), solver=replace(problem.solver, method="auto"))
    stepwise = formulate(joint)
    methods = Methods.of(joint.solver, stepwise.programme, has_inequalities=joint.is_bounded)
    taken = 0
    for kind in guess_candidates(joint):
        result = pursue(methods, stepwise.programme, make_guess(kind, stepwise)[0]).result
        if result.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        taken += sum(not record.is_guess for record in result.history)
        if best is None or result.record.residual < best.record.residual:
            best = result
        if result.status is Status.CONVERGED:
            break
    if best is None:
        raise ProblemError("no guess could be made in joint coordinates; give guess.kind")
    found, at = best.iterate, stepwise.layout
    qs = stepwise.space.configurations(found.xs[:, at.z]) if at.is_flat else found.xs[:, at.z]
    iterate = _iterate(formulation, qs, found.xs[:, at.s], found.us, found.ys / problem.dt)
    what = "optimum" if best.status is Status.CONVERGED else f"best iterate ({best.status})"
    return iterate, f"{what} in joint coordinates after {taken} iterations, mapped to bodies"


def _driven_line(formulation: Formulation) -> Iterate:
    """Configurations on the line at a steady rate, with the velocities that go with it.

    Where controls prescribe velocities, a line is seldom a motion. A little of every drive's speed and
    control breaks the symmetry of tasks whose goal is where they start.
    """
    problem, programme = formulation.problem, formulation.programme
    robot, N, dt = problem.robot, problem.num_steps, problem.dt
    qs = _straight(problem, np.linspace(0.0, 1.0, N + 1))
    rate = np.array([pin.difference(robot.model, qs[n], qs[n + 1]) / dt for n in range(N)])
    us = np.zeros((N, robot.nu))
    us[:, robot.nu - len(robot.drives) :] = _NUDGE
    xs = _states(formulation, qs, np.vstack([rate, rate[-1]]), us)
    num_free = robot.nv - len(robot.driven)
    xs[1:, formulation.layout.s][:, num_free:] += _NUDGE
    return zero_multipliers(programme, xs, np.zeros((N, 0)), us)


def _at_rest(formulation: Formulation) -> Iterate:
    """Configurations on the line, every velocity and control zero: agrees with no kinematics, on purpose."""
    problem = formulation.problem
    robot, N = problem.robot, problem.num_steps
    qs = _straight(problem, np.linspace(0.0, 1.0, N + 1))
    still, us = np.zeros((N + 1, robot.nv)), np.zeros((N, robot.nu))
    return _iterate(formulation, qs, still, us, np.zeros((N, robot.nc)))


def _straight(problem: Problem, shares: Array) -> Array:
    """Configurations between start and goal, shares of the way from one to the other."""
    return _on_the_way(problem.robot, problem.q_start, problem.goal.q, shares)


def _on_the_way(robot: Robot, q_start: Array, q_goal: Array, shares: Array) -> Array:
    """Configurations on the straight line, or as near to it as closed loops allow."""
    every = np.arange(robot.nv)
    if robot.nc:
        way = closed_way(robot, project_on_constraints(robot, q_start, every), q_goal, shares)
        if way is not None:
            return way
    qs = np.array([pin.interpolate(robot.model, q_start, q_goal, s) for s in shares])
    return np.array([project_on_constraints(robot, q, every) for q in qs]) if robot.nc else qs


def _line_states(formulation: Formulation) -> tuple[Array, Array]:
    """Nodes on the straight line from start to goal, with velocities that the scheme's kinematics ask for."""
    problem, programme = formulation.problem, formulation.programme
    robot, N, dt = problem.robot, problem.num_steps, problem.dt
    tau = TAU.get(problem.scheme, _EXPLICIT_TAU)
    is_own = not programme.is_explicit and isinstance(formulation.space, ConfigurationSpace)
    v_start = programme.x_start[formulation.layout.s] if is_own else problem.v_start
    model, q_start = robot.model, problem.q_start
    s = np.linspace(0.0, 1.0, N + 1)
    if tau == 0.0:  # the first step goes where the start velocity says, whatever the controls
        s = np.append(0.0, np.linspace(0.0, 1.0, N))
        q_start = pin.integrate(model, q_start, dt * v_start)
    blend = s**3 * (10 - 15 * s + 6 * s**2)  # from rest to rest, with zero acceleration at the ends
    qs = _on_the_way(robot, q_start, problem.goal.q, blend)
    qs[0] = problem.q_start
    steps = np.array([pin.difference(model, qs[n], qs[n + 1]) / dt for n in range(N)])
    if tau == 1.0:
        return qs, np.vstack([v_start, steps])
    if tau == 0.0:
        return qs, np.vstack([v_start, steps[1:], np.zeros(robot.nv)])
    vs = np.zeros((N + 1, robot.nv))
    for n in range(N):  # from rest: beginning with the start velocity they would swing about the line's
        vs[n + 1] = 2 * steps[n] - vs[n]
    vs[0] = v_start
    return qs, vs


def _required_force(robot: Robot, q: Array, v: Array, a: Array) -> Array:
    """Generalised force that actuators and constraints have to supply for a motion, shape (nv,)."""
    force: Array = pin.rnea(robot.model, working_data(robot.model), q, v, a)
    return force - robot.force_elements(q, v) if robot.has_forces else force


def _balances(robot: Robot, qs: Array, vs: Array, accelerations: Array) -> tuple[Array, Array]:
    """Controls and multipliers that balance the inverse dynamics best along a motion."""
    motion = zip(qs, vs, accelerations, strict=True)
    if robot.nc or robot.has_forces or robot.actuation.frame_actuators:
        rows = constraint_jacobians(robot, qs)
        balanced = [_balance(robot, *at, G) for at, G in zip(motion, rows, strict=True)]
        return np.array([u for u, _ in balanced]), np.array([lam for _, lam in balanced])
    data, columns = working_data(robot.model), robot.actuation_matrix(qs[0])  # the same everywhere
    forces = np.array([pin.rnea(robot.model, data, *at).copy() for at in motion])
    us: Array = np.linalg.lstsq(columns, forces.T, rcond=None)[0].T
    return np.ascontiguousarray(us), np.zeros((len(qs), 0))


def _balance(robot: Robot, q: Array, v: Array, a: Array, dPhi_dq: Array) -> tuple[Array, Array]:
    """Controls and multipliers that balance the inverse dynamics best, in the least-squares sense."""
    columns = np.hstack([robot.actuation_matrix(q), -dPhi_dq.T])
    found = np.linalg.lstsq(columns, _required_force(robot, q, v, a), rcond=None)[0]
    return found[: robot.nu], found[robot.nu :]


def _is_whole(problem: Problem) -> bool:
    """Whether the goal says all of the end configuration, or enough for the constraints to say the rest."""
    active = problem.goal.q_active
    if active.all() or not active.any():
        return bool(active.all())
    allowed = tangent_space(problem.robot, problem.goal.q)
    singular = np.linalg.svd(allowed[active], compute_uv=False)
    return len(singular) >= allowed.shape[1] and bool(
        singular[: allowed.shape[1]].min(initial=1.0) > _SAYS_ENOUGH
    )


def _can_hold(problem: Problem) -> bool:
    robot, q = problem.robot, problem.q_start
    rest = np.zeros(robot.nv)
    G = robot.constraint_jacobian(q)
    u, lam = _balance(robot, q, rest, rest, G)
    wanted = _required_force(robot, q, rest, rest)
    left = wanted - robot.actuation_matrix(q) @ u + G.T @ lam
    return bool(np.abs(left).max(initial=0.0) <= _EQUILIBRIUM * (1.0 + np.abs(wanted).max(initial=0.0)))

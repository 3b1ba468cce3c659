"""Initial guesses: a trajectory to start the solver from, in the programme's unknowns.

Guesses are made once a solve from Pinocchio's numeric algorithms; their loops over the steps are not in the
hot path.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import DimensionMismatch, ProblemError, ResultFileError
from mbocp.problem import Problem
from mbocp.problem.consistency import project_on_constraints
from mbocp.robot import Robot
from mbocp.solution import Solution
from mbocp.solvers import Iterate, zero_multipliers
from mbocp.solvers.native import kernel_programme
from mbocp.transcription import StagewiseProgramme

__all__ = ["guess_candidates", "iterate_from_solution", "make_guess"]

_SWEEP_TOLERANCE = 1e-12  # of a step's residual; a Newton step below that is round-off
_SWEEP_ITERATIONS = 50
_EQUILIBRIUM = 1e-8  # relative part of the gravity force that the controls may leave uncompensated


def guess_candidates(problem: Problem) -> tuple[str, ...]:
    """Kinds of guess to try in turn: the one that was asked for, or those that suit the problem.

    A goal that is given in full is approached on the straight line, with the controls that this takes. A
    robot that can hold still at its start may begin by doing so. Zero control and a forward simulation
    always satisfies the dynamics.
    """
    if problem.guess.kind != "auto":
        return (problem.guess.kind,)
    kinds = ["line"] if problem.goal.q_active.all() else []
    if _can_hold(problem):
        kinds.append("hold")
    return (*kinds, "control")


def make_guess(kind: str, problem: Problem, programme: StagewiseProgramme) -> tuple[Iterate, str]:
    """Iterate of the given kind, and words that say what was taken.

    Raises
    ------
    ProblemError
        If the forward simulation with a constant control fails, or a saved solution does not fit.
    """
    if kind == "control":
        u = np.zeros(problem.robot.nu) if problem.guess.u is None else problem.guess.u
        return _simulated(
            problem, programme, u
        ), f"forward simulation with u = {np.array2string(u, precision=4)}"
    if kind == "line":
        return _line(problem, programme), "straight line in the configuration space, inverse dynamics"
    if kind == "hold":
        return _hold(problem, programme), "hold the start, gravity compensated"
    if problem.guess.path is None:
        raise ProblemError('guess.kind = "solution" needs guess.file')
    saved = Solution.load(problem.guess.path)
    try:
        return iterate_from_solution(saved, problem, programme), f"saved solution {problem.guess.path.name}"
    except DimensionMismatch as error:
        raise ResultFileError(
            problem.guess.path, f"does not fit robot {problem.robot.name!r}: {error}"
        ) from error


def iterate_from_solution(saved: Solution, problem: Problem, programme: StagewiseProgramme) -> Iterate:
    """Iterate from a solution with any number of steps, interpolated in time on the manifold.

    Raises
    ------
    DimensionMismatch
        If the solution belongs to a robot of other dimensions.
    """
    robot, N = problem.robot, problem.num_steps
    got = (saved.qs.shape[1], saved.vs.shape[1], saved.us.shape[1], saved.lams.shape[1])
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
    vs = saved.vs[left] + share[:, None] * (saved.vs[left + 1] - saved.vs[left])
    qs[0], vs[0] = problem.q_start, problem.v_start
    middle = np.minimum(((np.arange(N) + 0.5) * saved.num_steps / N).astype(int), saved.num_steps - 1)
    mus = saved.mus[left[:-1]] + share[:-1, None] * (saved.mus[left[:-1] + 1] - saved.mus[left[:-1]])
    dt = programme.dt
    return Iterate(
        xs=np.hstack([qs, vs]),
        ys=dt * saved.lams[middle],
        us=saved.us[middle],
        ms=np.hstack([mus, dt**2 * saved.zetas[middle]]),
        eta=saved.eta if saved.eta.size == programme.ng else np.zeros(programme.ng),
    )


def _simulated(problem: Problem, programme: StagewiseProgramme, u: Array) -> Iterate:
    """Constant control and forward simulation, the paper's guess (section 6)."""
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


def _hold(problem: Problem, programme: StagewiseProgramme) -> Iterate:
    robot, N = problem.robot, problem.num_steps
    u, lam = _balance(robot, problem.q_start, np.zeros(robot.nv), np.zeros(robot.nv))
    rest = np.concatenate([problem.q_start, np.zeros(robot.nv)])
    xs = np.tile(rest, (N + 1, 1))
    xs[0] = programme.x_start
    return zero_multipliers(programme, xs, np.tile(problem.dt * lam, (N, 1)), np.tile(u, (N, 1)))


def _line(problem: Problem, programme: StagewiseProgramme) -> Iterate:
    robot, N, dt = problem.robot, problem.num_steps, problem.dt
    s = np.linspace(0.0, 1.0, N + 1)
    blend = s**3 * (10 - 15 * s + 6 * s**2)  # from rest to rest, with zero acceleration at the ends
    model = robot.model
    qs = np.array([pin.interpolate(model, problem.q_start, problem.goal.q, b) for b in blend])
    if robot.nc:
        qs = np.array([project_on_constraints(robot, q, np.arange(robot.nv)) for q in qs])
    qs[0] = problem.q_start
    steps = [pin.difference(model, qs[n], qs[n + 1]) / dt for n in range(N)]
    vs = np.vstack([problem.v_start, *steps])
    balanced = [_balance(robot, qs[n + 1], vs[n + 1], (vs[n + 1] - vs[n]) / dt) for n in range(N)]
    us, lams = np.array([u for u, _ in balanced]), np.array([lam for _, lam in balanced])
    return zero_multipliers(programme, np.hstack([qs, vs]), dt * lams, us)


def _required_force(robot: Robot, q: Array, v: Array, a: Array) -> Array:
    """Generalised force that actuators and constraints have to supply for a motion, shape (nv,)."""
    force: Array = pin.rnea(robot.model, robot.model.createData(), q, v, a)
    return force - robot.force_elements(q, v) if robot.forces else force


def _balance(robot: Robot, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Controls and multipliers that balance the inverse dynamics best, in the least-squares sense."""
    columns = np.hstack([robot.actuation_matrix(q), -robot.constraint_jacobian(q).T])
    found = np.linalg.lstsq(columns, _required_force(robot, q, v, a), rcond=None)[0]
    return found[: robot.nu], found[robot.nu :]


def _can_hold(problem: Problem) -> bool:
    robot, q = problem.robot, problem.q_start
    rest = np.zeros(robot.nv)
    u, lam = _balance(robot, q, rest, rest)
    wanted = _required_force(robot, q, rest, rest)
    left = wanted - robot.actuation_matrix(q) @ u + robot.constraint_jacobian(q).T @ lam
    return bool(np.abs(left).max(initial=0.0) <= _EQUILIBRIUM * (1.0 + np.abs(wanted).max(initial=0.0)))

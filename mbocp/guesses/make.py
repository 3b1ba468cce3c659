"""Guesses of every kind, and which of them suit a problem."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import DimensionMismatch, ProblemError, ResultFileError
from mbocp.formulation import Formulation, Motion, formulate
from mbocp.formulation.features.changing_constraints import fill_impulses
from mbocp.formulation.features.step_lengths import length_controls
from mbocp.guesses.along import balance, balances, compute_required_force, follows_path, is_led
from mbocp.guesses.around import around
from mbocp.guesses.from_solution import iterate_from_solution
from mbocp.guesses.straight_line import at_rest, drive_line, is_whole, line
from mbocp.guesses.ways import read_given_way
from mbocp.job import settings_of
from mbocp.problem import Guess, Problem
from mbocp.problem.coordinates import COORDINATES
from mbocp.programme import Iterate
from mbocp.programme.kernel import kernel_programme
from mbocp.solution import Solution
from mbocp.solvers import SolverResult, Start, Status, run_strategy

_EQUILIBRIUM = 1e-8  # relative part of the gravity force that the controls may leave uncompensated


def guess_candidates(problem: Problem) -> tuple[str, ...]:
    """Kinds of guess to try in turn, see `kinds_in_turn`."""
    return tuple(kinds_in_turn(problem))


def kinds_in_turn(problem: Problem) -> Iterator[str]:
    """Kinds of guess to try in turn: the one that was asked for, or those that suit the problem.

    A goal that is given in full is approached on the straight line, with the controls that this takes, and so
    are via points; a path that a frame follows is a way, too. A robot that can hold still at its start may
    begin by doing so. Zero control and a forward simulation always satisfies the dynamics.
    """
    if problem.guess.kind != "auto":
        yield problem.guess.kind
        return
    if COORDINATES[problem.coordinates].takes_joint_guess:
        yield "joint"
        yield from kinds_in_turn(problem.with_(coordinates="joint"))
        return
    if is_whole(problem) or problem.via or follows_path(problem):
        yield "line"
    if can_hold(problem):
        yield "hold"
    yield "control"


def plain_guess(kind: str, formulation: Formulation, deadline: float = math.inf) -> tuple[Iterate, str]:
    """Iterate of "control", "line", "way", "at_rest" or "hold", and words that say what was taken.

    Raises
    ------
    ProblemError
        If the forward simulation with a constant control fails.
    CompilationTimeout
        If the deadline, a time of `time.perf_counter`, passes.
    """
    problem = formulation.problem
    if kind == "control":
        u = np.zeros(problem.robot.nu) if problem.guess.u is None else problem.guess.u
        return guess_by_simulation(
            formulation, u
        ), f"forward simulation with u = {np.array2string(u, precision=4)}"
    if kind == "at_rest":
        return at_rest(formulation), "straight line in the configuration space, nothing moves"
    if kind == "hold":
        how = "" if can_hold(problem) else " as far as the controls can"
        return hold(formulation, deadline), f"hold the start, gravity compensated{how}"
    given = read_given_way(problem)
    way = given or around(problem)
    usual = "a way that frames keep to" if is_led(problem) else "straight line in the configuration space"
    words = usual if way is None else "a way around obstacles"
    words = words if given is None else "straight lines through the configurations of guess.q"
    if problem.robot.drives:
        return drive_line(formulation, way), words
    return line(formulation, way, deadline), f"{words}, inverse dynamics"


def explain_none_made(failed: Mapping[str, ProblemError]) -> ProblemError:
    """Return the error for guesses of which none could be made: why each failed."""
    if len(failed) == 1:
        return next(iter(failed.values()))
    reasons = "; ".join(f"{kind}: {str(error).removeprefix('guess: ')}" for kind, error in failed.items())
    return ProblemError(f"guess: none could be made; {reasons}")


def can_hold(problem: Problem) -> bool:
    """Whether controls and constraints, with what the first step holds, can keep the robot at its start."""
    robot, q, table = problem.robot, problem.q_start, problem.timeline.switches
    rest = np.zeros(robot.nv)
    G = robot.constraint_jacobian(q) if table is None else table.derivatives(q, table.own[0], table.pushes[0])
    u, lam = balance(robot, q, rest, rest, G)
    wanted = compute_required_force(robot, q, rest, rest)
    left = wanted - robot.actuation_matrix(q) @ u + G.T @ lam
    return bool(np.abs(left).max(initial=0.0) <= _EQUILIBRIUM * (1.0 + np.abs(wanted).max(initial=0.0)))


def hold(formulation: Formulation, deadline: float = math.inf) -> Iterate:
    """Stay at the start, with the controls and multipliers that come nearest to balancing it."""
    problem, N = formulation.problem, formulation.problem.num_steps
    qs, vs = np.tile(problem.q_start, (N + 1, 1)), np.zeros((N + 1, problem.robot.nv))
    table = problem.timeline.switches
    at = slice(1, 2 if table is None else None)  # steps are alike where all hold the same
    us, lams = balances(problem.robot, qs[at], vs[at], vs[at], table, deadline)
    us, lams = (np.tile(values, (N // len(values), 1)) for values in (us, lams))
    return formulation.iterate_of(Motion(qs, vs, us, problem.timeline.lengths()), lams)


_SWEEP_TOLERANCE = 1e-12  # of a step's residual; a Newton step below that is round-off
_SWEEP_ITERATIONS = 50


def guess_by_simulation(
    formulation: Formulation, u: Array, *, tolerance: float = _SWEEP_TOLERANCE, **how: bool
) -> Iterate:
    """Constant control and forward simulation, the paper's guess (section 6).

    Parameters
    ----------
    formulation : Formulation
    u : ndarray, shape (nu,)
        Control of all steps.
    tolerance : float
        Of the residual of each step, in its unit of force.
    **how : bool
        What the kernel's `simulate` takes. With ``compensated = True`` the rows of a step take what rounding
        the states left of those before (section VIII.5 of [Hairer2006]_): the round-off of many steps does
        not add up then.
    """
    problem, programme = formulation.problem, formulation.programme
    native = kernel_programme(programme, sweeps=True)
    at = formulation.layout
    values = formulation.pieces.signature.control_values
    us = np.zeros((problem.num_steps, at.num_controls))
    us[:, : at.num_own] = values.constant(np.tile(u, (problem.num_steps, 1)))
    if "lengths" in at.controls:
        us[:, at.controls["lengths"]] = length_controls(problem, problem.timeline.lengths())
    native.u = us.ravel()
    xs = np.zeros((problem.num_steps + 1, programme.x_start.size))
    xs[0] = programme.x_start
    native.x = xs.ravel()
    sweep = native.simulate(tolerance, _SWEEP_ITERATIONS, **how)
    if not sweep.ok:
        raise ProblemError(
            f"guess: the forward simulation with constant control fails "
            f"{programme.describe_step(sweep.failed_stage)} "
            f"(residual {sweep.residual:.1e}); take more steps, another guess.u, or another guess.kind"
        )
    return Iterate.read_from(native, programme)


def make_guess(kind: str, formulation: Formulation, deadline: float = math.inf) -> tuple[Iterate, str]:
    """Iterate of the given kind, and words that say what was taken.

    Raises
    ------
    ProblemError
        If the forward simulation with a constant control fails, or a saved solution does not fit.
    CompilationTimeout
        If the deadline, a time of `time.perf_counter`, passes.
    """
    if kind == "joint":
        return _guess_from_joints(formulation)
    if kind == "solution":
        return _from_file(formulation)
    return plain_guess(kind, formulation, deadline)


def _from_file(formulation: Formulation) -> tuple[Iterate, str]:
    problem = formulation.problem
    if problem.guess.path is None:
        raise ProblemError('guess.kind = "solution" needs guess.file')
    saved = Solution.load(problem.guess.path)
    try:
        return iterate_from_solution(
            saved, formulation, problem.guess.at
        ), f"saved solution {problem.guess.path.name}"
    except DimensionMismatch as error:
        raise ResultFileError(
            problem.guess.path, f"does not fit robot {problem.robot.name!r}: {error}"
        ) from error


def _guess_from_joints(formulation: Formulation) -> tuple[Iterate, str]:
    """Optimum in joint coordinates, in natural ones; or what comes nearest to it."""
    problem = formulation.problem
    best: SolverResult | None = None
    joint = problem.with_(coordinates="joint", guess=Guess(), solver=replace(problem.solver, method="auto"))
    stepwise = formulate(joint)
    failed: dict[str, ProblemError] = {}
    taken = 0
    for kind in guess_candidates(joint):
        try:
            guess, _ = plain_guess(kind, stepwise)
        except ProblemError as error:
            failed[kind] = error
            continue
        start = Start(stepwise.programme, guess)
        result = run_strategy(settings_of(stepwise), start).result
        if result.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        taken += sum(not record.is_guess for record in result.history)
        if best is None or result.record.residual < best.record.residual:
            best = result
        if result.status is Status.CONVERGED:
            break
    if best is None:
        raise explain_none_made(failed)
    motion = stepwise.motion_of(best.iterate)
    lams = best.iterate.ys / fill_impulses(formulation.problem, motion.dts)
    iterate = formulation.iterate_of(motion, lams)
    what = "optimum" if best.status is Status.CONVERGED else f"best iterate ({best.status})"
    return iterate, f"{what} in joint coordinates after {taken} iterations, mapped to bodies"

"""One attempt at a job: formulate the problem, guess, run the solver.

Which entries of the velocity are conditions of the end follows from the constraints at `goal.q`. Where the
goal does not give every joint, that is a guess, and feet that land, say, stand elsewhere in the end. Where
the chosen entries leave velocities that the constraints allow there, the problem is solved again from where
it is, with conditions on just these: they are numbers of a parameter, and compile nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation import Formulation, formulate
from mbocp.formulation.end_reached import miss_of_rates
from mbocp.formulation.formulate import formulate_with_independent_ends
from mbocp.guesses.in_turn import solve_from_guesses
from mbocp.job import Job
from mbocp.programme.iterate import Carried
from mbocp.solution.read_solution import Attempt
from mbocp.solution.records import StartRecord
from mbocp.solvers import Outcome, Phase, Status
from mbocp.solvers.records import time_phase


def attempt(job: Job) -> Attempt:
    """Formulate a problem, guess, and run the solver: from one guess after the other, or from several."""
    begun, phases = time.perf_counter(), list[Phase]()
    with time_phase(phases, "compile"):
        members = [
            (place if job.problem.goals else None, *formulate_with_independent_ends(member, job.deadline))
            for place, member in job.problem.members
        ]
    formulation, starts = members[0][1], tuple[StartRecord, ...]()
    if job.has_several_starts:
        from mbocp.guesses.several import solve_from_starts

        goals = [(place, member) for place, member, _ in members]
        formulation, outcome, guess_used, starts = solve_from_starts(job, goals, phases)
    else:
        outcome, guess_used = solve_from_guesses(job, formulation, phases)
    left_out = next(words for _, member, words in members if member is formulation)
    if not job.rough:

        def solve_again(moved: Formulation, start: Carried) -> Outcome:
            return solve_from_guesses(replace(job, start=start, brief=0), moved, phases)[0]

        formulation, outcome = with_rates_at_end(formulation, outcome, solve_again)
    return Attempt(formulation, outcome, tuple(phases), guess_used, left_out, begun, starts)


_ROUNDS = 6  # of solving again: each leaves a tenth or less, since the end moves with the conditions

Again = Callable[[Formulation, Carried], Outcome]


def with_rates_at_end(
    formulation: Formulation, outcome: Outcome, again: Again
) -> tuple[Formulation, Outcome]:
    """Formulation and outcome whose velocities are the goal's at the configuration in which the motion ends.

    Parameters
    ----------
    formulation : Formulation
    outcome : Outcome
        As the solver left it. What has not converged stays as it is, and so does what does not get there,
        and a robot that is found with the motion, of which the end is no configuration of the given one.
    again : callable
        Solves a formulation from an iterate.
    """
    known, shown = formulation, outcome
    for _ in range(_ROUNDS):
        if shown.result.status is not Status.CONVERGED or known.problem.parameter:
            break
        motion = known.motion_of(shown.result.iterate)
        missed = miss_of_rates(known, motion)
        if missed is None or not missed.is_free or missed.is_small:
            formulation, outcome = known, shown  # of use, whatever comes of a further round
        if missed is None or not missed.is_free or known.problem.goal.q_active.all():
            break
        moved = _with_end_at(known, motion.qs[-1])
        if np.array_equal(moved.end_rows.of_joints, known.end_rows.of_joints):
            break
        carried = Carried.of(shown.result.iterate, moved.programme)
        none = np.zeros(moved.programme.ng)  # no multiplier of the end, whose rows are others
        after = again(moved, replace(carried, iterate=replace(carried.iterate, eta=none)))
        known, shown = moved, after.with_history((*shown.result.history, *after.result.history))
    return formulation, outcome.with_history(shown.result.history)


def _with_end_at(formulation: Formulation, q: Array) -> Formulation:
    """The same problem, its conditions of the end chosen at another configuration."""
    problem = formulation.problem
    return formulate(replace(problem, goal=replace(problem.goal, q=q, q_is_reached=True)))

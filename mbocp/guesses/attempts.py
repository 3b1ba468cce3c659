"""One attempt at a job: formulate the problem, guess, run the solver."""

from __future__ import annotations

import time
from dataclasses import replace

from mbocp.formulation import Formulation
from mbocp.formulation.formulate import formulate_with_independent_ends
from mbocp.guesses.end_rates import with_rates_at_end
from mbocp.guesses.in_turn import solve_from_guesses
from mbocp.job import Job
from mbocp.programme.iterate import Carried
from mbocp.solution.read_solution import Attempt
from mbocp.solution.records import StartRecord
from mbocp.solvers import Outcome, Phase
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

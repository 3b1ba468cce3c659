"""Solving from one guess after the other, until one of them leads to a solution.

Which entries of the velocity are conditions of the end follows from the constraints at `goal.q`. Where the
goal does not give every joint, that is a guess, and feet that land, say, stand elsewhere in the end. Where
the chosen entries leave velocities that the constraints allow there, the problem is solved again from where
it is, with conditions on just these: they are numbers of a parameter, and compile nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from itertools import chain

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import CompilationTimeout, ProblemError
from mbocp.formulation import Formulation, formulate
from mbocp.formulation.end_reached import miss_of_rates
from mbocp.formulation.formulate import formulate_with_independent_ends
from mbocp.guesses.eased import GIVEN_SOLUTIONS, try_easing
from mbocp.guesses.make import explain_none_made
from mbocp.guesses.screening import is_preferred, status_of, with_end
from mbocp.guesses.starts import guesses_in_turn, last_guesses
from mbocp.job import Job, settings_of
from mbocp.programme import Iterate
from mbocp.programme.iterate import IterateRecord
from mbocp.solution.details import StartRecord
from mbocp.solution.read_solution import Attempt
from mbocp.solvers import IterationRecord, Outcome, Phase, SolverSettings, Start, Status, run_strategy
from mbocp.solvers.newton_method.limit_multipliers import explain_limits_not_kept
from mbocp.solvers.newton_method.monolithic import can_be_polished
from mbocp.solvers.records import time_phase, time_until


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

        def solve_again(moved: Formulation, start: IterateRecord) -> Outcome:
            return solve_from_guesses(replace(job, start=start, brief=0), moved, phases)[0]

        formulation, outcome = with_rates_at_end(formulation, outcome, solve_again)
    return Attempt(formulation, outcome, tuple(phases), guess_used, left_out, begun, starts)


_ROUNDS = 6  # of solving again: each leaves a tenth or less, since the end moves with the conditions

Again = Callable[[Formulation, IterateRecord], Outcome]


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
        carried = IterateRecord.of(shown.result.iterate, moved.programme)
        none = np.zeros(moved.programme.ng)  # no multiplier of the end, whose rows are others
        after = again(moved, replace(carried, iterate=replace(carried.iterate, eta=none)))
        known, shown = moved, after.with_history((*shown.result.history, *after.result.history))
    return formulation, outcome.with_history(shown.result.history)


def _with_end_at(formulation: Formulation, q: Array) -> Formulation:
    """The same problem, its conditions of the end chosen at another configuration."""
    problem = formulation.problem
    return formulate(replace(problem, goal=replace(problem.goal, q=q, q_is_reached=True)))


def solve_from_guesses(job: Job, formulation: Formulation, phases: list[Phase]) -> tuple[Outcome, str]:
    """Run the solver from the guess; where the guess was left to mbocp, from the next one if that fails.

    Parameters
    ----------
    job : Job
        Where it is to be solved roughly, the first guess is the only one.
    formulation : Formulation
        Of its problem, or of that with one of several goals.
    phases : list of Phase
        Guesses and phases of the solver are added to it.

    Returns
    -------
    outcome : Outcome
        With the records from all guesses.
    words : str
        For the guess that led to it.
    """
    settings, tried = _settings(job, formulation), _GuessRecord()
    alone = replace(settings, is_newton_alone=not _goes_on_at_once(job, formulation, settings))
    begun: list[tuple[_Guess, Outcome]] = []
    for guess in _guesses(job, formulation, phases, tried):
        start = _start(job, formulation, guess, tried)
        limited = replace(alone, is_doubtful=tried.is_infeasible)
        is_own = guess.is_first and guess.kind not in GIVEN_SOLUTIONS and not job.is_only
        outcome = _descend(job, formulation, limited, start, may_ease=is_own)
        phases += outcome.phases
        if job.rough:
            return outcome, guess.words
        begun.append((guess, with_end(formulation, outcome)))
        if tried.ends_with(formulation, begun[-1][1], guess.words, job):
            return tried.end()
    for guess, before in begun if alone.is_newton_alone else ():
        if settings.is_spent(before.iterations) or before.result.status is Status.CONVERGED:
            continue
        start = replace(_start(job, formulation, guess, tried), before=before.result)
        outcome = _go_on(job, settings, start, before, is_doubtful=tried.is_infeasible)
        phases += outcome.phases
        if tried.ends_with(formulation, with_end(formulation, outcome), guess.words, job, before):
            break
    return tried.end()


def _go_on(
    job: Job, settings: SolverSettings, start: Start, before: Outcome, *, is_doubtful: bool
) -> Outcome:
    """Try what else may help from a guess, after what Newton's method alone has come to."""
    left = settings.within(before.iterations)
    limited = replace(left, is_doubtful=is_doubtful, time_limit=time_until(job.deadline))
    outcome = run_strategy(limited, start)
    return replace(outcome, solver=f"{before.solver} > {outcome.solver.removeprefix('auto: ')}")


def _goes_on_at_once(job: Job, formulation: Formulation, settings: SolverSettings) -> bool:
    """Whether a guess is not left before all that may help from there has been tried.

    Within limits and for free durations, Newton's method from another guess is quicker than IPOPT from the
    first, and helps more. In given ones it often ends in motions that the steps do not resolve.
    """
    is_alone = job.is_only or bool(job.rough) or job.start is not None
    is_auto = settings.options.method == "auto" and settings.has_inequalities
    if is_alone or not is_auto or not formulation.problem.timeline.has_free_lengths:
        return True
    return explain_limits_not_kept(formulation.programme) is not None


@dataclass(frozen=True, eq=False)
class _Guess:
    kind: str
    words: str
    iterate: Iterate
    is_first: bool


def _guesses(
    job: Job, formulation: Formulation, phases: list[Phase], tried: _GuessRecord
) -> Iterator[_Guess]:
    """The guesses that can be made, one after the other."""
    in_turn = guesses_in_turn(formulation, job.start)
    last = (guess for guess in last_guesses(formulation, job.start) if tried.best is None)
    for number, (kind, make) in enumerate(chain(in_turn, last)):
        try:
            with time_phase(phases, "guess"):
                iterate, words = make(job.deadline)
        except ProblemError as error:
            tried.failed[kind] = error  # no reason to give up on the others
            continue
        except (CompilationTimeout, KeyboardInterrupt) as end:
            tried.stop(end)
            return
        yield _Guess(kind, words, iterate, number == 0)


def _start(job: Job, formulation: Formulation, guess: _Guess, tried: _GuessRecord) -> Start:
    label = "" if guess.is_first else f" (guess: {guess.kind})"
    return Start(formulation.programme, guess.iterate, job.callback, tried.iterations, label, job.patience)


def _settings(job: Job, formulation: Formulation) -> SolverSettings:
    settings = settings_of(formulation)
    if job.brief and settings.options.method == "auto" and can_be_polished(formulation.programme):
        asked = settings.options.max_iterations
        most = job.brief if asked is None else min(job.brief, asked)
        brief = replace(settings.options, method="monolithic", max_iterations=most)
        settings = replace(settings, options=brief)
    return replace(settings, rough=job.rough)


def _descend(
    job: Job, formulation: Formulation, settings: SolverSettings, start: Start, *, may_ease: bool
) -> Outcome:
    """Run the solver from a guess; then, where effort alone costs, look for a cheaper motion."""
    outcome = run_strategy(replace(settings, time_limit=time_until(job.deadline)), start)
    has_failed = outcome.result.status is not Status.CONVERGED
    if job.rough or not may_ease or (has_failed and job.patience.is_over):
        return outcome
    further = start if has_failed else replace(start, patience=None)  # what is solved may take its time
    return try_easing(formulation, replace(settings, time_limit=time_until(job.deadline)), further, outcome)


@dataclass(eq=False)
class _GuessRecord:
    """What the guesses so far have led to.

    Attributes
    ----------
    best : tuple of (Outcome, str), optional
        The best outcome, and words for its guess.
    history : list of IterationRecord
    failed : dict
        Why guesses of these kinds could not be made.
    """

    best: tuple[Outcome, str] | None = None
    history: list[IterationRecord] = field(default_factory=list)
    failed: dict[str, ProblemError] = field(default_factory=dict)

    @property
    def iterations(self) -> int:
        return sum(not record.is_guess for record in self.history)

    @property
    def is_infeasible(self) -> bool:
        """Whether a solver says that nothing solves the problem."""
        return self.best is not None and self.best[0].result.status is Status.INFEASIBLE

    def ends_with(
        self, formulation: Formulation, outcome: Outcome, words: str, job: Job, before: Outcome | None = None
    ) -> bool:
        """Take account of one more outcome, which takes the place of that before; whether it is the last.

        After others have failed, what the steps do not resolve is kept, and a motion that they do is looked
        for as long as patience lasts.
        """
        result, is_first = outcome.result, self.best is None
        self.history += result.history
        is_solved = result.status is Status.CONVERGED
        if (
            self.best is None
            or self.best[0] is before
            or is_preferred(formulation, outcome, (formulation, self.best[0]))
        ):
            self.best = (outcome, words)
        elif result.status is Status.INTERRUPTED:
            self._interrupt()
        if is_solved and not is_first:
            is_solved = status_of(formulation, outcome) is Status.CONVERGED
        return job.is_only or job.patience.is_over or is_solved or result.status.is_stopped

    def stop(self, error: CompilationTimeout | KeyboardInterrupt) -> None:
        """End without a further guess; raise the error if there is nothing to return yet."""
        if self.best is None:
            raise error
        if isinstance(error, KeyboardInterrupt):
            self._interrupt()

    def end(self) -> tuple[Outcome, str]:
        """Return the best outcome with the records from all guesses, and words for its guess.

        Raises
        ------
        ProblemError
            If no guess could be made.
        """
        if self.best is None:
            raise explain_none_made(self.failed)
        outcome, words = self.best
        words += "".join(f"; {kind!r} could not be made" for kind in self.failed)
        return outcome.with_history(self.history), words

    def _interrupt(self) -> None:
        if self.best is not None:
            self.best = (self.best[0].with_interrupt(), self.best[1])

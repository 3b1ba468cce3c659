"""Solving from several guesses, and to several goals, side by side, and the best of what they lead to.

This process takes one start after the other; where they take their time, other processes help it. Where it
is to have threads, these help instead. Each start is solved as if it were the only one, so that the result
does not depend on who solves it.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import field, replace
from functools import partial

from mbocp._arrays import dataclass
from mbocp._environment import available_threads
from mbocp._threads import SideBySide, Watch
from mbocp.formulation import Formulation
from mbocp.guesses.eased import GIVEN_SOLUTIONS, try_easing
from mbocp.guesses.screening import is_preferred, status_of, with_end
from mbocp.guesses.starts import StartGuess, further_kinds, start_guesses
from mbocp.job import Job, settings_of
from mbocp.solution.details import StartRecord
from mbocp.solvers import Outcome, Phase, SolverSettings, Start, Status, run_strategy
from mbocp.solvers.records import Callback, time_phase, time_until
from mbocp.solvers.strategies.elsewhere import Elsewhere, ElsewhereError
from mbocp.solvers.strategies.strategy import run_elsewhere

_PATIENCE = 1.0  # [s] after which a process that helps is worth its beginning


def solve_from_starts(
    job: Job, goals: Sequence[tuple[int | None, Formulation]], phases: list[Phase], workers: int | None = None
) -> tuple[Formulation, Outcome, str, tuple[StartRecord, ...]]:
    """Run the solver from `solver.starts` guesses to each goal; the best outcome, its guess, all in short.

    Where none of those to a goal converges, the kinds of guess that are left for it are tried in turn.

    Parameters
    ----------
    job : Job
    goals : sequence of (int or None, Formulation)
        Place of a goal among several, and the problem with it; None where there is one goal.
    phases : list of Phase
        Guesses and phases of the best outcome are added to it.
    workers : int, optional
        Processes that share the work; None: as many as there are processors for.
    """
    with time_phase(phases, "guess"):
        tasks = [
            _Task(formulation, guess, place)
            for place, formulation in goals
            for guess in start_guesses(formulation, job.start, job.deadline)
        ]
    clock, threads = time.perf_counter(), job.problem.solver.num_threads
    tasks = [replace(task, threads=max(1, threads // len(tasks))) for task in tasks]
    batch = _Batch(tasks, job.callback, job.deadline)
    batch.run(threads, available_threads() if workers is None else workers)
    batch.ease(threads)
    tried = [(tasks[i], with_end(tasks[i].formulation, batch.outcomes[i])) for i in sorted(batch.outcomes)]
    for place, formulation in goals:
        _try_further_kinds(batch, tried, place, formulation)
    best, outcome = _best(tried)
    outcome = outcome.with_interrupt() if batch.is_interrupted else outcome
    seconds = time.perf_counter() - clock - sum(phase.wall_time_s for phase in outcome.phases)
    phases += (*outcome.phases, Phase("other starts", 0, max(0.0, seconds)))
    return best.formulation, outcome, best.words, tuple(_record(*one) for one in tried)


def _try_further_kinds(
    batch: _Batch, tried: list[tuple[_Task, Outcome]], goal: int | None, formulation: Formulation
) -> None:
    """Add what the kinds of guess that are left for a goal lead to, until one converges."""
    mine = [(task, end) for task, end in tried if task.goal == goal]
    if any(end.result.status is Status.CONVERGED for _, end in mine):
        return
    for guess in further_kinds(formulation, [task.guess for task, _ in mine]):
        if batch.is_over:
            return
        task = _Task(formulation, guess, goal)
        end = with_end(formulation, batch.solve(task, len(tried), batch.callback))
        tried.append((task, end))
        if end.result.status is Status.CONVERGED:
            return


@dataclass(frozen=True, eq=False)
class _Task:
    """One guess for one goal, and how many threads may share its stages."""

    formulation: Formulation
    guess: StartGuess
    goal: int | None
    threads: int = 1

    @property
    def words(self) -> str:
        """Words for the guess, with the goal where there are several."""
        return self.guess.words if self.goal is None else f"to goal.any.{self.goal}, {self.guess.words}"

    def settings(self, deadline: float) -> SolverSettings:
        """Settings of the solver, with the time that is left."""
        return replace(settings_of(self.formulation, self.threads), time_limit=time_until(deadline))


@dataclass(eq=False)
class _Batch:
    """Starts that are solved side by side."""

    tasks: Sequence[_Task]
    callback: Callback | None
    deadline: float
    outcomes: dict[int, Outcome] = field(default_factory=dict)
    is_interrupted: bool = False

    @property
    def is_over(self) -> bool:
        """Whether no further start is to begin."""
        return self.is_interrupted or time.perf_counter() > self.deadline

    def run(self, threads: int, workers: int) -> None:
        """Solve from all guesses, with so many threads, or else processes; when interrupted, from some."""
        processes = [Elsewhere() for _ in range(min(workers, len(self.tasks)) - 1)] if threads == 1 else []
        free = [*processes]

        def work(number: int, watch: Watch) -> Outcome:
            task = self.tasks[number]
            if watch.is_live or not processes:
                return self.solve(task, number, watch)
            process = free.pop()
            try:
                return self._solve_elsewhere(process, task, number, watch)
            except ElsewhereError:
                return self.solve(task, number, watch)
            finally:
                free.append(process)

        try:
            count = 1 + len(processes) if processes else threads
            self._side_by_side(work, range(len(self.tasks)), count, _PATIENCE if processes else 0.0)
        finally:
            for process in processes:
                process.close()

    def solve(self, task: _Task, number: int, callback: Callback | None) -> Outcome:
        """Outcome of one start, in this process."""
        start = Start(task.formulation.programme, task.guess.iterate, callback, label=_label(number))
        outcome = run_strategy(task.settings(self.deadline), start)
        self.is_interrupted |= _is_interrupted(outcome)
        return outcome

    def _solve_elsewhere(self, process: Elsewhere, task: _Task, number: int, watch: Watch) -> Outcome:
        """Outcome of one start, in a process that ends with its piece of work."""
        watch.at_end = process.close
        if watch.is_ended:
            raise KeyboardInterrupt
        start = Start(task.formulation.programme, task.guess.iterate, label=_label(number))
        outcome = process.run(partial(run_elsewhere, task.settings(self.deadline), start))
        assert isinstance(outcome, Outcome)
        for record in outcome.result.history:
            watch(record)
        return outcome

    def ease(self, threads: int) -> None:
        """Give each start its further descents; the first to a goal those that it has where it is alone."""
        numbers, seen = sorted(self.outcomes), Counter[int | None]()
        among = {}
        for number in numbers:
            goal = self.tasks[number].goal
            among[number] = seen[goal]
            seen[goal] += 1
        left = [number for number in numbers if self.tasks[number].guess.kind not in GIVEN_SOLUTIONS]

        def work(place: int, watch: Watch) -> Outcome:
            number = left[place]
            if self.is_over:
                return self.outcomes[number]
            task = self.tasks[number]
            start = Start(task.formulation.programme, task.guess.iterate, watch, label=_label(number))
            settings, plain = task.settings(self.deadline), self.outcomes[number]
            return try_easing(task.formulation, settings, start, plain, number=among[number])

        if not self.is_over:
            self._side_by_side(work, left, threads)

    def _side_by_side(
        self,
        work: Callable[[int, Watch], Outcome],
        numbers: Sequence[int],
        threads: int,
        patience: float = 0.0,
    ) -> None:
        """Outcomes of work(0), work(1), ... as those of the starts of these numbers."""
        row = SideBySide(work, len(numbers), self.callback, is_interrupted=_is_interrupted)
        try:
            row.run(threads, patience)
        except KeyboardInterrupt:
            if not (row.results or self.outcomes):
                raise
            self.is_interrupted = True
        self.outcomes |= {numbers[place]: outcome for place, outcome in row.results.items()}
        self.is_interrupted |= any(_is_interrupted(outcome) for outcome in row.results.values())


def _is_interrupted(outcome: Outcome) -> bool:
    return outcome.result.status is Status.INTERRUPTED


def _label(number: int) -> str:
    return f" (start {number + 1})" if number else ""


def _best(tried: Sequence[tuple[_Task, Outcome]]) -> tuple[_Task, Outcome]:
    """The cheapest that converged, motions that the steps resolve first."""
    best, outcome = tried[0]
    for task, end in tried[1:]:
        if is_preferred(task.formulation, end, (best.formulation, outcome)):
            best, outcome = task, end
    return best, outcome


def _record(task: _Task, end: Outcome) -> StartRecord:
    status = status_of(task.formulation, end)
    return StartRecord(task.words, status, end.result.record.cost, end.iterations, task.goal)

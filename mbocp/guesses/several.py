"""Solving from several guesses, and to several goals, side by side, and the best of what they lead to.

This process takes one start after the other; where they take their time, other processes help it. Where it
is to have threads, these help instead. Each start is solved as if it were the only one, so that the result
does not depend on who solves it.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
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
    if threads > 1:
        batch.run_in_threads(threads)
    else:
        batch.run((available_threads() if workers is None else workers) - 1)
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
    _brought: dict[int, Outcome] = field(default_factory=dict)
    _waiting: deque[int] = field(default_factory=deque)
    _all_taken: threading.Event = field(default_factory=threading.Event)

    @property
    def is_over(self) -> bool:
        """Whether no further start is to begin."""
        return self.is_interrupted or time.perf_counter() > self.deadline

    def run(self, helpers: int) -> None:
        """Solve from all guesses; from as many as there was time for, when interrupted."""
        self._waiting = deque(range(len(self.tasks)))
        processes = [Elsewhere() for _ in range(min(helpers, len(self.tasks) - 1))]
        threads = [threading.Thread(target=self._help, args=(p,), daemon=True) for p in processes]
        try:
            for thread in threads:
                thread.start()
            self._take()
            self._all_taken.set()
            for thread in threads:
                thread.join()
            self._take()  # what a process could not do
            self._show()
        except KeyboardInterrupt:
            if not self.outcomes:
                raise
            self.is_interrupted = True
        finally:
            self._all_taken.set()
            self.outcomes |= self._brought
            for process in processes:
                process.close()

    def run_in_threads(self, threads: int) -> None:
        """The same with threads of this process."""

        def work(number: int, watch: Watch) -> Outcome:
            return self.solve(self.tasks[number], number, watch)

        self._side_by_side(work, range(len(self.tasks)), threads)

    def solve(self, task: _Task, number: int, callback: Callback | None) -> Outcome:
        """Outcome of one start, in this process."""
        start = Start(task.formulation.programme, task.guess.iterate, callback, label=_label(number))
        outcome = run_strategy(task.settings(self.deadline), start)
        self.is_interrupted |= _is_interrupted(outcome)
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
        self, work: Callable[[int, Watch], Outcome], numbers: Sequence[int], threads: int
    ) -> None:
        """Outcomes of work(0), work(1), ... as those of the starts of these numbers."""
        row = SideBySide(work, len(numbers), self.callback, is_interrupted=_is_interrupted)
        try:
            row.run(threads)
        except KeyboardInterrupt:
            if not (row.results or self.outcomes):
                raise
            self.is_interrupted = True
        self.outcomes |= {numbers[place]: outcome for place, outcome in row.results.items()}
        self.is_interrupted |= any(_is_interrupted(outcome) for outcome in row.results.values())

    def _next(self) -> int | None:
        try:
            return self._waiting.popleft()
        except IndexError:
            return None

    def _take(self) -> None:
        while not self.is_interrupted and (number := self._next()) is not None:
            self.outcomes[number] = self.solve(self.tasks[number], number, self.callback)

    def _show(self) -> None:
        """Show the records of other processes, as if they came now."""
        if self.callback is not None:
            for number in sorted(self._brought):
                for record in self._brought[number].result.history:
                    self.callback(record)

    def _help(self, process: Elsewhere) -> None:
        """What a thread does: it has a process solve what is left, if that takes its time."""
        if self._all_taken.wait(_PATIENCE):
            return
        while (number := self._next()) is not None:
            task = self.tasks[number]
            settings, programme = task.settings(self.deadline), task.formulation.programme
            start = Start(programme, task.guess.iterate, label=_label(number))
            try:
                found = process.run(partial(run_elsewhere, settings, start))
            except ElsewhereError:
                self._waiting.append(number)
                return
            if isinstance(found, Outcome):
                self._brought[number] = found


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

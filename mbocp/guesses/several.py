"""Solving from several guesses, and to several goals, side by side, and the best of what they lead to.

This process takes one start after the other; where they take their time, other processes help it. Where it
is to have threads, these help instead. Each start is solved as if it were the only one, so that the result
does not depend on who solves it.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

from mbocp._environment import available_threads
from mbocp._threads import SideBySide, Watch
from mbocp.formulation import Formulation
from mbocp.guesses.attempts import interrupted
from mbocp.guesses.eased import GIVEN_SOLUTIONS, better_of_eased
from mbocp.guesses.ranking import is_preferred, status_of, with_end
from mbocp.guesses.starts import StartGuess, Warm, further_kinds, start_guesses
from mbocp.solution.records import StartRecord
from mbocp.solvers import IterationRecord, Outcome, Phase, SolverSettings, Start, Status, run_strategy
from mbocp.solvers.records import timed
from mbocp.solvers.strategies.elsewhere import Elsewhere, ElsewhereError
from mbocp.solvers.strategies.strategy import Strategy

_PATIENCE = 1.0  # [s] after which a process that helps is worth its beginning

_Callback: TypeAlias = Callable[[IterationRecord], object]


def solve_from_starts(
    members: Sequence[tuple[int | None, Formulation]],
    warm_start: Warm,
    callback: _Callback | None,
    phases: list[Phase],
    deadline: float,
    workers: int | None = None,
) -> tuple[Formulation, Outcome, str, tuple[StartRecord, ...]]:
    """Run the solver from `solver.starts` guesses to each goal; the best outcome, its guess, all in short.

    Where none of those to a goal converges, the kinds of guess that are left for it are tried in turn.

    Parameters
    ----------
    members : sequence of (int or None, Formulation)
        Place of a goal among several, and the problem with it; None where there is one goal.
    """
    with timed(phases, "guess"):
        tasks = [
            _Task(formulation, guess, place)
            for place, formulation in members
            for guess in start_guesses(formulation, warm_start, deadline)
        ]
    clock = time.perf_counter()
    threads = members[0][1].problem.solver.num_threads
    tasks = [replace(task, threads=max(1, threads // len(tasks))) for task in tasks]
    batch = _Batch(tasks, callback, deadline)
    if threads > 1:
        batch.run_in_threads(threads)
    else:
        batch.run(_helpers() if workers is None else workers - 1)
    batch.ease(threads)
    tried = [tasks[i] for i in sorted(batch.outcomes)]
    ends = [
        with_end(task.formulation, batch.outcomes[i]) for i, task in enumerate(tasks) if i in batch.outcomes
    ]
    for place, formulation in members:
        mine = [(task, end) for task, end in zip(tried, ends, strict=True) if task.goal == place]
        if any(end.result.status is Status.CONVERGED for _, end in mine):
            continue
        for guess in further_kinds(formulation, [task.guess for task, _ in mine]):
            if batch.is_over:
                break
            task = _Task(formulation, guess, place)
            end = with_end(formulation, batch.solve(task, len(tried), callback))
            tried, ends = [*tried, task], [*ends, end]
            if end.result.status is Status.CONVERGED:
                break
    best = _best(tried, ends)
    outcome = interrupted(ends[best]) if batch.is_interrupted else ends[best]
    seconds = time.perf_counter() - clock - sum(phase.wall_time_s for phase in outcome.phases)
    phases += (*outcome.phases, Phase("other starts", 0, max(0.0, seconds)))
    records = tuple(_record(task, end) for task, end in zip(tried, ends, strict=True))
    return tried[best].formulation, outcome, tried[best].words, records


def _helpers() -> int:
    """Processes that may help: none where this one is a worker among others."""
    return available_threads() - 1


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
        problem = self.formulation.problem
        settings = SolverSettings.of(
            problem.solver,
            self.formulation.programme,
            has_inequalities=problem.is_bounded,
            threads=self.threads,
        )
        left = None if math.isinf(deadline) else max(0.0, deadline - time.perf_counter())
        return replace(settings, time_limit=left)


@dataclass(eq=False)
class _Batch:
    """Starts that are solved side by side."""

    tasks: Sequence[_Task]
    callback: _Callback | None
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

    def solve(self, task: _Task, number: int, callback: _Callback | None) -> Outcome:
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
            return better_of_eased(task.formulation, settings, start, plain, number=among[number])

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
            try:
                found = process.run(Strategy(settings, programme, task.guess.iterate, _label(number)))
            except ElsewhereError:
                self._waiting.append(number)
                return
            if isinstance(found, Outcome):
                self._brought[number] = found


def _is_interrupted(outcome: Outcome) -> bool:
    return outcome.result.status is Status.INTERRUPTED


def _label(number: int) -> str:
    return f" (start {number + 1})" if number else ""


def _best(tasks: Sequence[_Task], ends: Sequence[Outcome]) -> int:
    """Which outcome is the best: the cheapest that converged, motions that the steps resolve first."""
    best = 0
    for i, end in enumerate(ends[1:], start=1):
        known = tasks[best].formulation, ends[best]
        best = i if is_preferred(tasks[i].formulation, end, known) else best
    return best


def _record(task: _Task, end: Outcome) -> StartRecord:
    status = status_of(task.formulation, end)
    return StartRecord(task.words, status, end.result.record.cost, end.iterations, task.goal)

"""`run_study`: tasks out, rows in, until all are done."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import mbocp
from mbocp._text import warn_caller
from mbocp.exceptions import MbocpError, StudyError
from mbocp.study.pools import ExecutorPool, LocalPool, Pool, check_picklable
from mbocp.study.result import StudyResult
from mbocp.study.run_task import CRASHED, Solve, failure_row, make_problem, rehearse, run_task
from mbocp.study.study import Study, Task
from mbocp.study.summary import word
from mbocp.study.table import FORMAT, FORMAT_VERSION, RowFile
from mbocp.study.task_kinds import first_of_each_kind

_PERIOD = 0.25  # [s] between two looks at the clock of the file
_NUM_PROBES = 10  # tasks to try before a study is refused
_MAX_TRIES = 3  # of a task whose pool broke away under it

Progress = Callable[[int, int], object]


class StudyWarning(UserWarning):
    """Something about a study that is allowed, but probably not meant."""


def run_study(
    study: Study | str | Path,
    output: str | Path,
    *,
    executor: Executor | None = None,
    workers: int | None = None,
    resume: bool = False,
    overwrite: bool = False,
    callback: Callable[[Mapping[str, Any]], object] | None = None,
    progress: Progress | None = None,
    solve: Solve | None = None,
) -> StudyResult:
    """Solve all tasks of a study, writing a row into one file as each ends.

    A task that raises, takes too long, or takes its process with it is a row, too. Ctrl-C (or an error)
    leaves a file that `resume` goes on with.

    Parameters
    ----------
    study : Study, str or Path
        The study, or the path of its file.
    output : str or Path
        The file, JSON lines.
    executor : concurrent.futures.Executor, optional
        Where the tasks run, for instance ``distributed.Client.get_executor()``. Default: processes of this
        machine, which survive crashes and are killed when a task's time is over; under an executor only the
        solver looks at the clock.
    workers : int, optional
        Number of processes. Default: as many as there are processors. With an `executor`, how many it has:
        twice as many tasks are under way.
    resume : bool
        Go on with the file, if there is one.
    overwrite : bool
        Begin anew, even if there is a file.
    callback : callable, optional
        Called with every new row.
    progress : callable, optional
        Called with the number of rows so far and of all tasks: at the beginning, and after every row.
    solve : callable, optional
        Takes a `Problem`, gives a `Solution`, in place of `mbocp.solve`; a function of a module.

    Returns
    -------
    StudyResult

    Raises
    ------
    StudyError
        If the study cannot be run: its file belongs to another one, or the executor gave up.
    ResultFileError
        If the file exists, is damaged, is being written by another process, or cannot be written.
    MbocpError
        If no task at all can be made, the first one's error.
    """
    study = study if isinstance(study, Study) else Study.load(study)
    _check_call(executor, workers, solve, begins_twice=resume and overwrite)
    kinds = first_of_each_kind(study)
    _check_kinds(study, kinds)
    with ExitStack() as opened:
        file = RowFile(Path(output), _header(study), resume=resume, overwrite=overwrite)
        opened.callback(file.close)
        _check_version(file)
        done = {int(row["index"]) for row in file.rows}
        if progress is not None:
            progress(len(done), len(study))
        if len(done) < len(study):
            pool: Pool = ExecutorPool(executor, workers) if executor is not None else LocalPool(workers)
            opened.callback(pool.close)
            run = _Run(study, pool, file, solve, callback, progress, len(done))
            run.rehearse(kinds)
            run.run(index for index in range(len(study)) if index not in done)
    return StudyResult.load(output)


def _check_call(
    executor: Executor | None, workers: int | None, solve: Solve | None, *, begins_twice: bool
) -> None:
    if begins_twice:
        raise StudyError("resume and overwrite: give one of the two")
    if workers is not None and workers < 1:
        raise StudyError(f"workers: got {workers}, expected a whole number above 0")
    if solve is not None and executor is None:
        check_picklable(solve)


def _check_kinds(study: Study, kinds: Sequence[Task]) -> None:
    """Make the first problem of each kind; if none can be made, the study is wrong and not its tasks."""
    failed = [(task, error) for task in kinds if (error := _explain_unmade(study, task)) is not None]
    if len(failed) == len(kinds):
        some = (study.task(index) for index in range(0, len(study), max(len(study) // _NUM_PROBES, 1)))
        if all(_explain_unmade(study, task) for task in some):
            raise failed[0][1]
    for task, error in failed:
        values = ", ".join(f"{name} = {word(value)}" for name, value in task.values.items())
        warn_caller(f"task {task.index} ({values}) cannot be made: {error}", StudyWarning)


def _explain_unmade(study: Study, task: Task) -> MbocpError | None:
    try:
        make_problem(study.job, task.overrides)
    except MbocpError as error:
        return error
    return None


def _check_version(file: RowFile) -> None:
    begun = file.header.get("mbocp")
    if begun != mbocp.__version__:
        warn_caller(
            f"{file.path}: was begun by mbocp {begun}, this is {mbocp.__version__}; rows may not compare",
            StudyWarning,
        )


def _error(future: Future[Any]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _header(study: Study) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "mbocp": mbocp.__version__,
        "name": study.name,
        "digest": study.digest,
        "tasks": len(study),
        "varied": list(study.names),
        "by": list(study.groups),
        "goal_distance": study.goal_distance,
        "record": list(study.job.record),
        "tables": dict(study.tables),
    }


@dataclass(eq=False)
class _Run:
    """The tasks under way and the rows that come back."""

    study: Study
    pool: Pool
    file: RowFile
    solve: Solve | None
    callback: Callable[[Mapping[str, Any]], object] | None
    progress: Progress | None
    done: int
    tries: dict[int, int] = field(default_factory=dict)

    def rehearse(self, kinds: Sequence[Task]) -> None:
        """Compile what each kind of task needs, outside the tasks' time."""
        again = list(kinds)
        for _ in range(_MAX_TRIES):
            futures = {self.pool.submit(rehearse, self.study.job, task.overrides): task for task in again}
            again = []
            for future, task in futures.items():
                error = _error(future)
                if error is None:
                    continue
                row = self.pool.failure(error, None)
                if row is None:
                    again.append(task)
                elif not isinstance(self.pool, LocalPool):
                    raise StudyError(f"the executor cannot run tasks: {row['message']}")
            if not again:
                return
        raise StudyError("the processes for the tasks die as soon as they begin; see what they printed")

    def run(self, indices: Iterator[int]) -> None:
        """Keep the pool busy until all tasks have a row."""
        pending: dict[Future[Any], int] = {}
        again: list[int] = []  # run last and alone, where nobody else can be to blame
        while True:
            while len(pending) < self.pool.in_flight:
                index = next(indices, None)
                if index is None and again and not pending:
                    index = again.pop()
                if index is None:
                    break
                pending[self._submit(index)] = index
            if not pending:
                return
            for future in wait(pending, timeout=_PERIOD, return_when=FIRST_COMPLETED).done:
                index = pending.pop(future)
                row = self._outcome(future, index)
                if row is None:
                    again.append(index)
                else:
                    self._take(index, row)
            self.file.tick()

    def _submit(self, index: int) -> Future[Any]:
        job, overrides = self.study.job, self.study.task(index).overrides
        return self.pool.submit(run_task, job, overrides, self.solve, limit=job.time_limit)

    def _outcome(self, future: Future[Any], index: int) -> dict[str, Any] | None:
        """Row, or None for a task that has to run again."""
        error = _error(future)
        if error is None:
            return future.result()
        failed = self.pool.failure(error, self.study.job.time_limit)
        tries = self.tries[index] = self.tries.get(index, 0) + 1
        if failed is not None:
            return None if self.pool.dies_together and tries == 1 else failed
        if tries < _MAX_TRIES:
            return None
        return failure_row(CRASHED, f"the pool of processes broke {_MAX_TRIES} times while it ran")

    def _take(self, index: int, row: Mapping[str, Any]) -> None:
        whole = {"index": index, "values": dict(self.study.task(index).values), **row}
        self.file.append(whole)
        self.done += 1
        if self.callback is not None:
            self.callback(whole)
        if self.progress is not None:
            self.progress(self.done, len(self.study))

"""Where tasks run: processes of this machine, or any executor of `concurrent.futures`, as Dask has."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import contextmanager
from multiprocessing import connection, forkserver, process
from typing import Any, TypeAlias

from pebble import CONSTS, ProcessExpired, ProcessPool

from mbocp._environment import available_workers
from mbocp._processes import SAFE_PATH, signal_handler
from mbocp.exceptions import StudyError
from mbocp.study.run_task import CRASHED, TIMEOUT, failure_row

Row = dict[str, Any]

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS")
# A solver looks at the clock between its iterations, and ends the task itself with its best iterate; what
# goes on much longer hangs in one of them, and is killed.
_GRACE, _GRACE_SHARE = 2.0, 0.2  # [s], and of the time limit
_LOCKED_OUT = 10.0  # [s] longer than stopping another process takes, which locks them out rightly


class LocalPool:
    """Processes of this machine, one thread each, which may crash or be killed one by one.

    They come from a server process that has imported everything: a new one is there at once.
    """

    dies_together = False  # whether a process takes tasks with it that did nothing

    def __init__(self, workers: int | None = None) -> None:
        self.workers = workers if workers is not None else available_workers()
        self._pool = self._new()

    @property
    def in_flight(self) -> int:
        """One that runs and one that waits for each process."""
        return 2 * self.workers

    def submit(self, function: Callable[..., Any], *args: Any, limit: float | None = None) -> Future[Any]:
        """Run a function of a module; `limit` [s] and a grace later its process is killed."""
        timeout = None if limit is None else limit + _GRACE + _GRACE_SHARE * limit
        try:
            return self._pool.schedule(function, args=args, timeout=timeout)
        except RuntimeError:  # broken: a process was killed in the very moment in which it took a task
            self.close()
            self._pool = self._new()
            return self._pool.schedule(function, args=args, timeout=timeout)

    def failure(self, error: BaseException, limit: float | None) -> Row | None:
        """Row of a task that ended so; None where its pool broke away under it, and it has to run again."""
        if isinstance(error, ProcessExpired):
            return failure_row(CRASHED, f"its process died: {_death(error.exitcode)}")
        if isinstance(error, (FutureTimeoutError, TimeoutError)):
            return failure_row(TIMEOUT, f"killed after time_limit = {limit:g} s, it did not stop by itself")
        if isinstance(error, (BrokenExecutor, CancelledError)):
            return None
        return failure_row(CRASHED, f"cannot be run: {type(error).__name__}: {error}")

    def close(self) -> None:
        """Kill what runs."""
        self._pool.stop()  # type: ignore[no-untyped-call]
        self._pool.join()

    def _new(self) -> ProcessPool:
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["mbocp.study.run_task"])
        environment = {**os.environ, **dict.fromkeys(_THREADS, "1")}
        with _environment({**environment, **SAFE_PATH}):
            forkserver.ensure_running()
        return ProcessPool(
            max_workers=self.workers, initializer=_begin_worker, initargs=(environment,), context=context
        )


class ExecutorPool:
    """An executor of somebody else: Dask's, MPI's, or Python's own."""

    dies_together = True  # all that waits at a worker, or has ended there and was not fetched

    def __init__(self, executor: Executor, workers: int | None = None) -> None:
        self.executor = executor
        known = getattr(executor, "_max_workers", None)
        self.workers = workers or (known if isinstance(known, int) else None) or available_workers()
        self._pending: set[Future[Any]] = set()

    @property
    def in_flight(self) -> int:
        """One that runs and one that waits for each worker."""
        return 2 * self.workers

    def submit(self, function: Callable[..., Any], *args: Any, limit: float | None = None) -> Future[Any]:
        """Run a function of a module; nobody but the solver looks at the `limit`."""
        try:
            # Dask takes equal calls for one task, and would answer a second try with the first one's end.
            future: Future[Any] = self.executor.submit(_call, uuid.uuid4().hex, function, *args)
        except (BrokenExecutor, RuntimeError) as error:
            raise _describe_giving_up(error) from error
        self._pending.add(future)
        future.add_done_callback(self._pending.discard)
        return future

    def failure(self, error: BaseException, limit: float | None) -> Row | None:
        """Tasks raise nothing, so what an executor raises is a worker that died, or its own end.

        Raises
        ------
        StudyError
            If nothing can be run any more.
        """
        if isinstance(error, (BrokenExecutor, CancelledError)):
            raise _describe_giving_up(error) from error
        return failure_row(CRASHED, f"its worker failed: {type(error).__name__}: {error}")

    def close(self) -> None:
        """Take back what has not begun; the executor itself is not ours to shut down."""
        for future in list(self._pending):
            future.cancel()


Pool: TypeAlias = LocalPool | ExecutorPool


def _call(word: str, function: Callable[..., Any], *args: Any) -> Any:
    del word  # makes this call another one than all before
    return function(*args)


def _describe_giving_up(error: BaseException) -> StudyError:
    reason = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return StudyError(
        f"the executor has given up ({reason}); rows so far are in the file: go on with --resume, resume=True"
    )


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    before = dict(os.environ)
    os.environ.update(values)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


def _begin_worker(environment: Mapping[str, str]) -> None:
    """Take over the parent's environment, which the server process may be older than, and its end."""
    os.environ.update(environment)
    # A process that is killed while it takes a task leaves the others locked out for so long.
    CONSTS.channel_lock_timeout = _LOCKED_OUT
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = process.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)


def _death(code: int | None) -> str:
    if code is not None and code < 0:
        try:
            return f"{signal.Signals(-code).name} (signal {-code})"
        except ValueError:
            return f"signal {-code}"
    return f"exit status {code}"


def check_picklable(function: Callable[..., Any]) -> None:
    """Refuse, before anything runs, a function that cannot be sent to another process.

    Raises
    ------
    StudyError
        If it is a lambda, or stands inside another function.
    """
    try:
        pickle.dumps(function)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise StudyError(
            f"solve: {function!r} cannot be sent to another process; write it at the top of a module"
        ) from error


_TIMEOUT = 10.0  # [s] for a scheduler to answer


@contextmanager
def dask_executor(address: str, workers: int | None = None) -> Iterator[tuple[Executor, int]]:
    """Give Dask's executor and its number of workers; "local" starts a cluster on this machine.

    Raises
    ------
    StudyError
        If `distributed` is not installed, or nobody answers at the address.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise StudyError("--scheduler needs Dask: pip install 'mbocp[dask]'") from error
    # A task that kills its worker is not given to three others.
    settings = {"distributed.scheduler.allowed-failures": 0}
    with dask.config.set(settings):
        if address == "local":
            count = workers or available_workers()
            # Ctrl-C reaches all processes of a terminal; those that are started now leave it to this one.
            with signal_handler(signal.SIGINT, signal.SIG_IGN):
                cluster = LocalCluster(n_workers=count, threads_per_worker=1, dashboard_address=None)
            with cluster, Client(cluster) as client:
                yield client.get_executor(), count
            return
        try:
            client = Client(address, timeout=_TIMEOUT)
        except (OSError, ValueError) as error:
            raise StudyError(f"--scheduler {address}: nobody answers there ({error})") from error
        with client:
            threads = sum(client.nthreads().values())
            if not threads:
                raise StudyError(f"--scheduler {address}: the scheduler has no workers yet; start some")
            yield client.get_executor(), workers or threads

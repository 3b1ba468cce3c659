"""A process that works for another one: a task goes there, an answer comes back, and words on the way.

The process knows solvers and no robot, and starts no script of the user again. It ends with its parent.
"""

from __future__ import annotations

import math
import os
import pickle
import queue
import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from enum import Enum
from typing import TYPE_CHECKING, Any

from mbocp._arrays import dataclass
from mbocp._processes import python_command

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

_START = "from mbocp.solvers.strategies.elsewhere import work\nwork(int(sys.argv[1]))\n"
_GRACE = 0.5  # [s] for a task that is to stop in the midst of an iteration


Tell = Callable[[object], None]  # returns once the parent has heard; `KeyboardInterrupt` stops the task
Task = Callable[[Tell], object]  # work for a process; it is pickled


@dataclass(frozen=True)
class Told:
    """What a task tells before its answer."""

    value: object


@dataclass(frozen=True)
class Answer:
    """What a task comes to."""

    value: object


@dataclass(frozen=True)
class Failure:
    """The exception of a task, in words."""

    words: str


class _End(Enum):
    GONE = "the process has ended"
    SILENT = "the process did not answer in its time"


class ElsewhereError(Exception):
    """The process could not do it; its parent can."""


class ProcessEnded(Exception):
    """The process was ended without an answer, by Ctrl-C or since its time was over."""

    def __init__(self, *, is_interrupted: bool) -> None:
        super().__init__()
        self.is_interrupted = is_interrupted


class Elsewhere:
    """One process; it begins with the first task.

    The output of foreign solvers goes nowhere. Ctrl-C does not reach it: its parent ends it.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._inbox: queue.Queue[object] = queue.Queue()

    @property
    def is_over(self) -> bool:
        """Whether it has been closed, or has died."""
        return self._process is not None and self._process.poll() is not None

    def run(
        self, task: Task, hear: Callable[[object], object] | None = None, until: float = math.inf
    ) -> object:
        """Return what a task comes to.

        Parameters
        ----------
        task : callable
            Gets a function that tells the parent something, and returns what it comes to.
        hear : callable, optional
            Gets what the task tells, which waits meanwhile. An exception of it, and Ctrl-C, stop the task;
            after Ctrl-C what it comes to is returned, any other exception is raised.
        until : float
            Time of `time.perf_counter` after which a task that says nothing is ended with its process.

        Raises
        ------
        ElsewhereError
            If the process cannot be started, or dies, or the task raises an exception.
        ProcessEnded
            If it was ended.
        """
        try:
            self._say(task)
            message, failure = self._wait_for_end(hear, until)
        except KeyboardInterrupt:  # between two messages: who is to speak next is not known any more
            self.close()
            raise ProcessEnded(is_interrupted=True) from None
        if isinstance(message, _End):
            self.close()
        if failure is not None and not isinstance(failure, KeyboardInterrupt):
            raise failure
        if isinstance(message, Answer):
            return message.value
        if message is _End.SILENT:
            raise ProcessEnded(is_interrupted=failure is not None)
        raise ElsewhereError(message.words if isinstance(message, Failure) else _End.GONE.value)

    def _wait_for_end(
        self, hear: Callable[[object], object] | None, until: float
    ) -> tuple[Answer | Failure | _End, BaseException | None]:
        """Pass on what the task tells; return how it ended, and what stopped it on this side."""
        failure: BaseException | None = None
        while True:
            message: object = None
            try:
                message = _next(self._inbox, until)
                if isinstance(message, Told) and hear is not None and failure is None:
                    hear(message.value)
            except BaseException as error:  # the task has to hear of it before others do
                if failure is not None:  # Ctrl-C again
                    return _End.SILENT, failure
                failure, until = error, -math.inf
            if isinstance(message, (Answer, Failure, _End)):
                return message, failure
            until = max(until, time.perf_counter() + _GRACE)
            if isinstance(message, Told):
                self._say(failure is None)

    def close(self) -> None:
        """End the process, whatever it does; it may be called from another thread."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def _say(self, value: object) -> None:
        """Send a value, to a process that is started for the first one."""
        try:
            if self._process is None:
                self._process, self._connection = _start()
                listen = threading.Thread(target=_listen, args=(self._connection, self._inbox), daemon=True)
                listen.start()
            self._connection.send(value)
        except (OSError, pickle.PickleError, AttributeError, TypeError, ValueError) as error:
            self.close()
            raise ElsewhereError(f"a process to solve in: {error}") from error


def _start() -> tuple[subprocess.Popen[bytes], Connection]:
    """Start a process, and open the way to it; its output goes nowhere."""
    from multiprocessing.connection import Pipe  # slow to import, and few solves want it

    ours, theirs = Pipe()
    with theirs:
        process = subprocess.Popen(
            python_command(_START, str(theirs.fileno())),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=[theirs.fileno()],
            start_new_session=True,
        )
    return process, ours


def _listen(connection: Connection, inbox: queue.Queue[object]) -> None:
    """Take in what comes, until the other side ends."""
    with connection, suppress(OSError, EOFError, ValueError, pickle.PickleError):
        while True:
            inbox.put(connection.recv())
    inbox.put(_End.GONE)


def _next(inbox: queue.Queue[object], until: float) -> object:
    """Wait for a message."""
    try:
        return inbox.get(timeout=min(max(0.0, until - time.perf_counter()), threading.TIMEOUT_MAX))
    except queue.Empty:
        return _End.SILENT


def work(handle: int) -> None:
    """Do what comes in until nothing does any more, or the parent ends: all that the process does."""
    from multiprocessing.connection import Connection

    connection, inbox = Connection(handle), queue.Queue[Any]()
    threading.Thread(target=_listen_to_parent, args=(connection, inbox), daemon=True).start()

    def tell(value: object) -> None:
        connection.send(Told(value))
        if not inbox.get():
            raise KeyboardInterrupt

    while True:
        task = inbox.get()
        try:
            answer: object = Answer(task(tell))
        except Exception as error:  # the parent does the task itself, and raises it
            answer = Failure(f"{type(error).__name__}: {error}")
        connection.send(answer)


def _listen_to_parent(connection: Connection, inbox: queue.Queue[Any]) -> None:
    try:
        while True:
            inbox.put(connection.recv())
    except Exception:  # it has ended, or closed
        os._exit(0)

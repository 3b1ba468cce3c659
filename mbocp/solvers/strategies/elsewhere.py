"""A process that solves for another one: a programme and an iterate go there, an outcome comes back.

The process knows solvers and no robot, and starts no script of the user again. It ends with its parent.
"""

from __future__ import annotations

import os
import pickle
import struct
import subprocess
from contextlib import suppress
from types import TracebackType
from typing import IO

from mbocp._processes import python_command
from mbocp.programme.iterate import Iterate
from mbocp.programme.stagewise import StagewiseProgramme
from mbocp.solvers.settings import SolverSettings
from mbocp.solvers.strategies.phases import Outcome

__all__ = ["Elsewhere", "ElsewhereError", "receive", "send"]

_START = "from mbocp.solvers.strategies.child import main\nmain()\n"
_LENGTH = struct.Struct("<Q")  # bytes that follow


class ElsewhereError(Exception):
    """The process could not do it; its parent can."""


class Elsewhere:
    """One process; it begins with the first task.

    The output of foreign solvers goes nowhere. Ctrl-C does not reach it: its parent closes it.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Elsewhere:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def run(
        self, settings: SolverSettings, programme: StagewiseProgramme, iterate: Iterate, label: str
    ) -> Outcome:
        """What `run_strategy` gives, without callbacks.

        Raises
        ------
        ElsewhereError
            If the process cannot be started, or dies, or the task raises an exception.
        """
        try:
            process = self._process = self._process or _started()
            if process.stdin is None or process.stdout is None:
                raise OSError("no pipes")
            send(process.stdin, (settings, programme, iterate, label))
            answer = receive(process.stdout)
        except (OSError, EOFError, pickle.PickleError, AttributeError, TypeError, ValueError) as error:
            self.close()
            raise ElsewhereError(f"a process to solve in: {error}") from error
        if isinstance(answer, Outcome):
            return answer
        raise ElsewhereError(str(answer))

    def close(self) -> None:
        """End the process, whatever it does; it may be called from another thread."""
        process = self._process
        if process is not None:
            process.kill()
            process.wait()
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    with suppress(OSError):
                        stream.close()


def _started() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        python_command(_START),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=dict(os.environ),
        start_new_session=True,
    )


def send(stream: IO[bytes], value: object) -> None:
    """Write a value."""
    content = pickle.dumps(value)
    stream.write(_LENGTH.pack(len(content)))
    stream.write(content)
    stream.flush()


def receive(stream: IO[bytes]) -> object:
    """Read what `send` wrote.

    Raises
    ------
    EOFError
        If the other side has closed.
    """
    size = stream.read(_LENGTH.size)
    if len(size) < _LENGTH.size:
        raise EOFError("the other side has closed")
    content = stream.read(_LENGTH.unpack(size)[0])
    value: object = pickle.loads(content)  # our own process wrote it
    return value

"""Functions of tapes are compiled beside the solves that call them, by a process of low priority.

The process writes C from the file of the tapes, and starts a compiler. It ends with the process that started
it, however that one ends, as compilers do: see `mbocp.programme.compiler`. A thread waits for it.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import os
import signal
import sys
from pathlib import Path
from threading import Lock, Thread

from mbocp._processes import python_command
from mbocp.programme.compiler import compiler, run_and_watch
from mbocp.programme.library import library_of, make_library
from mbocp.programme.tapes import functions_in

_PRIORITY = 19  # the lowest one
_PATIENCE = 0.5  # [s] for a process that is asked to end
_COMMAND = "from mbocp.programme.background import run\nrun(*sys.argv[1:])"
_TURN = Lock()  # one after another
_running: list[BackgroundCompiler] = []


class BackgroundCompiler:
    """A compiler that runs beside the solves of this process.

    Parameters
    ----------
    file : Path
        Of the tapes; the library is put beside it.
    key : str
        Of all that the library depends on.
    """

    def __init__(self, file: Path, key: str) -> None:
        self.failure = ""
        self._is_stopped = False
        self._command = python_command(_COMMAND, str(file), key)
        self._group: int | None = None
        self._thread = Thread(target=self._run, name="mbocp-compiler", daemon=True)
        _running.append(self)
        self._thread.start()

    @property
    def is_running(self) -> bool:
        """Whether it has not ended; a process that was forked off does not wait for it."""
        return self._thread.is_alive()

    def wait(self, seconds: float | None = None) -> None:
        """Wait for its end."""
        self._thread.join(seconds)

    def stop(self) -> None:
        """End it, and all that it has started; one that waits for its turn does not begin."""
        self._is_stopped = True
        for number in (signal.SIGTERM, signal.SIGKILL):
            group = self._group
            if group is not None and self.is_running:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(group, number)
                self.wait(_PATIENCE)

    def _run(self) -> None:
        code, said = 0, b""
        with _TURN:
            try:
                if not self._is_stopped:
                    code, said = run_and_watch(self._command, dict(os.environ), begun=self._begin)
            except (OSError, RuntimeError) as error:  # no process can be started
                code, said = 1, str(error).encode()
        if code != 0:
            self.failure = said.decode(errors="replace").strip().rpartition("\n")[2] or f"exit {code}"
        _running.remove(self)

    def _begin(self, group: int) -> None:
        self._group = group


@atexit.register
def _stop() -> None:
    """End what runs at the end of this process, which does not wait for it."""
    for beside in reversed(tuple(_running)):  # those that wait for their turn first
        beside.stop()


def run(file: str, key: str) -> None:
    """Compile functions of tapes, in a process of its own; if another one does so, wait for it.

    Parameters
    ----------
    file, key : str
        As `BackgroundCompiler` passes them.
    """
    os.nice(_PRIORITY)
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    with Path(file).open("rb") as held:
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(held, fcntl.LOCK_EX)
        cc = compiler()
        if library_of(key) is None and cc is not None:
            functions, folder = functions_in(Path(file)), Path(file).parent
            make_library(functions, cc, key, folder=folder)

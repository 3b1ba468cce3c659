"""Old files, which have no digest, are read by a process of their own, for libhdf5 may not survive it.

The process turns the file into one of today's format. It is given so much time and memory and no more; if it
crashes or never ends, the file is damaged.
"""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path
from typing import NamedTuple

from mbocp._processes import python_command
from mbocp.exceptions import ResultFileError

REFUSED = 3  # exit status of the process with a reason on stdout


class ReadLimits(NamedTuple):
    """What reading an old file may take.

    Attributes
    ----------
    cpu_seconds, memory : int
        Time of the processor [s] and address space [bytes].
    wall_seconds : float
        For a process that waits and does not work [s].
    """

    cpu_seconds: int = 10
    memory: int = 4 << 30
    wall_seconds: float = 120.0

    def for_size(self, size: int) -> ReadLimits:
        """The same with more for the bytes of a large file: a second for 10 MB, eight bytes for each."""
        more = size // 10_000_000
        return ReadLimits(self.cpu_seconds + more, self.memory + 8 * size, self.wall_seconds + 6 * more)


LIMITS = ReadLimits()

_START = "from mbocp.storage.child import main\nmain(*map(int, sys.argv[1:]))\n"
_ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def renew(path: str | Path, content: bytes) -> bytes:
    """Content of an old result file as that of a file of today's format.

    Raises
    ------
    ResultFileError
        If it is no result of mbocp, or damaged.
    """
    limits = LIMITS.for_size(len(content))
    try:
        process = subprocess.run(
            python_command(_START, *map(str, limits[:2])),
            input=content,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **_ONE_THREAD},
            timeout=limits.wall_seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise _damage(path, f"reading it did not end in {limits.wall_seconds:g} s") from None
    except OSError as error:
        reason = f"has an old format, and no process can be started to read it: {error.strerror or error}"
        raise ResultFileError(path, reason) from error
    if process.returncode == REFUSED:
        raise ResultFileError(path, process.stdout.decode(errors="replace"))
    if process.returncode:
        raise _damage(path, _end(process.returncode, limits))
    return process.stdout


def _end(status: int, limits: ReadLimits) -> str:
    if status == -signal.SIGXCPU:
        return f"reading it did not end in {limits.cpu_seconds} s"
    if status < 0:
        return f"HDF5 crashed on it, signal {-status}"
    return f"the process that read it ended with status {status}"


def _damage(path: str | Path, how: str) -> ResultFileError:
    return ResultFileError(path, f"is damaged ({how}); solve again, or take a copy of it")

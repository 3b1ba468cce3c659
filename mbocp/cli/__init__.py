"""The command line: `mbocp`."""

from __future__ import annotations

import atexit
import gc
import os
import sys

__all__ = ["main", "script"]

# New objects after which the collector looks for circles: imports and plots make up to 300,000 that stay, and
# with the default of 700 it looks at them again and again.
_COLLECT = (400_000, 20, 100)
# What NumPy and pydantic read when they are imported, unless the user says otherwise. Matrices are small,
# and other threads of BLAS cost a processor while they wait; looking for plugins reads about every package.
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "PYDANTIC_DISABLE_PLUGINS": "__all__"}


def script() -> None:
    """Be the `mbocp` script: run the command line, and end the process as soon as all is written.

    The interpreter would free its memory piece by piece, which takes as long as a solve.
    """
    status: list[int] = []  # when it is known
    gc.set_threshold(*_COLLECT)
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    atexit.register(_end, status)  # the first to be registered is the last to be called
    try:
        main()
    except SystemExit as end:
        if end.code is None or isinstance(end.code, int):  # else a message, which the interpreter prints
            status.append(end.code or 0)
        raise
    status.append(0)


def _end(status: list[int]) -> None:
    """End the process; threads are joined by then, and what else was registered has been called."""
    if not status:
        return  # the interpreter has something to say
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except (OSError, ValueError):
        return  # and of closed streams, too
    os._exit(status[0])


def main() -> None:
    """Run the command line, and raise `SystemExit`."""
    try:
        _run()
    except KeyboardInterrupt:  # in the moment before handlers stand
        sys.stderr.write("interrupted: stopped before there was a result\n")
        sys.exit(130)


def _run() -> None:
    from mbocp.cli import signals  # first of all, and alone: everything else takes time

    signals.leave_at_once()
    from mbocp.cli.app import app_for

    try:
        app_for(sys.argv[1:])()
    finally:
        signals.leave_at_once()  # the work is done; the interpreter takes a while to end

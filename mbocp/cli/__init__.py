"""The command line: `mbocp`."""

from __future__ import annotations

import atexit
import contextlib
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
_STREAMS = ("stdin", "stdout", "stderr")  # by their numbers


def script() -> None:
    """Be the `mbocp` script: run the command line, and end the process as soon as all is written.

    The interpreter would free its memory piece by piece, which takes as long as a solve.
    """
    status: list[int] = []  # when it is known
    gc.set_threshold(*_COLLECT)
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    os.environ["MPLBACKEND"] = (
        "agg"  # pictures go into files, and a backend that is none ends matplotlib's import
    )
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
    _open_streams()
    try:
        _run()
    except KeyboardInterrupt:  # in the moment before handlers stand
        sys.stderr.write("interrupted: stopped before there was a result\n")
        sys.exit(130)
    except OSError as error:  # of what is printed beside commands, as help is
        from mbocp.cli.error_report import BAD_INPUT, forget_output

        with contextlib.suppress(OSError):
            sys.stderr.write(f"error: {error.strerror}\n")
        forget_output()
        sys.exit(BAD_INPUT)


def _open_streams() -> None:
    """Put streams that lead nowhere in the place of those that are closed.

    Else the next files to be opened would get their numbers, and what libraries print.
    """
    for number, name in enumerate(_STREAMS):
        if getattr(sys, name) is None:
            mode = os.O_WRONLY if number else os.O_RDONLY
            opened = os.open(os.devnull, mode)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
            setattr(sys, name, open(number, "w" if number else "r"))  # noqa: SIM115, PTH123


def _run() -> None:
    from mbocp.cli import signals  # first of all, and alone: everything else takes time

    signals.leave_at_once()
    from mbocp.cli.app import app_for

    try:
        app_for(sys.argv[1:])()
    finally:
        signals.leave_at_once()  # the work is done; the interpreter takes a while to end

"""What goes to stderr: errors, warnings, and what an exit status means.

This is the one place where an exception becomes a line and an exit status. What mbocp raises on purpose and
what a machine refuses (memory, disk, permissions) are lines; anything else is a bug, and stays visible.
"""

from __future__ import annotations

import contextlib
import errno
import functools
import json
import os
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, ParamSpec, TypeVar

import typer

from mbocp._text import MAX_MESSAGE, shorten
from mbocp.cli import signals
from mbocp.exceptions import MbocpError

BAD_INPUT = 2
BUG = 70  # EX_SOFTWARE: 1 is "not converged", and a bug must not look like it
INTERRUPTED = 130  # what a shell reports for Ctrl-C
CLOSED_PIPE = 141  # and for a reader that went away

_MAX_TRACE = 20_000  # characters
_NO_MEMORY = (
    "there is not enough memory for this; take fewer steps or substeps, a smaller robot, or a machine that "
    "has more"
)
# What a machine refuses, whatever mbocp does; other errors of the system (no such file, ...) are looked at
# where they arise, and are bugs here.
_REFUSALS = frozenset(
    {
        errno.EACCES,
        errno.EDQUOT,
        errno.EFBIG,
        errno.EIO,
        errno.EMFILE,
        errno.ENAMETOOLONG,
        errno.ENFILE,
        errno.ENOMEM,
        errno.ENOSPC,
        errno.EPERM,
        errno.EROFS,
    }
)

_P = ParamSpec("_P")
_R = TypeVar("_R")


class _Meaning(NamedTuple):
    """What an exception is called, how it is told, and the exit status."""

    word: str
    message: str
    color: str
    status: int


def report_errors_of(command: Callable[_P, _R]) -> Callable[_P, _R]:
    """Report the errors of a command, as its switches `--quiet` and `--json` say."""

    @functools.wraps(command)
    def run(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with report_errors(quiet=bool(kwargs.get("quiet")), as_json=bool(kwargs.get("as_json"))):
            return command(*args, **kwargs)

    return run


@contextlib.contextmanager
def report_errors(*, quiet: bool = False, as_json: bool = False) -> Iterator[None]:
    """Turn errors into a line for a person and an exit status for a script.

    With ``--json`` there is an object on stdout then, too: what kind of error, and the message.
    """
    try:
        with show_warnings(quiet=quiet), _flush_output():
            yield
    except (typer.Exit, typer.Abort):
        raise
    except BrokenPipeError:  # somebody reads only the head of the output
        forget_output()
        raise typer.Exit(CLOSED_PIPE) from None
    except BaseException as error:
        meaning = _meaning(error)
        if meaning is None:
            raise
        if as_json:
            _print_json(error, meaning)
        _say(meaning.word, meaning.message, meaning.color)
        if isinstance(error, OSError):
            forget_output()  # if that is what cannot be written
        raise typer.Exit(meaning.status) from None


def tell(error: MbocpError) -> int:
    """Print the line of an error on stderr, and return the exit status."""
    _say("error", str(error), "red")
    return BAD_INPUT


def _meaning(error: BaseException) -> _Meaning | None:
    """What an exception means; None if it is not an error."""
    signalled = signals.status_of_signal()
    if isinstance(error, KeyboardInterrupt) or (signalled and not isinstance(error, MbocpError)):
        # What is interrupted in the midst of an import may come out as another exception.
        return _Meaning("interrupted", signals.BEFORE_A_RESULT, "yellow", signalled or INTERRUPTED)
    if isinstance(error, MbocpError):
        return _Meaning("error", str(error), "red", BAD_INPUT)
    if isinstance(error, MemoryError):
        return _Meaning("error", _NO_MEMORY, "red", BAD_INPUT)
    if isinstance(error, OSError) and error.errno in _REFUSALS:
        where = f"{error.filename}: " if error.filename is not None else ""
        return _Meaning("error", f"{where}{error.strerror}", "red", BAD_INPUT)
    if not isinstance(error, Exception):
        return None
    sys.stderr.write(shorten("".join(traceback.format_exception(error)), _MAX_TRACE))
    return _Meaning("error", "this is a bug in mbocp; please report it with the lines above", "red", BUG)


@contextlib.contextmanager
def _flush_output() -> Iterator[None]:
    """Flush stdout at the end, while a reader that went away can still be noticed."""
    try:
        yield
    finally:
        sys.stdout.flush()


def forget_output() -> None:
    """Let nobody try to write the rest of the output to a closed pipe."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):  # a stream without a file has no pipe, either
            stream.flush()
            continue
        with contextlib.suppress(OSError, ValueError):
            os.dup2(nowhere, stream.fileno())


@contextlib.contextmanager
def show_warnings(quiet: bool) -> Iterator[None]:
    """Show each warning once, as a line on stderr instead of Python's two with a file name."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        if not quiet:
            _say("warning", str(message), "yellow")

    # What Python says by default to everybody; deprecations are for developers.
    ours = (UserWarning, RuntimeWarning)
    with warnings.catch_warnings():
        for category in ours:
            warnings.simplefilter("default", category)
        warnings.showwarning = show
        yield


def _print_json(error: BaseException, meaning: _Meaning) -> None:
    """Print what happened as one object, in the place of the result."""
    facts = {
        "status": meaning.word,
        "converged": False,
        "error": type(error).__name__,
        "key": error.key if isinstance(error, MbocpError) else None,
        "message": shorten(meaning.message, MAX_MESSAGE),
        "exit_status": meaning.status,
    }
    with contextlib.suppress(OSError):  # which may be what happened
        typer.echo(json.dumps(facts, indent=2))


def _say(word: str, message: str, color: str) -> None:
    """Print ``word: message`` on stderr, the word in colour if that is a terminal."""
    first, *rest = shorten(message, MAX_MESSAGE).splitlines() or [""]
    lines = [f"{typer.style(word, fg=color, bold=True)}: {first}", *(f"  {line}" for line in rest)]
    with contextlib.suppress(OSError):  # nobody reads it; the exit status tells
        typer.echo("\n".join(lines), err=True, color=None if sys.stderr.isatty() else False)

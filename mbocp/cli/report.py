"""What goes to stderr: errors, warnings, and what an exit status means."""

from __future__ import annotations

import contextlib
import functools
import os
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from typing import Any, ParamSpec, TypeVar

import typer

from mbocp.exceptions import MbocpError

__all__ = ["BAD_INPUT", "BUG", "INTERRUPTED", "reporting", "shown_warnings"]

BAD_INPUT = 2
BUG = 70  # EX_SOFTWARE: 1 is "not converged", and a bug must not look like it
INTERRUPTED = 130  # what a shell reports for Ctrl-C
CLOSED_PIPE = 141  # and for a reader that went away

_P = ParamSpec("_P")
_R = TypeVar("_R")


def reporting(command: Callable[_P, _R]) -> Callable[_P, _R]:
    """Turn errors into a line for a person and an exit status for a script."""

    @functools.wraps(command)
    def wrapped(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        try:
            with shown_warnings(quiet=bool(kwargs.get("quiet"))):
                return command(*args, **kwargs)
        except MbocpError as error:
            _say("error", str(error), "red")
            raise typer.Exit(BAD_INPUT) from None
        except KeyboardInterrupt:
            _say("interrupted", "stopped before there was a result", "yellow")
            raise typer.Exit(INTERRUPTED) from None
        except (typer.Exit, typer.Abort):
            raise
        except BrokenPipeError:  # somebody reads only the head of the output
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(CLOSED_PIPE) from None
        except Exception:
            traceback.print_exc()
            _say("error", "this is a bug in mbocp; please report it with the lines above", "red")
            raise typer.Exit(BUG) from None

    return wrapped


@contextlib.contextmanager
def shown_warnings(quiet: bool) -> Iterator[None]:
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


def _say(word: str, message: str, color: str) -> None:
    """Print ``word: message`` on stderr, the word in colour if that is a terminal."""
    first, *rest = message.splitlines() or [""]
    lines = [f"{typer.style(word, fg=color, bold=True)}: {first}", *(f"  {line}" for line in rest)]
    typer.echo("\n".join(lines), err=True, color=None if sys.stderr.isatty() else False)

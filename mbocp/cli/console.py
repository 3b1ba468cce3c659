"""Where results are printed."""

from __future__ import annotations

from rich.console import Console

__all__ = ["output"]

_PIPE_WIDTH = 200  # nobody looks at the lines of a pipe through a narrow window


def output() -> Console:
    """Return a console for stdout, wide if that is no terminal."""
    console = Console(highlight=False)
    return console if console.is_terminal else Console(width=_PIPE_WIDTH, highlight=False)

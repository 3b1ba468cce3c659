"""The command line: `mbocp`."""

from __future__ import annotations

import sys

__all__ = ["main"]


def main() -> None:
    """Run the command line; the entry point of the `mbocp` script."""
    try:
        _run()
    except KeyboardInterrupt:  # in the moment before handlers stand
        sys.stderr.write("interrupted: stopped before there was a result\n")
        sys.exit(130)


def _run() -> None:
    from mbocp.cli import signals  # first of all, and alone: everything else takes time

    signals.leave_at_once()
    from mbocp.cli.app import app

    try:
        app()
    finally:
        signals.leave_at_once()  # the work is done; the interpreter takes a while to end

"""The command line: `mbocp`."""

from __future__ import annotations

__all__ = ["main"]


def main() -> None:
    """Run the command line; the entry point of the `mbocp` script."""
    from mbocp.cli.app import app

    app()

"""Processes of Python that run no module of the folder in which they are started; signals to this one.

`python -c` puts the current folder before the standard library: a `json.py` that lies there would be run.
"""

from __future__ import annotations

import json
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

# For processes that `multiprocessing` starts by commands of its own. Known since Python 3.11.
SAFE_PATH: Mapping[str, str] = {"PYTHONSAFEPATH": "1"}


def python_command(statements: str, *arguments: str) -> list[str]:
    """Words of a command that runs statements with the import path of this process.

    Parameters
    ----------
    statements : str
        Lines of Python; `sys` is imported.
    *arguments : str
        What stands in `sys.argv[1:]`.
    """
    path = json.dumps(sys.path)
    begin = "import sys, json\nsys.path[:] = json.loads(sys.argv.pop(1))\n"
    return [sys.executable, "-I", "-c", begin + statements, path, *arguments]


@contextmanager
def signal_handler(number: int, handler: Callable[..., Any] | signal.Handlers) -> Iterator[None]:
    """Handle a signal like this inside the block; of threads only the main one hears signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before if before is not None else signal.SIG_DFL)


@contextmanager
def signals_wait() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait for the end of the block, whose code ends the process if broken off."""
    heard: list[int] = []

    def hear(number: int, frame: object) -> None:
        heard.append(number)

    with signal_handler(signal.SIGINT, hear), signal_handler(signal.SIGTERM, hear):
        yield
    for number in heard:
        signal.raise_signal(number)

"""The process behind `mbocp.solvers.strategies.elsewhere`: tasks on stdin, outcomes on stdout."""

from __future__ import annotations

import os
import queue
import sys
import threading
from typing import IO, Any

from mbocp.solvers.strategies.elsewhere import receive, send
from mbocp.solvers.strategies.phases import Start
from mbocp.solvers.strategies.strategy import run_strategy

__all__ = ["main"]


def main() -> None:
    """Solve what comes in until nothing does any more, or the parent ends."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what foreign solvers print is no answer
    tasks: queue.Queue[Any] = queue.Queue()
    threading.Thread(target=_listen, args=(sys.stdin.buffer, tasks), daemon=True).start()
    while True:
        settings, programme, iterate, label = tasks.get()
        try:
            answer: object = run_strategy(settings, Start(programme, iterate, label=label))
        except Exception as error:  # the parent runs the task itself, and raises it
            answer = f"{type(error).__name__}: {error}"
        send(answers, answer)


def _listen(stream: IO[bytes], tasks: queue.Queue[Any]) -> None:
    try:
        while True:
            tasks.put(receive(stream))
    except Exception:  # the parent has ended, or closed
        os._exit(0)

"""The process behind `mbocp.solvers.strategies.elsewhere`: tasks on stdin, what they tell on stdout."""

from __future__ import annotations

import os
import queue
import sys
import threading
from typing import IO, Any

from mbocp.solvers.strategies.elsewhere import Answer, Failure, Told, receive, send


def main() -> None:
    """Do what comes in until nothing does any more, or the parent ends."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what foreign solvers print is no answer
    inbox: queue.Queue[Any] = queue.Queue()
    threading.Thread(target=_listen, args=(sys.stdin.buffer, inbox), daemon=True).start()

    def tell(value: object) -> None:
        send(answers, Told(value))
        if not inbox.get():
            raise KeyboardInterrupt

    while True:
        task = inbox.get()
        try:
            answer: object = Answer(task.run(tell))
        except Exception as error:  # the parent does the task itself, and raises it
            answer = Failure(f"{type(error).__name__}: {error}")
        send(answers, answer)


def _listen(stream: IO[bytes], inbox: queue.Queue[Any]) -> None:
    try:
        while True:
            inbox.put(receive(stream))
    except Exception:  # the parent has ended, or closed
        os._exit(0)

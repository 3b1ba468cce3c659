"""What Ctrl-C (SIGINT) and SIGTERM do: end the process at once, or end the work in order.

A closed pipe (SIGPIPE) ends the process at once, too, as it does other programs, until there is work.

While modules are imported nothing is there that could be lost, and an exception in the midst of an extension
module's start may come out as anything: the process ends at once. Once there is work, both signals raise
`KeyboardInterrupt`, which a solver turns into its best iterate, and a writer into a file that is not there.

This module imports next to nothing, so that handlers stand before anything takes time.
"""

from __future__ import annotations

import os
import signal
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from types import FrameType

BEFORE_A_RESULT = "stopped before there was a result"

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_SOON = 1e-3  # [s]
_received: list[int] = []  # signals belong to the process, and so does what came in


def leave_at_once() -> None:
    """Let both signals end the process with 128 + their number, as a shell reports it.

    A signal that is ignored stays so: what runs in the background of a shell, or under nohup, wants that.
    """
    for number in _SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _leave)
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)


def leave_in_order() -> None:
    """Let both signals raise `KeyboardInterrupt` in the main thread; only after `leave_at_once`."""
    for number in _SIGNALS:
        if signal.getsignal(number) is _leave:
            signal.signal(number, _raise)
            signal.signal(signal.SIGPIPE, signal.SIG_IGN)  # as Python does: who writes sees it
            sys.unraisablehook = _raise_later
            signal.signal(signal.SIGALRM, _raise)


def status_of_signal() -> int:
    """Exit status of the first signal that came in; 0 if there was none."""
    return 128 + _received[0] if _received else 0


def _leave(number: int, frame: FrameType | None) -> None:
    os.write(2, f"interrupted: {BEFORE_A_RESULT}\n".encode())
    os._exit(128 + number)


def _raise(number: int, frame: FrameType | None) -> None:
    """Interrupt; SIGTERM by way of whoever waits for Ctrl-C, such as a solver in a foreign library."""
    _received.append(number)
    handler = signal.getsignal(signal.SIGINT)
    if number != signal.SIGINT and callable(handler) and handler not in (_raise, signal.default_int_handler):
        handler(signal.SIGINT, frame)
        return
    raise KeyboardInterrupt


def _raise_later(unraisable: sys.UnraisableHookArgs) -> None:
    """Say what was raised where nothing can be; an interruption comes back when that is over."""
    if isinstance(unraisable.exc_value, KeyboardInterrupt):
        signal.setitimer(signal.ITIMER_REAL, _SOON)
    else:
        sys.__unraisablehook__(unraisable)

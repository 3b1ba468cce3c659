"""When a limit of time is over: by `time.perf_counter`, and in seconds from now."""

from __future__ import annotations

import math
import time


def deadline_after(seconds: float | None) -> float:
    """Return the time of `time.perf_counter` in so many seconds; infinite without a limit."""
    return math.inf if seconds is None else time.perf_counter() + seconds


def time_until(deadline: float) -> float | None:
    """Return what is left until a deadline [s]; None: there is none."""
    return None if math.isinf(deadline) else max(0.0, deadline - time.perf_counter())

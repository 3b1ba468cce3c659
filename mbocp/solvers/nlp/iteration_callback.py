"""Callback of an interior-point solver in every iteration: time limit, Ctrl-C, and the last iterate."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from mbocp._arrays import Array


class IterationCallback(ca.Callback):
    """A function of the unknowns that is zero, and NaN once the solve must end.

    It is added to the Jacobian, which every solver evaluates once an iteration at its iterate and cannot go
    on without. Solvers would take an exception raised here for a failed trial step.

    Attributes
    ----------
    last : ndarray or None
        Unknowns at the latest evaluation.
    reason : str
        Why the solve was ended: "", "interrupted" or "time_limit".
    """

    def __init__(self, size: int) -> None:
        super().__init__()
        self.last: Array | None = None
        self.reason = ""
        self.is_wanted: Callable[[], bool] = lambda: True
        self._size, self._deadline = size, math.inf
        self.construct("iteration_callback", {})

    def start(self, time_limit: float | None) -> None:
        """Start the clock."""
        self.last, self.reason = None, ""
        self._deadline = math.inf if time_limit is None else time.monotonic() + time_limit

    def get_n_in(self) -> int:
        """One."""
        return 1

    def get_n_out(self) -> int:
        """One."""
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """A column of unknowns."""
        return ca.Sparsity.dense(self._size, 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        """A number."""
        return ca.Sparsity.dense(1, 1)

    def has_eval_buffer(self) -> bool:
        """Yes: nothing is copied but the unknowns."""
        return True

    def eval_buffer(self, arguments: Sequence[memoryview], results: Sequence[memoryview]) -> int:
        """Zero, or not a number."""
        if not self.is_wanted():
            self.reason = "interrupted"
        elif time.monotonic() > self._deadline:
            self.reason = "time_limit"
        if not self.reason:
            self.last = np.frombuffer(arguments[0], dtype=np.float64).copy()
        if results[0] is not None:
            np.frombuffer(results[0], dtype=np.float64)[:] = math.nan if self.reason else 0.0
        return 0

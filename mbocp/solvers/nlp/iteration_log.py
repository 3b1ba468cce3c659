"""What an interior-point solver says: iterations, read from its table; how it ended, as status and advice.

IPOPT and fatrop print the same columns: iteration, objective, inf_pr, inf_du, lg(mu), ||d||, lg(rg),
alpha_du, alpha_pr, line search. Reading them gives one record an iteration, live, at little cost.
"""

from __future__ import annotations

import contextlib
import io
import math
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.programme import StagewiseProgramme
from mbocp.programme.native_modules import nlp_helpers
from mbocp.solvers.nlp.nlp_layout import NlpLayout
from mbocp.solvers.records import IterationRecord, Status

_NUMBER = r"[-+]?(?:\d+\.\d+e[-+]\d+|\d+\.\d+|nan|inf)"
_LINE = re.compile(
    rf"^\s*(?P<iteration>\d+)(?P<restoration>r?)\s+(?P<cost>{_NUMBER})\s+(?P<primal>{_NUMBER})\s+"
    rf"(?P<dual>{_NUMBER})\s+\S+\s+(?P<step>{_NUMBER})\s+(?P<shift>-|{_NUMBER})\s+{_NUMBER}\s+"
    rf"(?P<alpha>{_NUMBER})",
    re.IGNORECASE,
)


@contextlib.contextmanager
def whole_lines() -> Iterator[None]:
    """Let what CasADi prints come line by line, and not in forty calls an iteration."""
    native = nlp_helpers()
    native.begin_whole_lines()
    try:
        yield
    finally:
        native.end_whole_lines()


class OfThread:
    """The standard output of the thread that makes it: a stream; of other threads it stays what it is."""

    def __init__(self, stream: io.TextIOBase) -> None:
        self._stream, self._others, self._own = stream, sys.stdout, threading.get_ident()

    def __getattr__(self, name: str) -> Any:
        """Of the stream of the thread that asks."""
        return getattr(self._stream if threading.get_ident() == self._own else self._others, name)


class IterationLog(io.TextIOBase):
    """A text stream that keeps iterations as records.

    Parameters
    ----------
    phase : str
        Name of the phase that the records belong to.
    first : int
        Iterations before, where they go on counting.
    callback : callable, optional
        Called with every record.
    """

    def __init__(
        self, phase: str, first: int = 0, callback: Callable[[IterationRecord], object] | None = None
    ) -> None:
        super().__init__()
        self.records: list[IterationRecord] = []
        self.failure: BaseException | None = None
        self._phase, self._first, self._callback = phase, first, callback
        self._pieces: list[str] = []
        self._clock = time.perf_counter()

    def writable(self) -> bool:
        """Yes."""
        return True

    def write(self, text: str) -> int:
        """Take text as it comes, in pieces of any size."""
        if "\n" not in text:
            self._pieces.append(text)
            return len(text)
        *lines, rest = ("".join(self._pieces) + text).split("\n")
        self._pieces = [rest] if rest else []
        for line in lines:
            self._read(line)
        return len(text)

    def _read(self, line: str) -> None:
        found = _LINE.match(line)
        if not found:
            return
        now = time.perf_counter()
        iteration = int(found["iteration"])
        if self.records and self.records[-1].iteration == self._first + iteration:
            return  # fatrop prints an iteration again where its restoration begins and ends
        shift = found["shift"]
        record = IterationRecord(
            iteration=self._first + iteration,
            residual=max(float(found["primal"]), float(found["dual"])),
            increment=float(found["step"]) if iteration else math.nan,
            cost=float(found["cost"]),
            step_length=float(found["alpha"]) if iteration else math.nan,
            primal=float(found["primal"]),
            dual=float(found["dual"]),
            regularisation=0.0 if shift == "-" else 10.0 ** float(shift),
            wall_time_s=now - self._clock,
            phase=self._phase + (" (restoration)" if found["restoration"] else ""),
        )
        self._clock = now
        self.records.append(record)
        if self._callback is None or self.failure is not None:
            return
        try:
            self._callback(record)
        except BaseException as error:  # raised again by the solver's caller: C++ in between would lose it
            self.failure = error


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
        self._places, self._allowance = 0, math.inf
        self.construct("iteration_callback", {})

    def start(self, time_limit: float | None, allowance: int | None = None) -> None:
        """Start the clock, and count iterations."""
        self.last, self.reason = None, ""
        self._places, self._allowance = 0, math.inf if allowance is None else allowance
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
        here = np.frombuffer(arguments[0], dtype=np.float64)
        self._places += self.last is None or not np.array_equal(self.last, here)
        if not self.is_wanted():
            self.reason = "interrupted"
        elif time.monotonic() > self._deadline or self._places > 1 + self._allowance:
            self.reason = "time_limit"
        if not self.reason:
            self.last = here.copy()
        if results[0] is not None:
            np.frombuffer(results[0], dtype=np.float64)[:] = math.nan if self.reason else 0.0
        return 0


_ACCEPTABLE_RESIDUAL = 1e-5  # residual below which a solver that stalls has found what it was looking for

_IPOPT = {
    "Solve_Succeeded": Status.CONVERGED,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Maximum_Iterations_Exceeded": Status.MAX_ITERATIONS,
    "Maximum_WallTime_Exceeded": Status.TIME_LIMIT,
    "Search_Direction_Becomes_Too_Small": Status.LINE_SEARCH_FAILED,
    "Restoration_Failed": Status.LINE_SEARCH_FAILED,
    "Solved_To_Acceptable_Level": Status.LINE_SEARCH_FAILED,
    "Diverging_Iterates": Status.DIVERGED,
    "Invalid_Number_Detected": Status.DIVERGED,
    "Error_In_Step_Computation": Status.SINGULAR,
    "Not_Enough_Degrees_Of_Freedom": Status.INFEASIBLE,
}


def status_of(name: str, stats: Mapping[str, Any], stopped: str, max_iterations: int) -> Status:
    """Status from what the solver returned; `stopped`: why mbocp ended it."""
    if stopped:
        return Status.INTERRUPTED if stopped == "interrupted" else Status.TIME_LIMIT
    if stats.get("success"):
        return Status.CONVERGED
    if name == "ipopt":
        return _IPOPT.get(str(stats.get("return_status")), Status.LINE_SEARCH_FAILED)
    # All that fatrop says; one iteration is too few for it to take any.
    is_spent = int(stats.get("iter_count", 0)) >= (max_iterations if max_iterations > 1 else 0)
    return Status.MAX_ITERATIONS if is_spent else Status.LINE_SEARCH_FAILED


def advice_of(
    status: Status,
    programme: StagewiseProgramme,
    lay: NlpLayout,
    violations: Array,
    taken: int,
    residual: float,
) -> str:
    """What the status means here, and what to do."""
    worst = _worst(programme, lay, violations)
    iterations = f"{taken} iteration{'' if taken == 1 else 's'}"
    texts = {
        Status.CONVERGED: "a local minimum: the solver's optimality error is below the tolerance",
        Status.INFEASIBLE: "no motion meets all constraints, as far as the solver can see from this guess; "
        "widen the limits, take a longer duration or another goal",
        Status.MAX_ITERATIONS: f"not converged in {iterations}; raise solver.max_iterations, or start from "
        "another guess",
        Status.TIME_LIMIT: f"not converged within solver.time_limit, after {iterations}; raise it, or start "
        "from another guess",
        Status.LINE_SEARCH_FAILED: f"no step makes progress any more after {iterations}; the goal may be out "
        "of reach within the limits; try a longer duration, wider limits, another guess, or the other of "
        '"ipopt" and "fatrop"',
        Status.DIVERGED: "the iterates left the finite numbers, or steps that keep errors small; take "
        "more steps or another guess",
        Status.SINGULAR: "the linear system cannot be solved; look for constraints that depend on each other",
        Status.INTERRUPTED: f"interrupted after {iterations}; the last iterate",
    }
    if status is Status.CONVERGED:
        return texts[status]
    if status is Status.LINE_SEARCH_FAILED and residual < _ACCEPTABLE_RESIDUAL:
        return (
            f"near a solution, but no step makes progress any more after {iterations} "
            f'(residual {residual:.1e}); raise solver.tolerance, or take the other of "ipopt" and "fatrop"'
        )
    return f"{texts[status]}; {worst}"


def _worst(programme: StagewiseProgramme, lay: NlpLayout, violations: Array) -> str:
    row = int(np.argmax(violations))
    size = f"({violations[row]:.1e})"
    if violations[row] <= 1e-8:
        return f"all constraints hold {size}"
    describe = programme.describe_row
    for name, rows in (("steps", lay.steps), ("gaps", lay.gaps)):
        at = np.argwhere(rows == row)
        if at.size:
            step, index = (int(i) for i in at[0])
            words = describe(step, index) if name == "steps" else f"the step to node {step + 1}"
            return f"largest violation: {words} {size}"
    at = np.argwhere(lay.path == row)
    if at.size:
        node, index = (int(i) for i in at[0])
        when = programme.describe_node(node + 1)
        return f"largest violation: {programme.describe_path(index)} {when} {size}"
    if row in lay.end:
        return f"largest violation: {describe(-1, int(row - lay.end[0]))} {size}"
    return f"largest violation: {'guard of the end condition' if row in lay.guards else 'start'} {size}"

"""What a solver reports: how it ended, one record an iteration, and whether its time is over."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import Enum
from typing import TypeAlias

from mbocp._arrays import dataclass


class Status(str, Enum):
    """How a solve ended; the advice that goes with it says what to do."""

    CONVERGED = "converged"
    UNDER_RESOLVED = "under_resolved"  # of a solution: no solver looks at the motion
    OTHER_ROOT = "other_root"  # likewise: of the end condition
    MAX_ITERATIONS = "max_iterations"
    LINE_SEARCH_FAILED = "line_search_failed"
    SINGULAR = "singular"
    DIVERGED = "diverged"
    SWEEP_FAILED = "sweep_failed"
    STAGNATED = "stagnated"
    SWITCHED = "switched"  # only between the phases of a hybrid
    INFEASIBLE = "infeasible"
    TIME_LIMIT = "time_limit"
    INTERRUPTED = "interrupted"

    def __str__(self) -> str:
        return self.value

    @property
    def is_stationary(self) -> bool:
        """Whether the optimality conditions hold to the tolerance."""
        return self in (Status.CONVERGED, Status.UNDER_RESOLVED, Status.OTHER_ROOT)

    @property
    def is_stopped(self) -> bool:
        """Whether the user ended it, at once or ahead."""
        return self in (Status.INTERRUPTED, Status.TIME_LIMIT)


@dataclass(frozen=True)
class Phase:
    """One phase of a solve: compile, guess, or a stage of the solver.

    Attributes
    ----------
    name : str
    iterations : int
        Iterations of this phase; 0 where there are none.
    wall_time_s : float
        Duration [s].
    """

    name: str
    iterations: int
    wall_time_s: float


@contextmanager
def time_phase(phases: list[Phase], name: str) -> Iterator[None]:
    """Add a phase without iterations: what is done in a `with` block."""
    clock = time.perf_counter()
    yield
    phases.append(Phase(name, 0, time.perf_counter() - clock))


@dataclass(frozen=True)
class IterationRecord:
    """One iteration of a solver; NaN where the solver has no such number.

    Attributes
    ----------
    iteration : int
        Counts from 1 over all runs of a solve; the record of a guess has the number before its run.
    residual : float
        Euclidean norm of the optimality conditions after the iteration: r_w, or r_u, eq. (31), of a staggered
        solver, which satisfies the others by its sweeps.
    increment : float
        Euclidean norm of the step: in all unknowns, or in (eta, u) of a staggered solver.
    cost : float
        Objective J, eq. (7).
    step_length : float
        Fraction of the step that was taken.
    primal, dual : float
        Norms of the state equations with the end condition, and of the stationarity conditions.
    regularisation : float
        What was added to the Hessian's control diagonal, relative to the control's weight; infinite for
        Gauss-Newton.
    wall_time_s : float
        Duration of the iteration [s].
    phase : str
        Name of the phase that it belongs to.
    """

    iteration: int
    residual: float
    increment: float = math.nan
    cost: float = math.nan
    step_length: float = math.nan
    primal: float = math.nan
    dual: float = math.nan
    regularisation: float = 0.0
    wall_time_s: float = math.nan
    phase: str = ""

    @property
    def is_guess(self) -> bool:
        """Whether it describes where a run began, before any step."""
        return math.isnan(self.step_length)


Callback: TypeAlias = Callable[[IterationRecord], object]


def deadline_after(seconds: float | None) -> float:
    """Return the time of `time.perf_counter` in so many seconds; infinite without a limit."""
    return math.inf if seconds is None else time.perf_counter() + seconds


def time_until(deadline: float) -> float | None:
    """Return what is left until a deadline [s]; None: there is none."""
    return None if math.isinf(deadline) else max(0.0, deadline - time.perf_counter())

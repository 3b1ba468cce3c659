"""How long a solve goes on once an attempt has come to nothing, and whether it makes sense to.

What solvers do is counted, and not how long it takes, so that a solve comes to the same on every machine,
however busy that is, and whether its functions are compiled or not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from mbocp.programme import StagewiseProgramme
from mbocp.solvers.records import Status
from mbocp.solvers.strategies.iterating import SolverResult

# What helps, helps soon: of the problems that a later attempt solves, few need more than some times what the
# first took. Twenty leaves room for IPOPT and three guesses; ...
_TIMES = 20.0
# ... and where the first ends at once, others may take as long as nobody minds [s].
_LEAST = 2.0
# What an iteration of Newton's method takes for each step and square of its unknowns and rows [s]: of 68
# examples, of all sizes, four in five take 0.3 to 2.3 times as much, by the median 0.9 times; ...
_NEWTON = 1.5e-8
# ... and how many times as long one of IPOPT counts. It takes 20 times as long there, by the median: half of
# that leaves room for it.
_INTERIOR = 10.0
MORE_TIME = "solver.time_limit gives more"
_NO_FAILURES = (Status.CONVERGED, Status.SWITCHED, Status.INTERRUPTED, Status.TIME_LIMIT)


class Reason(Protocol):
    """Why no attempt can succeed: words for a person, and whether they are a proof."""

    @property
    def words(self) -> str: ...  # noqa: D102
    @property
    def is_certain(self) -> bool: ...  # noqa: D102


def time_of_iteration(programme: StagewiseProgramme, *, is_interior: bool = False) -> float:
    """How long an iteration of Newton's method, or of IPOPT, is reckoned to take, by its size alone [s]."""
    kind = programme.kind
    size = kind.nx + kind.ndx + 2 * kind.ny + kind.nu + programme.bounds.nh
    return _NEWTON * programme.num_steps * size**2 * (_INTERIOR if is_interior else 1.0)


class Patience:
    """What is left for further attempts at a problem, shared by all of them.

    Times are those that iterations are reckoned to take: none counts while functions are compiled or guesses
    are made.

    Parameters
    ----------
    is_limited : bool
        Whether attempts are: not where the user has set a limit of time, which holds instead.
    why_in_vain : callable, optional
        Gives the reason why no attempt can succeed, if there is one, from the status of the first that
        failed. It is called once.
    remedy : str
        What helps, where time is over.
    """

    def __init__(
        self,
        *,
        is_limited: bool = True,
        why_in_vain: Callable[[Status], Reason | None] | None = None,
        remedy: str = MORE_TIME,
    ) -> None:
        self._is_limited, self._why_in_vain, self._remedy = is_limited, why_in_vain, remedy
        self._has_failed, self._given = False, math.inf
        self.reason: Reason | None = None
        self._spent = 0.0
        self.left = math.inf

    @property
    def is_over(self) -> bool:
        """Whether nothing else is to be tried."""
        return self.left <= 0.0 or self.reason is not None

    @property
    def words(self) -> str:
        """Why nothing else was tried, for the advice; "" where that is not so."""
        if self.reason is not None:
            return f"no other attempt was made, since none can help: {self.reason.words}"
        if self.left > 0.0:
            return ""
        return (
            f"further attempts ended after as many iterations as take about {self._given:.2g} s "
            f"({_TIMES:.0f} times as many as the first took, {_LEAST:.0f} s at least); {self._remedy}"
        )

    @property
    def proof(self) -> str:
        """Why no attempt can succeed, if that is proved; else ""."""
        return self.reason.words if self.reason is not None and self.reason.is_certain else ""

    def status_of(self, status: Status) -> Status:
        """Return the status of a solve that failed: infeasible, if that is proved."""
        return Status.INFEASIBLE if self.proof and status not in _NO_FAILURES else status

    def iterations(self, each: float) -> int | None:
        """How many iterations that take so long [s] are left; None: as many as there may be."""
        return None if math.isinf(self.left) else math.ceil(max(self.left, 0.0) / each)

    def count(self, result: SolverResult, each: float) -> None:
        """Take account of a phase, whose iterations take so long [s]."""
        self._spend(each * sum(not record.is_guess for record in result.history))
        if self._has_failed or result.status in _NO_FAILURES:
            return
        self._has_failed = True
        if self._is_limited:
            self.left = self._given = max(_LEAST, _TIMES * self._spent)
        if self._why_in_vain is not None:
            self.reason = self._why_in_vain(result.status)

    def end(self) -> None:
        """Leave no time to further attempts, as one had to be broken off."""
        self.left = 0.0

    def _spend(self, seconds: float) -> None:
        self._spent += seconds
        self.left -= seconds

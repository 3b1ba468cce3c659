"""How long a solve goes on once an attempt has come to nothing, and whether it makes sense to."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

from mbocp.solvers.records import Status
from mbocp.solvers.strategies.iterating import SolverResult

# What helps, helps soon: of the problems that a later attempt solves, few need more than some times what the
# first took. Twenty leaves room for IPOPT and three guesses; ...
_TIMES = 20.0
# ... and where the first ends at once, others may take as long as nobody minds [s].
_LEAST = 2.0
MORE_TIME = "solver.time_limit gives more"
_NO_FAILURES = (Status.CONVERGED, Status.SWITCHED, Status.INTERRUPTED, Status.TIME_LIMIT)


class Reason(Protocol):
    """Why no attempt can succeed: words for a person, and whether they are a proof."""

    @property
    def words(self) -> str: ...  # noqa: D102
    @property
    def is_certain(self) -> bool: ...  # noqa: D102


class Patience:
    """What is left for further attempts at a problem, shared by all of them.

    Time counts while solvers iterate: not while functions are compiled or guesses are made, so that a solve
    comes to the same whether its functions were known or not.

    Parameters
    ----------
    is_limited : bool
        Whether time is: not where the user has set a limit, which holds instead.
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
            f"further attempts ended after {self._given:.3g} s ({_TIMES:.0f} times what the first took, "
            f"{_LEAST:.0f} s at least); {self._remedy}"
        )

    @property
    def proof(self) -> str:
        """Why no attempt can succeed, if that is proved; else ""."""
        return self.reason.words if self.reason is not None and self.reason.is_certain else ""

    def status_of(self, status: Status) -> Status:
        """Return the status of a solve that failed: infeasible, if that is proved."""
        return Status.INFEASIBLE if self.proof and status not in _NO_FAILURES else status

    def count(self, result: SolverResult) -> None:
        """Take account of a phase."""
        self.spend(sum(record.wall_time_s for record in result.history if not record.is_guess))
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

    def spend(self, seconds: float) -> None:
        """Take account of time that solvers have taken [s]."""
        self._spent += seconds
        self.left -= seconds

"""Interior-point solvers in a process of its own, which can be ended.

They look at the clock, and hear Ctrl-C, when they ask for a Jacobian. In fatrop there are loops over ever
larger shifts in which it never asks again, and one factorisation of IPOPT takes minutes where horizons are
long. So each iteration is told; when nothing is told any more, the process is ended, and what was told last
counts. The process is kept for the next run.
"""

from __future__ import annotations

import atexit
import os
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import cast

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import CompilationTimeout
from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.solvers.nlp.interior_point import InteriorPoint, unpack
from mbocp.solvers.nlp.nlp_layout import NlpLayout
from mbocp.solvers.records import Callback, IterationRecord, Status, deadline_after
from mbocp.solvers.strategies.elsewhere import Elsewhere, ElsewhereError, ProcessEnded, Tell
from mbocp.solvers.strategies.iterating import SolverResult

_GRACE = 1.0  # [s] beyond a time limit: for the process to begin, and for an iteration that is under way
_ALONE = threading.RLock()


def _run_and_tell(
    solver: InteriorPoint, programme: StagewiseProgramme, iterate: Iterate, phase: str, first: int, tell: Tell
) -> SolverResult:
    """Solve in the process, and tell the records and unknowns of iterations."""
    return solver.run_and_watch(programme, iterate, lambda *told: tell(told), phase, first, tell)


def run_apart(
    solver: InteriorPoint,
    programme: StagewiseProgramme,
    iterate: Iterate,
    callback: Callback | None,
    phase: str,
    first: int,
) -> SolverResult:
    """Run an interior-point solver as `InteriorPoint.run` does; one at a time.

    Without a process, as where no more can be started, it is run in this one.

    Raises
    ------
    ProblemError
        If there is what fatrop does not take.
    CompilationTimeout
        If the time limit passed before the solver began.
    """
    task = partial(_run_and_tell, solver, programme, iterate, phase, first)
    told, deadline = _Told(callback), deadline_after(solver.time_limit) + _GRACE
    with _ALONE:
        try:
            answer = _process().run(task, told.hear, deadline)
        except ElsewhereError:
            if not told.begun:
                return solver.run(programme, iterate, callback, phase, first)
            status = Status.DIVERGED  # it has crashed, and would do so here
        except ProcessEnded as ended:
            status = Status.INTERRUPTED if ended.is_interrupted else Status.TIME_LIMIT
            if not told.begun:
                raise _without_result(solver.title, status) from None
        else:
            result = cast("SolverResult", answer)
            return replace(result, history=told.records or result.history)  # those the callback has seen
    at = iterate if told.w is None else _unpack(told.w, programme, solver.name)
    history = told.records or told.begun
    return SolverResult(status, _advice(solver.title, status, history), at, history[-1], history)


@dataclass(eq=False)
class _Told:
    """What the process has told so far.

    Attributes
    ----------
    callback : callable, optional
    begun, records : tuple of IterationRecord
        Where the run began, if it has; its iterations.
    w : ndarray, optional
        The last unknowns.
    """

    callback: Callback | None
    begun: tuple[IterationRecord, ...] = ()
    records: tuple[IterationRecord, ...] = ()
    w: Array | None = None

    def hear(self, told: object) -> None:
        """Take in one more thing."""
        if isinstance(told, IterationRecord):
            self.begun = (told,)
        elif isinstance(told, tuple):  # of an iteration
            record, w = told
            self.records = (*self.records, record)
            self.w = self.w if w is None else w
            if self.callback is not None:
                self.callback(record)


def _without_result(title: str, status: Status) -> BaseException:
    """What ends a solve of which nothing is known."""
    if status is Status.INTERRUPTED:
        return KeyboardInterrupt()
    return CompilationTimeout(f"{title} was to begin")


def _process() -> Elsewhere:
    """The process of this one; another one where that has ended, or this one has forked."""
    if _entry_of(os.getpid()).is_over:
        _entry_of.cache_clear()
    return _entry_of(os.getpid())


@lru_cache(maxsize=1)
def _entry_of(pid: int) -> Elsewhere:
    process = Elsewhere()
    atexit.register(_close, process, pid)
    return process


def _close(process: Elsewhere, pid: int) -> None:
    """End a process with the one that has started it, not with one that this has forked."""
    if os.getpid() == pid:
        process.close()


def _unpack(w: Array, programme: StagewiseProgramme, name: str) -> Iterate:
    """An iterate of a solver without multipliers, which are not known."""
    lay = NlpLayout.of(programme, wants_gaps=name == "fatrop")
    return unpack(w, np.zeros(lay.num_rows), np.zeros(lay.num_unknowns), lay)


def _advice(title: str, status: Status, records: Sequence[IterationRecord]) -> str:
    """What the end of a run without an answer means: the iterate told last, by the solver's own numbers."""
    taken = sum(not record.is_guess for record in records)
    after = f"after {taken} iteration{'' if taken == 1 else 's'}"
    silent = f"{title} did not answer any more, and was ended"
    if status is Status.INTERRUPTED:
        return f"interrupted {after}; the last iterate; {silent}"
    if status is Status.TIME_LIMIT:
        return f"not converged within solver.time_limit, {after}; {silent}; take another solver.method"
    return f"{title} crashed {after}; the last iterate; take another solver.method"

"""Drive a solver from an iterate to its end: records, interruption, the best iterate, advice."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from mbocp._arrays import dataclass
from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.solvers.newton_method.limit_multipliers import multipliers_of
from mbocp.solvers.protocol import Measures, Solver, SolverState
from mbocp.solvers.records import Callback, IterationRecord, Status

_KEEP_EVERY = 10  # iterations: how often a better iterate is copied, in case that the last one is worse
_MUCH_LESS = 0.1  # of the last increment: the next one that is, and is foreseen, is not just more round-off
_HOLDS = 1e-6  # violation of steps and end condition beside which a larger residual is one of stationarity

StopTest = Callable[[Sequence[IterationRecord]], bool]


@dataclass(frozen=True)
class SolverResult:
    """End of a solver run.

    Attributes
    ----------
    status : Status
    advice : str
        What the status means here, and what to do.
    iterate : Iterate
        The last iterate, or the best one if the run did not converge.
    record : IterationRecord
        Of that iterate.
    history : tuple of IterationRecord
        From the guess on.
    """

    status: Status
    advice: str
    iterate: Iterate
    record: IterationRecord
    history: tuple[IterationRecord, ...]

    def with_interrupt(self) -> SolverResult:
        """Return the same end of a run, after which somebody pressed Ctrl-C."""
        advice = f"interrupted later; the best iterate so far (residual {self.record.residual:.1e})"
        return replace(self, status=Status.INTERRUPTED, advice=advice)


def run(
    solver: Solver[Any],
    programme: StagewiseProgramme,
    iterate: Iterate,
    callback: Callback | None = None,
    phase: str = "",
    first: int = 0,
    should_stop: StopTest | None = None,
    deadline: float = math.inf,
    allowance: int | None = None,
) -> SolverResult:
    """Iterate until the solver ends or somebody presses Ctrl-C; the callback sees every record.

    `first` is the number of iterations before this run, where the records go on counting. `should_stop` gets
    the records so far; a run that it stops has stagnated. `deadline` is the time of
    `time.perf_counter` at which no further iteration begins, `allowance` how many there may be.

    Without convergence the iterate with the smallest residual is returned, unless the last one is it.
    """
    clock = time.perf_counter()
    state = solver.init(programme, iterate)
    guess = _record(state, phase, first, time.perf_counter() - clock)
    course = _Course(solver, programme, callback, state, [guess], iterate, guess)
    try:
        if callback:
            callback(guess)
        status = course.go_on(should_stop, deadline, allowance)
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    return course.end(status)


@dataclass(eq=False)
class _Course:
    """A run on its way.

    Attributes
    ----------
    solver : Solver
    programme : StagewiseProgramme
    callback : callable, optional
    state : SolverState
    history : list of IterationRecord
    best : Iterate
        A copy of one of the best iterates so far.
    best_record : IterationRecord
        Of that.
    """

    solver: Solver[Any]
    programme: StagewiseProgramme
    callback: Callback | None
    state: SolverState
    history: list[IterationRecord]
    best: Iterate
    best_record: IterationRecord

    def go_on(self, should_stop: StopTest | None, deadline: float, allowance: int | None) -> Status:
        """Iterate to the end; return how it ended."""
        phase, first = self.history[0].phase, self.history[0].iteration
        while (status := self.solver.terminate(self.state)) is None:
            clock = time.perf_counter()
            if clock > deadline or (allowance is not None and self.state.iteration >= allowance):
                return Status.TIME_LIMIT
            self.state = self.solver.step(self.state)
            if first + self.state.iteration == self.history[-1].iteration:
                continue  # no step was taken; `terminate` knows why
            self._add(_record(self.state, phase, first, time.perf_counter() - clock))
            if should_stop and should_stop(self.history) and self.solver.terminate(self.state) is None:
                return Status.STAGNATED
        return status

    def _add(self, record: IterationRecord) -> None:
        self.history.append(record)
        if self.state.iteration % _KEEP_EVERY == 0 and _is_better(record, self.best_record):
            self.best, self.best_record = _iterate(self.state, self.programme), record
        if self.callback:
            self.callback(record)

    def end(self, status: Status) -> SolverResult:
        """Return the last iterate, or the best one if the run did not converge and that is better."""
        last = self.history[-1]
        advice = _advice(status, self.state, self.programme, self.solver.tolerance)
        is_last_best = _is_finite(last) and not _is_better(self.best_record, last)
        if status in (Status.CONVERGED, Status.SWITCHED) or is_last_best:
            best, record = _iterate(self.state, self.programme), last
        else:
            best, record = self.best, self.best_record
            advice += f"; returned is the better iterate {record.iteration} ({record.residual:.1e})"
        return SolverResult(status, advice, best, record, tuple(self.history))


def _is_better(record: IterationRecord, other: IterationRecord) -> bool:
    """Whether the residual is smaller, or the other's is no number."""
    return _is_finite(record) and (record.residual < other.residual or not _is_finite(other))


def _is_finite(record: IterationRecord) -> bool:
    return math.isfinite(record.residual) and math.isfinite(record.cost)


def _iterate(state: SolverState, programme: StagewiseProgramme) -> Iterate:
    bounds = multipliers_of(state.native, programme) if state.native.slack.size else None
    return Iterate.read_from(state.native, programme, bounds)


def _record(state: SolverState, phase: str, first: int, seconds: float) -> IterationRecord:
    e = state.evaluation
    return IterationRecord(
        iteration=first + state.iteration,
        residual=e.residual,
        increment=state.increment if state.iteration else math.nan,
        cost=e.cost,
        step_length=state.step_length,
        primal=e.primal,
        dual=e.dual,
        regularisation=state.regularisation,
        wall_time_s=seconds,
        phase=phase,
    )


def _words_for_convergence(state: SolverState, tolerance: float) -> str:
    """What of a solution is below the tolerance, and what is round-off."""
    e = state.evaluation
    if e.residual > tolerance >= _without_limits(e):
        products = f"each product of a limit's multiplier and its distance (norm {e.complementarity:.0e})"
        return f"all else is below the tolerance, and {products} as near to zero as round-off lets it come"
    if e.residual > tolerance:
        return f"the residual ({e.residual:.0e}) is round-off, since multipliers or states are large"
    if state.increment > tolerance >= state.next_increment:
        return "the residual is below the tolerance, as the next increment would be"
    if state.increment > tolerance and state.next_increment < _MUCH_LESS * state.increment:
        return "the residual is below the tolerance, as the next increment would be relative to the unknowns"
    if state.increment > tolerance:
        noise = f"the increments are round-off ({state.increment:.0e})"
        return f"the residual is below the tolerance, {noise}"
    return "residual and increment are below the tolerance"


def _advice(status: Status, state: SolverState, programme: StagewiseProgramme, tolerance: float) -> str:
    e = state.evaluation
    taken = f"{state.iteration} iteration{'' if state.iteration == 1 else 's'}"
    if status is Status.CONVERGED:
        kept = _words_for_convergence(state, tolerance)
        if state.at_minimum:
            return f"a strict local minimum: {kept}"
        return (
            "a stationary point, but not a strict minimum: the Hessian is indefinite or singular there "
            f'({kept}); start from another guess, or use globalisation = "default"'
        )
    worst = _worst(state, programme)
    if status is Status.SINGULAR:
        return f"the linear system is singular {_place(status, state, programme)}; {worst}"
    reached = f"(residual {e.residual:.1e})"
    texts = {
        Status.MAX_ITERATIONS: f"not converged in {taken} {reached}; raise "
        "solver.max_iterations, take more steps or a longer duration, or start from a better guess",
        Status.LINE_SEARCH_FAILED: f"no step makes progress any more {reached}: the goal may be out of reach "
        "in this time, or the guess too far; try a longer duration, another guess, or goal.enforce = "
        '"penalty"',
        Status.STAGNATED: f"no progress any more after {taken} {reached}; try another "
        "solver, another guess or a longer duration",
        Status.SWEEP_FAILED: f"the forward sweep fails {_place(status, state, programme)}: the guess's "
        "controls lead where no step can be solved; take more steps, another guess, or "
        '"monolithic", which needs no sweep',
        Status.SWITCHED: f"handed over after {taken}",
        Status.TIME_LIMIT: f"not converged within solver.time_limit, after {taken} {reached}; raise it, or "
        "start from a better guess",
        Status.DIVERGED: 'the iterates left the finite numbers; use globalisation = "default", a shorter '
        "step or a better guess",
        Status.INTERRUPTED: f"interrupted after {taken}; the best iterate so far",
    }
    return f"{texts[status]}; {worst}"


def _without_limits(e: Measures) -> float:
    """The residual without the products of limits' multipliers and distances."""
    return math.sqrt(max(0.0, e.residual**2 - e.complementarity**2))


def _worst(state: SolverState, programme: StagewiseProgramme) -> str:
    """Which row of the steps or of the end condition is worst; or that they hold, and what is left then."""
    e = state.evaluation
    if e.worst <= min(_HOLDS, 1e-3 * e.residual):
        return f"steps and end condition hold to {e.worst:.1e}, what is left is stationarity ({e.dual:.1e})"
    return f"largest violation: {programme.describe_row(e.worst_stage, e.worst_row)} ({e.worst:.1e})"


def _place(status: Status, state: SolverState, programme: StagewiseProgramme) -> str:
    if state.failed_stage == programme.num_steps:
        return (
            "in the end condition: its rows depend on each other or cannot be reached by the controls; "
            'enforce fewer components, or goal.enforce = "penalty"'
        )
    if state.failed_stage >= 0 and status is Status.SWEEP_FAILED:
        return programme.describe_step(state.failed_stage)
    if state.failed_stage >= 0:
        where = programme.describe_step(state.failed_stage)
        return f"{where}: singular mass matrix, redundant constraints or free control"
    return "and has not the inertia of a minimum for any shift"

"""What the phases of a strategy share: where they start, how they are run in turn, what they come to."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from mbocp._arrays import dataclass
from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.solvers.options import SolverSettings
from mbocp.solvers.protocol import Solver
from mbocp.solvers.records import Callback, IterationRecord, Phase, Status, deadline_after, time_until
from mbocp.solvers.strategies.iterating import SolverResult, StopTest, run
from mbocp.solvers.strategies.patience import Patience, time_of_iteration

if TYPE_CHECKING:
    from mbocp.solvers.nlp.interior_point import InteriorPoint


@dataclass(frozen=True)
class Start:
    """What is solved, and from where.

    Attributes
    ----------
    programme : StagewiseProgramme
    iterate : Iterate
        Guess.
    callback : callable, optional
        Sees every record.
    first : int
        Iterations before, where the records go on counting.
    label : str
        Put behind the phases' names.
    patience : Patience, optional
        Of the attempts of which this is one; None: it is the only one.
    before : SolverResult, optional
        What `auto` came to from here by Newton's method alone; it goes on with what else may help.
    """

    programme: StagewiseProgramme
    iterate: Iterate
    callback: Callback | None = None
    first: int = 0
    label: str = ""
    patience: Patience | None = None
    before: SolverResult | None = None


@dataclass(frozen=True)
class Outcome:
    """What a strategy came to.

    Attributes
    ----------
    result : SolverResult
        Of the phase that gave the result, with the history of all phases.
    phases : tuple of Phase
        In the order of their runs.
    solver : str
        Name of the solver, or solvers, for output.
    """

    result: SolverResult
    phases: tuple[Phase, ...]
    solver: str

    @property
    def iterations(self) -> int:
        """Of all phases."""
        return sum(phase.iterations for phase in self.phases)

    def with_history(self, history: Iterable[IterationRecord]) -> Outcome:
        """Return the same with the records of other runs, too."""
        return replace(self, result=replace(self.result, history=tuple(history)))

    def with_interrupt(self) -> Outcome:
        """Return the same, after which somebody pressed Ctrl-C."""
        return replace(self, result=self.result.with_interrupt())


class Phases:
    """Runs the phases of a strategy, and collects what they leave.

    Attributes
    ----------
    settings : SolverSettings
    programme : StagewiseProgramme
    guess : Iterate
    before : SolverResult, optional
        As in `Start`.
    """

    def __init__(self, start: Start, settings: SolverSettings) -> None:
        self.settings, self.guess = settings, start.iterate
        self.programme, self.callback, self.label = start.programme, start.callback, start.label
        self._begun, self.before = start.first, start.before
        self.deadline = deadline_after(settings.time_limit)
        self.patience = start.patience or Patience(is_limited=settings.time_limit is None)
        self.history: list[IterationRecord] = []
        self.phases: list[Phase] = []
        self.last: SolverResult | None = None

    def on(self, programme: StagewiseProgramme, label: str = "") -> Phases:
        """The same account for phases that solve another programme; `label` is put behind their names."""
        other = copy(self)
        other.programme, other.label = programme, label + self.label
        return other

    @property
    def first(self) -> int:
        """Iterations before the next phase, where its records go on counting."""
        return self._begun + self.taken

    @property
    def taken(self) -> int:
        """Iterations so far."""
        return sum(phase.iterations for phase in self.phases)

    @property
    def names(self) -> Sequence[str]:
        """Of the phases so far."""
        return [phase.name for phase in self.phases]

    @property
    def time_left(self) -> float | None:
        """Until the time limit [s]; None: there is none."""
        return time_until(self.deadline)

    def allowance(self, *, is_interior: bool = False) -> int | None:
        """Iterations that patience leaves to Newton's method, or to IPOPT; None: as many as it takes."""
        return self.patience.iterations(time_of_iteration(self.programme, is_interior=is_interior))

    @property
    def is_in_vain(self) -> bool:
        """Whether no further phase is to begin, as iterations or patience are used up."""
        return self.settings.is_spent(self.taken) or self.patience.is_over

    def ends_with(self, result: SolverResult) -> bool:
        """Whether no further phase is to begin after a result."""
        is_final = result.status is Status.CONVERGED or result.status.is_stopped
        return is_final or self.is_in_vain

    def run(
        self, solver: Solver[Any], name: str, iterate: Iterate, *, should_stop: StopTest | None = None
    ) -> SolverResult:
        """Run one phase; Ctrl-C before its first iterate ends it with what the phase before came to."""
        clock = time.perf_counter()
        try:
            result = run(
                solver,
                self.programme,
                iterate,
                self.callback,
                name + self.label,
                first=self.first,
                should_stop=should_stop,
                deadline=self.deadline,
                allowance=self.allowance(),
            )
        except KeyboardInterrupt:
            if self.last is None:
                raise
            result = replace(self.last.with_interrupt(), history=())
        return self._keep(result, name, clock, time_of_iteration(self.programme))

    def run_interior(self, solver: InteriorPoint, name: str, iterate: Iterate) -> SolverResult:
        """Run an interior-point solver, where it can be ended: fatrop always, IPOPT if there is a time limit.

        fatrop does not always hear Ctrl-C; IPOPT may be longer in one factorisation than it has time.
        """
        from mbocp.solvers.strategies.apart import run_apart

        clock = time.perf_counter()
        arguments = (self.programme, iterate, self.callback, name + self.label, self.first)
        is_apart = solver.name == "fatrop" or math.isfinite(self.deadline)
        result = run_apart(solver, *arguments) if is_apart else solver.run(*arguments)
        return self._keep(result, name, clock, time_of_iteration(self.programme, is_interior=True))

    def _keep(self, result: SolverResult, name: str, clock: float, each: float) -> SolverResult:
        """Add a phase to the account, that began at `clock`; its iterations take so long `each` [s]."""
        taken = sum(not record.is_guess for record in result.history)
        self.history += result.history
        self.phases.append(Phase(name + self.label, taken, time.perf_counter() - clock))
        if result.status is Status.TIME_LIMIT and math.isinf(self.deadline):
            advice = f"broken off after {taken} iterations (residual {result.record.residual:.1e})"
            result = replace(result, status=Status.STAGNATED, advice=advice)
            self.patience.end()
        self.patience.count(result, each)
        self.last = result
        return result

    def outcome(self, result: SolverResult, solver: str, told: str = "") -> Outcome:
        """Result with the history of all phases."""
        advice = f"{result.advice}; {told}" if told else result.advice
        whole = replace(result, advice=advice, history=tuple(self.history))
        return Outcome(whole, tuple(self.phases), solver)


def describe_end(result: SolverResult) -> str:
    """A phase's end in words, for the advice of a strategy."""
    taken = sum(not record.is_guess for record in result.history)
    after = f"after {taken} iteration{'' if taken == 1 else 's'} (residual {result.record.residual:.1e})"
    words = {
        Status.CONVERGED: "converged",
        Status.SWITCHED: "handed over",
        Status.INTERRUPTED: "was interrupted",
        Status.TIME_LIMIT: "ran out of time",
        Status.STAGNATED: "made no progress any more",
    }
    return f"{words.get(result.status, f'ended as {result.status}')} {after}"

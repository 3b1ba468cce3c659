"""From the name of a method to its phases: one solver, a gradient phase and a Newton phase, or `auto`."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from mbocp.programme import StagewiseProgramme
from mbocp.programme.iterate import Iterate
from mbocp.solvers.cost_unit import (
    cost_factor,
    in_own_unit,
    in_users_unit,
    record_in_users_unit,
    weighed,
)
from mbocp.solvers.fbsm_gradient import FBSMGradient, Switch
from mbocp.solvers.fbsm_newton import FBSMNewton
from mbocp.solvers.limits import why_limits_cannot_be_kept
from mbocp.solvers.monolithic import GlobalisedNewton, PureNewton
from mbocp.solvers.nlp.interior_point import InteriorPoint
from mbocp.solvers.polish import Judged, can_be_polished, meets, polisher
from mbocp.solvers.protocol import Solver
from mbocp.solvers.records import IterationRecord, Phase, Status
from mbocp.solvers.run import Callback, SolverResult, StopTest, run

__all__ = ["Methods", "Outcome", "pursue"]

_WINDOW = 40  # iterations in which `auto` wants progress from Newton's method ...
_PROGRESS = 0.5  # ... by this factor in the residual, ...
_GAIN = 0.02  # ... or by this part of the cost, ...
_FEASIBLE_PART = 0.5  # ... while violations are no more than this part of the residual
_INTERIOR_ITERATIONS = 1000
_SETTLED = (Status.CONVERGED, Status.LINE_SEARCH_FAILED)  # ends of an interior-point solver at a solution
INTERIOR_POINT = ("ipopt", "fatrop")
_STOPPED = (Status.INTERRUPTED, Status.TIME_LIMIT)  # by the user, at once or ahead
_GRADIENT_STEPS = 25  # of the gradient phases of `auto`, as in the paper's hybrids


@dataclass(frozen=True)
class Methods:
    """The solvers with the options of one problem.

    Attributes
    ----------
    method, globalisation, hessian, adjoint, loop : str
    tolerance, theta_max : float
    newton_iterations, gradient_iterations : int
    budget : int or None
        Of all phases of `auto` together.
    switch : Switch
        See `mbocp.problem.SolverOptions`.
    control_weight : float
        Unit of the Hessian's shift, see `StagewiseProgramme`.
    is_doubtful : bool
        Whether IPOPT has found the problem infeasible from another guess: `auto` does not ask it again.
    """

    method: str
    globalisation: str
    tolerance: float
    newton_iterations: int
    gradient_iterations: int
    budget: int | None
    hessian: str
    adjoint: str
    loop: str
    theta_max: float
    switch: Switch
    control_weight: float
    time_limit: float | None = None
    linear_solver: str = "auto"
    has_inequalities: bool = False
    is_doubtful: bool = False

    @classmethod
    def of(cls, options: Any, programme: StagewiseProgramme, *, has_inequalities: bool = False) -> Methods:
        """Methods with the options of a problem."""
        return cls(
            method=options.method,
            globalisation=options.globalisation,
            tolerance=options.tolerance,
            newton_iterations=options.newton_iterations,
            gradient_iterations=options.gradient_iterations,
            budget=options.max_iterations,
            hessian=options.hessian,
            adjoint=options.adjoint,
            loop=options.loop,
            theta_max=options.theta_max,
            switch=Switch(options.switch_residual, options.switch_cost, options.switch_iterations),
            control_weight=programme.control_weight,
            time_limit=options.time_limit,
            linear_solver=options.linear_solver,
            has_inequalities=has_inequalities,
        )

    def within(self, taken: int) -> Methods:
        """Methods with what is left of the budget."""
        if self.budget is None:
            return self
        left = max(1, self.budget - taken)
        return replace(self, newton_iterations=left, gradient_iterations=left)

    def solver(self, name: str, switch: Switch | None = None) -> Solver[Any]:
        """Solver of one phase; `switch` only for the gradient phase of a hybrid."""
        if name == "fbsm_bb":
            return FBSMGradient(
                self.tolerance,
                self.gradient_iterations,
                theta_max=self.theta_max,
                auxiliary=self.adjoint == "auxiliary",
                loop=self.loop,
                switch=switch,
            )
        if name == "fbsm_newton":
            return FBSMNewton(
                self.tolerance,
                self.newton_iterations,
                control_weight=self.control_weight,
                globalised=self.globalisation == "default",
                hessian=self.hessian,
                auxiliary=self.adjoint == "auxiliary",
                loop=self.loop if self.globalisation == "default" else "open",
            )
        if self.globalisation == "none":
            return PureNewton(self.tolerance, self.newton_iterations)
        words = "barrier, " if self.has_inequalities else ""
        return GlobalisedNewton(
            self.tolerance,
            self.newton_iterations,
            control_weight=self.control_weight,
            name=f"monolithic (Newton, {words}inertia correction, filter line search)",
        )


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


_ROUND_OFF = 1e-6  # residual in the unit of a cost of about 1: more is no round-off
_FINAL = (Status.INTERRUPTED, Status.TIME_LIMIT, Status.INFEASIBLE)  # another unit would not help


class _Runs:
    """Collects the runs of a strategy."""

    def __init__(
        self,
        programme: StagewiseProgramme,
        callback: Callback | None,
        first: int,
        label: str,
        time_limit: float | None,
    ) -> None:
        self.programme, self.callback, self.first, self.label = programme, callback, first, label
        self.deadline = math.inf if time_limit is None else time.perf_counter() + time_limit
        self.history: list[IterationRecord] = []
        self.phases: list[Phase] = []
        self.last: SolverResult | None = None

    @property
    def taken(self) -> int:
        """Iterations so far."""
        return sum(phase.iterations for phase in self.phases)

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
            )
        except KeyboardInterrupt:
            if self.last is None:
                raise
            result = replace(self.last.interrupted(), history=())
        return self._kept(result, name, clock)

    def interior(self, solver: InteriorPoint, name: str, iterate: Iterate) -> SolverResult:
        """Run an interior-point solver."""
        clock = time.perf_counter()
        result = solver.run(self.programme, iterate, self.callback, name + self.label, self.first)
        return self._kept(result, name, clock)

    def _kept(self, result: SolverResult, name: str, clock: float) -> SolverResult:
        taken = sum(not record.is_guess for record in result.history)
        self.history += result.history
        self.first += taken
        self.phases.append(Phase(name + self.label, taken, time.perf_counter() - clock))
        self.last = result
        return result

    def outcome(self, result: SolverResult, solver: str, told: str = "") -> Outcome:
        """Result with the history of all runs."""
        advice = f"{result.advice}; {told}" if told else result.advice
        whole = replace(result, advice=advice, history=tuple(self.history))
        return Outcome(whole, tuple(self.phases), solver)


def pursue(
    methods: Methods,
    programme: StagewiseProgramme,
    iterate: Iterate,
    callback: Callback | None = None,
    *,
    first: int = 0,
    label: str = "",
) -> Outcome:
    """Solve from one iterate, phase after phase.

    Parameters
    ----------
    methods : Methods
    first : int
        Iterations before, where the records go on counting.
    label : str
        Put behind the phases' names.
    """
    clock = time.perf_counter()
    outcome = _pursue(methods, programme, iterate, callback, first, label)
    factor = cost_factor(outcome.result.record.cost)
    if factor == 1.0 or outcome.result.status in _FINAL:
        return outcome
    limit, elapsed = methods.time_limit, time.perf_counter() - clock
    again = _in_own_unit(
        replace(methods, time_limit=None if limit is None else max(0.0, limit - elapsed)),
        programme,
        iterate,
        callback,
        first + sum(phase.iterations for phase in outcome.phases),
        label,
        factor,
    )
    is_gain = outcome.result.status is not Status.CONVERGED or again.result.status is Status.CONVERGED
    is_wrong = again.result.record.residual > _ROUND_OFF  # then the first was converged by its size alone
    return replace(
        again,
        result=replace(
            again.result if is_gain or is_wrong else outcome.result,
            history=outcome.result.history + again.result.history,
        ),
        phases=outcome.phases + again.phases,
    )


def _in_own_unit(
    methods: Methods,
    programme: StagewiseProgramme,
    iterate: Iterate,
    callback: Callback | None,
    first: int,
    label: str,
    factor: float,
) -> Outcome:
    """The same with the cost multiplied; what is seen and returned is as the user weighed it."""

    def told(record: IterationRecord) -> object:
        return callback(record_in_users_unit(record, factor)) if callback is not None else None

    outcome = _pursue(
        replace(methods, control_weight=factor * methods.control_weight),
        weighed(programme, factor),
        in_own_unit(iterate, factor),
        told,
        first,
        f" (cost times {factor:.0e}){label}",
    )
    return replace(outcome, result=in_users_unit(outcome.result, factor))


def _pursue(
    methods: Methods,
    programme: StagewiseProgramme,
    iterate: Iterate,
    callback: Callback | None,
    first: int,
    label: str,
) -> Outcome:
    runs = _Runs(programme, callback, first, label, methods.time_limit)
    if methods.method in INTERIOR_POINT:
        return runs.outcome(*_interior(methods, methods.method, iterate, runs))
    if methods.method == "auto":
        return (
            _auto_within_limits(methods, iterate, runs)
            if methods.has_inequalities
            else _auto(methods, iterate, runs)
        )
    names = methods.method.split("+")
    if len(names) == 1:
        solver = methods.solver(names[0])
        return runs.outcome(runs.run(solver, names[0], iterate), solver.name)
    gradient, newton = methods.solver(names[0], methods.switch), methods.solver(names[1])
    return _hybrid(gradient, newton, names, iterate, runs)


def _auto_within_limits(methods: Methods, iterate: Iterate, runs: _Runs) -> Outcome:
    """Monolithic Newton with its barrier while it makes progress; else IPOPT, which knows the infeasible."""
    told, begun = "", None
    if why_limits_cannot_be_kept(runs.programme) is None:
        solver = methods.solver("monolithic")
        begun = runs.run(solver, "monolithic", iterate, should_stop=_has_stalled)
        spent = methods.budget is not None and runs.taken >= methods.budget
        if spent or begun.status in (Status.CONVERGED, *_STOPPED):
            return runs.outcome(begun, f"auto: {solver.name}")
        told = f"auto: monolithic {_ended(begun)}"
        if methods.is_doubtful:
            return runs.outcome(begun, f"auto: {solver.name}", told)
    before = _names(runs.phases)
    found, title = _interior(methods, "ipopt", iterate, runs)
    title = "auto: " + " > ".join([*before, title])
    if (
        begun is not None
        and found.status is Status.STAGNATED
        and begun.record.residual < found.record.residual
    ):
        return runs.outcome(begun, title, f"{told}, ipopt {_ended(found)}")
    return runs.outcome(found, title, told)


def _interior(methods: Methods, name: str, iterate: Iterate, runs: _Runs) -> tuple[SolverResult, str]:
    """IPOPT or fatrop, and Newton's method where its end does not hold by our own measure; and a title."""
    left = None if math.isinf(runs.deadline) else max(0.0, runs.deadline - time.perf_counter())
    limit = _INTERIOR_ITERATIONS if methods.budget is None else methods.budget - runs.taken
    solver = InteriorPoint(name, methods.tolerance, limit, left, methods.linear_solver)
    found = runs.interior(solver, name, iterate)
    if found.status not in _SETTLED or not can_be_polished(runs.programme):
        return found, solver.title
    judged = Judged.of(found, runs.programme, methods.tolerance)
    if judged.error <= methods.tolerance:
        return _converged(judged.result), solver.title
    if found.status is not Status.CONVERGED:
        return found, solver.title
    return _polished(methods, judged, solver.title, runs)


def _polished(methods: Methods, judged: Judged, title: str, runs: _Runs) -> tuple[SolverResult, str]:
    """Newton's method from where an interior-point solver ended; the better of the two."""
    found, most = judged.result, methods.within(runs.taken).newton_iterations
    newton = polisher(methods.tolerance, methods.control_weight, most)
    polished = runs.run(newton, "polish", found.iterate, should_stop=meets(methods.tolerance))
    if polished.status is Status.CONVERGED or polished.record.residual <= methods.tolerance:
        return _converged(polished), title
    better = polished if polished.record.residual < found.record.residual else found
    if polished.status in _STOPPED:
        return replace(better, status=polished.status, advice=polished.advice), title
    advice = (
        f"{title} ends here by its own measure, but the optimality conditions hold to {judged.error:.1e} "
        f"alone, and Newton's method from there {_ended(polished)}: multipliers may not exist here; try "
        'another guess, or the other of "ipopt" and "fatrop"'
    )
    return replace(better, status=Status.STAGNATED, advice=advice), title


def _converged(result: SolverResult) -> SolverResult:
    advice = f"a local minimum: the optimality conditions hold (residual {result.record.residual:.1e})"
    return replace(result, status=Status.CONVERGED, advice=advice)


def _hybrid(
    gradient: Solver[Any], newton: Solver[Any], names: Sequence[str], iterate: Iterate, runs: _Runs
) -> Outcome:
    """Gradient steps, then Newton's method from where they came to, section 5.3."""
    solver = f"{gradient.name}, then {newton.name}"
    begun = runs.run(gradient, names[0], iterate)
    if begun.status in _STOPPED:
        return runs.outcome(begun, solver)
    told = "" if begun.status in (Status.SWITCHED, Status.CONVERGED) else f"{names[0]} {_ended(begun)}"
    start = iterate if begun.status is Status.SWEEP_FAILED else begun.iterate
    found = runs.run(newton, names[1], start)
    if not math.isfinite(
        found.record.cost + found.record.residual
    ):  # at once, or it would have kept a better one
        found = replace(found, iterate=begun.iterate, record=begun.record)
    return runs.outcome(found, solver, told)


def _has_stalled(history: Sequence[IterationRecord]) -> bool:
    """Whether over the last iterations neither the residual has halved nor the cost fallen by much.

    Far from a minimum the residual may stand still for long while the cost falls from step to step.
    """
    if len(history) <= _WINDOW:
        return False
    residuals = [r.residual if math.isfinite(r.residual) else math.inf for r in history]
    if min(residuals[-_WINDOW:]) <= _PROGRESS * min(residuals[:-_WINDOW]):
        return False
    before, now = history[-_WINDOW - 1], history[-1]
    is_feasible = now.primal <= max(_FEASIBLE_PART * now.residual, before.primal)
    return not (is_feasible and now.cost < before.cost - _GAIN * abs(before.cost))


def _auto(methods: Methods, iterate: Iterate, runs: _Runs) -> Outcome:
    """Monolithic Newton while it makes progress; else the hybrids; at last what had been broken off.

    Every phase says in the advice why it ended. Nothing is given up for good: where no other strategy
    succeeds, the first goes on from its best iterate.
    """
    results: list[SolverResult] = []
    told: list[str] = []

    def is_over() -> bool:
        spent = methods.budget is not None and runs.taken >= methods.budget
        return bool(results) and (spent or results[-1].status in (Status.CONVERGED, *_STOPPED))

    def attempt(name: str, start: Iterate, *, is_watched: bool = True) -> None:
        if is_over():
            return
        switch = Switch(0.0, 0.0, _GRADIENT_STEPS) if name == "fbsm_bb" else None
        solver = methods.within(runs.taken).solver(name, switch)
        results.append(
            runs.run(solver, name, start, should_stop=_has_stalled if is_watched and switch is None else None)
        )
        told.append(f"{name} {_ended(results[-1])}")

    attempt("monolithic", iterate)
    first = results[0]
    attempt("fbsm_bb", iterate)
    if not is_over() and results[-1].status is not Status.SWEEP_FAILED:
        reached = results[-1].iterate
        attempt("fbsm_newton", reached)
        attempt("monolithic", reached)
    if first.status is Status.STAGNATED:
        attempt("monolithic", first.iterate, is_watched=False)
    best = _best(results, spent=methods.budget is not None and runs.taken >= methods.budget)
    if len(results) == 1:
        return runs.outcome(best, f"auto: {methods.solver('monolithic').name}")
    return runs.outcome(best, "auto: " + " > ".join(_names(runs.phases)), "auto: " + ", ".join(told))


def _best(results: Sequence[SolverResult], *, spent: bool) -> SolverResult:
    """The converged one, which is the last; else that with the smallest residual, and why there is no better.

    `spent`: the limit of iterations is used up.
    """
    last = results[-1]
    if last.status is Status.CONVERGED:
        return last
    best = min(results, key=lambda r: r.record.residual if math.isfinite(r.record.residual) else math.inf)
    if last.status is Status.INTERRUPTED:
        return last if best is last else best.interrupted()
    if last.status is Status.TIME_LIMIT:
        return replace(best, status=last.status, advice=last.advice)
    if spent and best.status is not Status.MAX_ITERATIONS:
        reached = (
            f"not converged within solver.max_iterations (residual {best.record.residual:.1e}); raise it"
        )
        return replace(best, status=Status.MAX_ITERATIONS, advice=reached)
    return replace(best, status=last.status, advice=last.advice) if best.status is Status.SWITCHED else best


def _names(phases: Sequence[Phase]) -> list[str]:
    return [phase.name for phase in phases]


def _ended(result: SolverResult) -> str:
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

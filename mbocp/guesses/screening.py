"""Which outcome is the better one, and other minima where effort alone costs: ways tried with few steps.

With a quarter of the steps a solve takes a quarter of the time, and with a little weight on velocities it has
few minima. So ways through random configurations are solved like this, and what takes little effort then is
solved with all steps, straight from there. On arms this finds motions that cost a fraction of what lies below
the straight line.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import field, replace

import numpy as np

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.formulation import Formulation, Motion, formulate
from mbocp.formulation.end_reached import miss_of_end
from mbocp.formulation.iterates import with_robot_of
from mbocp.formulation.read_trajectory import describe_coarse_turn
from mbocp.guesses.straight_line import is_whole, line
from mbocp.guesses.ways import Way, middle_of_line, random_way, straight
from mbocp.programme import Iterate
from mbocp.robot.nodes import between
from mbocp.solvers import Outcome, SolverResult, SolverSettings, Start, Status, run_strategy
from mbocp.solvers.records import deadline_after, time_until

SAME_COST = 1e-9  # relative: the same minimum, and the earlier start has found it


def is_preferred(formulation: Formulation, new: Outcome, known: tuple[Formulation, Outcome]) -> bool:
    """Whether an outcome is better than one that is known, of the same problem or with another goal.

    The cheapest that converged, motions that the steps resolve first.
    """
    old = known[1]
    ranks = _rank(formulation, new), _rank(*known)
    if ranks[0] != ranks[1]:
        return ranks[0] < ranks[1]
    if new.result.status is not Status.CONVERGED:
        return is_better(new.result, old.result)
    cost, least = new.result.record.cost, old.result.record.cost
    return cost < least - SAME_COST * abs(least)


def status_of(formulation: Formulation, outcome: Outcome) -> Status:
    """Status of an outcome; `under_resolved` where it converged to what is no motion any more."""
    result = outcome.result
    if result.status is not Status.CONVERGED:
        return result.status
    is_resolved = describe_coarse_turn(formulation, formulation.motion_of(result.iterate)) is None
    return Status.CONVERGED if is_resolved else Status.UNDER_RESOLVED


def with_end(formulation: Formulation, outcome: Outcome) -> Outcome:
    """Outcome that says so where it ends beside the goal; at another root it has not converged."""
    result = outcome.result
    if result.status is not Status.CONVERGED:
        return outcome
    motion = formulation.motion_of(result.iterate)
    missed = miss_of_end(with_robot_of(formulation, motion), motion.qs)
    if missed is None:
        return outcome
    status = Status.OTHER_ROOT if missed.is_other_root else result.status
    return replace(outcome, result=replace(result, status=status, advice=f"{result.advice}; {missed.words}"))


def is_better(new: SolverResult, old: SolverResult) -> bool:
    """Whether one of two results that have not converged says more: another root, then `infeasible`."""
    if Status.OTHER_ROOT in (new.status, old.status):
        return old.status is not Status.OTHER_ROOT
    if Status.INFEASIBLE in (new.status, old.status):
        return old.status is not Status.INFEASIBLE
    return new.record.residual < old.record.residual


def _rank(formulation: Formulation, outcome: Outcome) -> int:
    return {Status.CONVERGED: 0, Status.UNDER_RESOLVED: 1}.get(status_of(formulation, outcome), 2)


_FEWER = 4  # steps of a trial: this part of them
_LEAST = 15  # steps of a trial; half as many turn joints too far in each
_FADING = (1e-2, 1e-3)  # of the weight "auto", one after the other: the first leaves few minima
_SMALL = (1e-3,)  # leaves more of them
_TRIALS = (  # how far a way goes to a random configuration, and the weights; far ones change more
    (0.0, _FADING),
    (0.5, _FADING),
    (1.0, _FADING),
    (0.5, _SMALL),
    (1.0, _SMALL),
    (0.5, _SMALL),
)
_FURTHER = 2 * _TRIALS[1:]  # while there is no motion that the steps resolve, as of arms with seven joints
_ROUGH = 1e-3  # tolerance of a trial: it is to find where minima are
_MOST = 40  # iterations of a trial with one weight
_MOST_AFTER = 100  # iterations with all steps
_FINER = 2  # trials that go on with all steps
_FINER_UNRESOLVED = 3  # the same while there is no motion that the steps resolve
_SAME = 1e-3  # relative: trials with the same cost are at the same minimum
_DEAR = 3.0  # times the least effort of all trials: what takes more does not go on


@dataclass(frozen=True, eq=False)
class Trial:
    """End of a solve with few steps."""

    number: int
    iterate: Iterate
    effort: float


@dataclass(eq=False)
class Screening:
    """Trials from one start, and what the best of them lead to.

    Attributes
    ----------
    formulation : Formulation
    settings : SolverSettings
        With the time that is left.
    start : Start
        Where its records go on counting, and the words behind the names of its phases.
    number : int
        Of the start among several: each tries other ways.
    runs : list of Outcome
        All solves so far, in their order, those with few steps included.
    """

    formulation: Formulation
    settings: SolverSettings
    start: Start
    number: int
    runs: list[Outcome] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._deadline = deadline_after(self.settings.time_limit)

    def best(self, known: Outcome) -> Outcome:
        """The best of what the trials lead to and of what is known."""
        coarse = with_fewer_steps(self.formulation)
        is_resolved = status_of(self.formulation, known) is Status.CONVERGED
        ways = _TRIALS if is_resolved else (*_TRIALS, *_FURTHER)
        trials = sorted(self._trials(coarse, ways), key=lambda trial: trial.effort)
        for count, trial in enumerate(trials):
            if trial.effort > _DEAR * trials[0].effort:
                break
            is_resolved = status_of(self.formulation, known) is Status.CONVERGED
            if self._is_over or count >= (_FINER if is_resolved else _FINER_UNRESOLVED):
                break
            iterate = finer(coarse, trial.iterate, self.formulation)
            end = self._solve(self.formulation, iterate, 0.0, f"from trial {trial.number}")
            if end.result.status is Status.CONVERGED and is_preferred(
                self.formulation,
                with_end(self.formulation, end),
                (self.formulation, with_end(self.formulation, known)),
            ):
                known = end
        return known

    @property
    def _is_over(self) -> bool:
        is_stopped = bool(self.runs) and self.runs[-1].result.status is Status.INTERRUPTED
        is_in_vain = self.start.patience is not None and self.start.patience.is_over
        return is_stopped or is_in_vain or time.perf_counter() > self._deadline

    def _trials(self, coarse: Formulation, ways: Sequence[tuple[float, Sequence[float]]]) -> Iterator[Trial]:
        """Ends of the trials that get there, one of those that meet on their way."""
        problem, passed = self.formulation.problem, set[tuple[float, float]]()
        middle = middle_of_line(problem)
        for number, (reach, shares) in enumerate(ways):
            rng = np.random.default_rng([problem.solver.seed, self.number, number])
            way = random_way(problem, rng, reach, middle) if reach else straight(problem)
            trial = self.trial(coarse, number, way, shares, passed)
            if trial is not None:
                yield trial

    def trial(
        self,
        coarse: Formulation,
        number: int,
        way: Way,
        shares: Sequence[float],
        passed: set[tuple[float, float]],
    ) -> Trial | None:
        """Try one way with few steps; None where it fails or comes to a minimum that has been passed."""
        iterate = line(coarse, way)
        for share in shares:
            if self._is_over:
                return None
            words = f"trial {number}, velocity weighed {share:g} of auto"
            result = self._solve(coarse, iterate, share, words).result
            iterate, cost = result.iterate, result.record.cost
            if result.status is not Status.CONVERGED or any(
                abs(cost - was) <= _SAME * abs(was) for at, was in passed if at == share
            ):
                return None
            passed.add((share, cost))
        return Trial(number, iterate, _effort(coarse, iterate))

    def _solve(self, formulation: Formulation, iterate: Iterate, share: float, words: str) -> Outcome:
        programme = formulation.programme
        options = replace(self.settings.options, method="monolithic", max_iterations=_MOST_AFTER)
        if share and programme.easing is not None:
            weighed = frozen_array(programme.theta + share * programme.easing)
            programme = replace(programme, theta=weighed)
            rough = max(options.tolerance, _ROUGH)
            options = replace(options, tolerance=rough, max_iterations=_MOST)
        first = self.start.first + sum(outcome.iterations for outcome in self.runs)
        label = f" ({words}){self.start.label}"
        outcome = run_strategy(
            replace(
                self.settings,
                options=options,
                time_limit=time_until(self._deadline),
                control_weight=formulation.programme.control_weight,
            ),
            replace(self.start, programme=programme, iterate=iterate, first=first, label=label, before=None),
        )
        self.runs.append(outcome)
        return outcome


def with_fewer_steps(formulation: Formulation, part: int = _FEWER) -> Formulation:
    """The problem with this part of its steps, for trials."""
    few = max(formulation.problem.num_steps // part, _LEAST)
    if few >= formulation.problem.num_steps:
        return formulation
    return formulate(formulation.problem.with_(num_steps=few))


def can_screen(formulation: Formulation) -> bool:
    """Whether the ways of a screening suit a problem: to a goal that is a place, past nothing in between."""
    problem = formulation.problem
    has_between = problem.phase or problem.via
    return is_whole(problem) and not has_between and problem.guess.kind in ("auto", "line")


def _effort(formulation: Formulation, iterate: Iterate) -> float:
    """Cost of the efforts alone."""
    motion = formulation.motion_of(iterate)
    weights = np.asarray(formulation.problem.cost.effort)
    return float(0.5 * motion.dts @ (motion.us**2 @ weights))


def finer(coarse: Formulation, iterate: Iterate, formulation: Formulation) -> Iterate:
    """Iterate of a formulation from one of the same problem with fewer steps.

    States are interpolated between nodes, on the manifold; controls, impulses and multipliers between the
    middles of steps. Multipliers of closed loops begin anew: they are not smooth in time. Steps have the
    lengths that the problem gives.

    Parameters
    ----------
    coarse : Formulation
        With two steps at least.
    iterate : Iterate
        Of it.
    formulation : Formulation
        Of the same robot, with the same rows and the same duration.
    """
    problem, motion = formulation.problem, coarse.motion_of(iterate)
    dts = problem.timeline.lengths()
    few, many = coarse.problem.num_steps, problem.num_steps
    nodes, share = _between(np.linspace(0.0, few, many + 1), few)
    qs = between(problem.robot, motion.qs[nodes], motion.qs[nodes + 1], share)
    vs = _interpolate(motion.vs, nodes, share)
    middles, share = _between((np.arange(many) + 0.5) * few / many - 0.5, few - 1)
    us = _interpolate(motion.us, middles, share)
    lams = _interpolate(coarse.duals_of(iterate, motion).lams, middles, share)
    made = formulation.iterate_of(Motion(qs, vs, us, dts), lams)
    if formulation.programme.kind.ny or iterate.eta.shape != made.eta.shape:
        return made
    ms = _interpolate(iterate.ms, middles, share)
    return replace(made, ms=frozen_array(ms), eta=iterate.eta)


def _between(places: Array, last: int) -> tuple[Array, Array]:
    """Number before each place and the share of the way to the next, from 0 to `last`."""
    inside = np.clip(places, 0.0, last)
    left = np.minimum(inside.astype(int), last - 1)
    return left, inside - left


def _interpolate(values: Array, left: Array, share: Array) -> Array:
    return values[left] + share[:, None] * (values[left + 1] - values[left])

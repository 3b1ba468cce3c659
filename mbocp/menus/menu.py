"""`menu`: several local optima of one problem, the cheapest first, each with a name."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import TypeVar, overload

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp._environment import available_threads
from mbocp._threads import SideBySide, Watch
from mbocp.exceptions import CompilationTimeout, ResultFileError
from mbocp.formulation import Formulation
from mbocp.formulation.formulate import formulate_with_independent_ends
from mbocp.formulation.read_trajectory import describe_coarse_turn
from mbocp.guesses.screening import SAME_COST, Screening, Trial, can_screen, finer, with_fewer_steps
from mbocp.guesses.straight_line import line
from mbocp.guesses.ways import straight
from mbocp.job import Job, settings_of
from mbocp.menus.candidates import Candidate, candidates, has_ways
from mbocp.menus.names import names_of_motions
from mbocp.problem import Problem
from mbocp.problem._checks import check_integer
from mbocp.programme.iterate import IterateRecord
from mbocp.robot import Robot
from mbocp.robot.nodes import between
from mbocp.solution import Solution
from mbocp.solution.details import StartRecord
from mbocp.solution.from_files import problem_from
from mbocp.solution.later import retold
from mbocp.solvers import Phase, Start, Status
from mbocp.solvers.records import Callback, time_until
from mbocp.strategies import strategy_for

T = TypeVar("T")

_SAME_MOTION, _SAME_COST = 0.05, 1e-3  # relative to how far a motion goes from its start, and to its cost
_SHARES = (  # of the weight on velocities in a trial, one after the other: the first leave few minima
    (1e-2, 1e-3, 1e-4),
    (1e-3, 1e-4),
    (1e-4,),
)
_COMPARED = 41  # configurations of two motions
_LONGEST, _SHOWN = 80, 5  # letters of a name in that of a file; motions in one picture
_BRIEF = 200  # iterations of a solve from a way: what takes more seldom comes to anything
_PARTS = (4, 2, 1)  # of the steps in a trial: few are quick, many are right
_TRIES = 24  # ways to try
_STARTS = 4  # of the problem's own guess, where effort alone costs: trials do not find all that these find
_TRIALS = 4  # with few steps for each way to try: they are cheap
_DEAR = 10.0  # times the least effort of all trials: what takes more does not go on


@dataclass(frozen=True, eq=False)
class Choice:
    """One local optimum.

    Attributes
    ----------
    name : str
        What differs from the others.
    solution : Solution
    ways : int
        How many of the ways that were tried lead to it.
    """

    name: str
    solution: Solution
    ways: int


@dataclass(frozen=True, eq=False)
class Menu(Sequence[Solution]):
    """Local optima of one problem, the cheapest first; `menu[0]` is the best.

    Attributes
    ----------
    problem : Problem
    choices : tuple of Choice
        Where no way leads to an optimum, the best that was found.
    tried : int
        Number of ways that were tried.
    wall_time_s : float
    """

    problem: Problem
    choices: tuple[Choice, ...]
    tried: int
    wall_time_s: float

    def __len__(self) -> int:
        return len(self.choices)

    def __repr__(self) -> str:
        rows = [
            f"{place}  {choice.solution.cost:.6g}  {choice.name}" for place, choice in enumerate(self.choices)
        ]
        return "\n".join([f"<Menu of {self.problem.name}: {len(self)} from {self.tried} ways>", *rows])

    @overload
    def __getitem__(self, place: int) -> Solution: ...
    @overload
    def __getitem__(self, place: slice) -> list[Solution]: ...
    def __getitem__(self, place: int | slice) -> Solution | list[Solution]:
        if isinstance(place, slice):
            return [choice.solution for choice in self.choices[place]]
        return self.choices[place].solution

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each."""
        return tuple(choice.name for choice in self.choices)

    @property
    def converged(self) -> bool:
        """Whether there is an optimum."""
        return self[0].converged

    def save(self, folder: str | Path) -> list[Path]:
        """Write a result for each into a folder, which is made: `1_elbow_up.h5`, ...

        Raises
        ------
        ResultFileError
            If the folder or a file cannot be written.
        """
        place, files = Path(folder), list[Path]()
        try:
            place.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ResultFileError(place, f"cannot be made: {error.strerror or error}") from error
        for number, choice in enumerate(self.choices, start=1):
            words = re.sub(r"\W+", "_", choice.name).strip("_")[:_LONGEST]
            files.append(choice.solution.save(place / f"{number}_{words}.h5"))
        return files

    def replay(self, path: str | Path | None = None) -> Path | None:
        """Show the first five at once, each in a colour of its own: as a page, or in a browser.

        Raises
        ------
        ReplayError
            As `mbocp.replay_solution`.
        """
        from mbocp.view.of_solution import replay_solution  # only for those who look at it

        first, *others = self[:_SHOWN]
        names = self.names[1:_SHOWN]
        return replay_solution(first, path, others=others, names=names)


def menu(
    problem: Problem | str | Path,
    *,
    tries: int = _TRIES,
    threads: int | None = None,
    time_limit: float | None = None,
    callback: Callback | None = None,
) -> Menu:
    """Find several local optima of a problem.

    Parameters
    ----------
    problem : Problem, str or Path
        The problem, or the path of a problem file or of a result.
    tries : int
        Ways to try, to each goal where there are several.
    threads : int, optional
        Default: one for each processor. The menu is the same.
    time_limit : float, optional
        Longest time [s], beside that of the problem.
    callback : callable, optional
        Called with every `IterationRecord`.

    Returns
    -------
    Menu
        The best is never worse than what `mbocp.solve` finds from one start; where effort alone costs, from
        four. Ctrl-C ends it with what there is.

    Raises
    ------
    MbocpError
        As `mbocp.solve`.
    InvalidValue
        If `tries` or `threads` are no positive whole numbers.
    """
    check_integer("tries", tries, 1)
    check_integer("threads", 1 if threads is None else threads, 1)
    asked = problem_from(problem)
    begun = time.perf_counter()
    job = Job.of(asked, time_limit=time_limit, callback=callback)
    search = _Search(job, tries, threads or available_threads())
    merged = _merge(asked.robot, search.run())
    names = names_of_motions(asked, [solution for solution, _ in merged])
    choices = tuple(Choice(name, *one) for name, one in zip(names, merged, strict=True))
    return Menu(asked, choices, search.tried, time.perf_counter() - begun)


@dataclass(frozen=True)
class BestOfMenu:
    """Solve as a menu does, and take the best."""

    def run(self, job: Job) -> Solution:
        """Solve from each way; the solution has a record of each."""
        begun, search = time.perf_counter(), _Search(job, _TRIES, job.problem.solver.num_threads)
        best, *others = search.run()
        for one in others:
            if not best.converged or one.cost < best.cost - SAME_COST * abs(best.cost):
                best = one
        spent = time.perf_counter() - begun
        phases = (*best.phases, Phase("other ways", 0, max(0.0, spent - best.wall_time_s)))
        best = retold(best, starts=tuple(search.records), phases=phases, wall_time_s=spent)
        if not search.is_interrupted:
            return best
        return retold(best, status=Status.INTERRUPTED, advice=f"interrupted before all ways; {best.advice}")


@dataclass(eq=False)
class _Search:
    """Solves from all candidates, side by side.

    Attributes
    ----------
    job : Job
        Its problem is solved from each.
    tries, threads : int
    tried : int
        Number of candidates.
    records : list of StartRecord
        What each comes to that is solved with all steps.
    is_interrupted : bool
        Whether somebody pressed Ctrl-C.
    """

    job: Job
    tries: int
    threads: int
    tried: int = 0
    records: list[StartRecord] = field(default_factory=list)
    is_interrupted: bool = False
    _formulations: dict[int | None, Formulation] = field(default_factory=dict)

    def run(self) -> list[Solution]:
        """Return the motions that were found, that from the problem's own guess first."""
        problem, ways = self.job.problem, list[Candidate]()
        for number, member in problem.members:
            place = number if problem.goals else None
            member = replace(member, solver=replace(member.solver, starts=1, threads=1))
            self._formulations[place] = formulate_with_independent_ends(member, self.job.deadline)[0]
            most = self.tries * (_TRIALS if _is_for_trials(self._formulations[place]) else 1)
            ways += candidates(self._formulations[place], place, most)
        self.tried = len(ways)
        ways = [way for place in self._formulations for way in self._worth_it(place, ways)]
        found = self._side_by_side(self._solve, ways)
        for number, solution in found.items():
            self.records.append(_record(solution, ways[number].place))
        first, *others = found.values()
        return [first, *(solution for solution in others if solution.converged)]

    def _worth_it(self, place: int | None, ways: Sequence[Candidate]) -> list[Candidate]:
        """Candidates of a goal; where effort alone costs, ends of trials with few steps that cost little."""
        own = [way for way in ways if way.place == place]
        formulation = self._formulations[place]
        if not _is_for_trials(formulation):
            return own
        mine = [way for way in own if way.way is not None]
        mine.append(Candidate("straight line", formulation.problem, straight(formulation.problem), place))
        coarse = [with_fewer_steps(formulation, part) for part in _PARTS]
        settings = settings_of(formulation, 1)
        start = Start(formulation.programme, line(formulation))

        def work(candidate: Candidate, number: int, watch: Watch) -> Trial | None:
            assert candidate.way is not None
            limited = replace(settings, time_limit=time_until(self.job.deadline))
            shares = _SHARES[number // 2 % len(_SHARES)]  # ways of each kind with any
            screening = Screening(formulation, limited, replace(start, callback=watch), 0)
            found = screening.trial(_of(coarse, number), number, candidate.way, shares, set())
            if screening.runs and screening.runs[-1].result.status is Status.INTERRUPTED:
                raise KeyboardInterrupt  # there is no motion yet
            return found

        trials = list(self._side_by_side(work, mine).values())
        ends = [finer(_of(coarse, trial.number), trial.iterate, formulation) for trial in trials]
        turns = [describe_coarse_turn(formulation, formulation.motion_of(end)) is not None for end in ends]
        order = sorted(range(len(trials)), key=lambda k: (turns[k], trials[k].effort))
        kept, last = [way for way in own if way.way is None], 0.0
        for k in order:
            effort = trials[k].effort
            if len(kept) == self.tries:
                break
            if effort <= _DEAR * trials[order[0]].effort and abs(effort - last) > _SAME_COST * last:
                begun = IterateRecord.of(ends[k], formulation.programme)
                kept.append(replace(mine[trials[k].number], start=begun))
                last = effort
        return kept

    def _solve(self, candidate: Candidate, number: int, watch: Watch) -> Solution:
        """The solution from one candidate; that of the problem's own guess is what `solve` finds."""
        formulation = self._formulations[candidate.place]
        problem, start = candidate.begin(formulation)
        if number == 0:
            start = self.job.start
            starts = _STARTS if _is_for_trials(formulation) else 1
            problem = replace(problem, solver=replace(problem.solver, starts=starts))
        job = replace(self.job.anew(), problem=problem, start=start, callback=watch)
        solution = strategy_for(job).run(replace(job, is_only=number > 0, brief=_BRIEF if number else 0))
        words, place = candidate.words if number else solution.guess_used, candidate.place
        if place is None:
            return retold(solution, guess_used=words)
        solution = retold(solution, guess_used=f"to goal.any.{place}, {words}")
        return retold(solution, starts=(_record(solution, place),))

    def _side_by_side(
        self, work: Callable[[Candidate, int, Watch], T | None], ways: Sequence[Candidate]
    ) -> dict[int, T]:
        """What each candidate leads to, by its place; those for which there is time."""

        def piece(number: int, watch: Watch) -> T | None:
            if number and self.job.is_late:
                return None
            try:
                return work(ways[number], number, watch)
            except CompilationTimeout:
                if number == 0:
                    raise
                return None

        row = SideBySide(piece, len(ways), self.job.callback, is_interrupted=_is_interrupted)
        try:
            row.run(self.threads)
        except KeyboardInterrupt:
            self.is_interrupted = True
            if not any(isinstance(found, Solution) for found in row.results.values()):
                raise
        self.is_interrupted |= any(_is_interrupted(found) for found in row.results.values())
        return {number: found for number, found in row.results.items() if found is not None}


def _record(solution: Solution, place: int | None) -> StartRecord:
    status, cost, iterations = solution.status, solution.cost, solution.iterations
    return StartRecord(solution.guess_used, status, cost, iterations, place)


def _is_interrupted(found: object) -> bool:
    return isinstance(found, Solution) and found.status is Status.INTERRUPTED


def _of(coarse: Sequence[Formulation], number: int) -> Formulation:
    """The formulation with the steps of a trial by its number."""
    return coarse[number // 2 // len(_SHARES) % len(coarse)]


def _is_for_trials(formulation: Formulation) -> bool:
    """Whether there are so many minima that most ways are tried with few steps."""
    problem = formulation.problem
    is_eased = formulation.programme.easing is not None and problem.clearance is None
    return is_eased and problem.solver.method == "auto" and can_screen(formulation) and has_ways(problem)


def _merge(robot: Robot, found: Sequence[Solution]) -> list[tuple[Solution, int]]:
    """Motions that differ, the cheapest first, with the number of ways that lead to each."""
    kept = list[tuple[Solution, int]]()
    for solution in sorted(found, key=lambda solution: (not solution.converged, solution.cost)):
        for place, (other, ways) in enumerate(kept):
            if _is_same(robot, solution, other):
                kept[place] = (other, ways + 1)
                break
        else:
            kept.append((solution, 1))
    return [one for one in kept if one[0].converged] or kept[:1]


def _is_same(robot: Robot, one: Solution, other: Solution) -> bool:
    """Whether two motions are so near each other that nobody tells them apart."""
    if abs(one.cost - other.cost) > _SAME_COST * abs(other.cost):
        return False
    mine, theirs = _places(robot, one), _places(robot, other)
    apart = max(_distance(robot, p, q) for p, q in zip(mine, theirs, strict=True))
    return apart <= _SAME_MOTION * max(_distance(robot, theirs[0], q) for q in theirs)


def _places(robot: Robot, solution: Solution) -> Array:
    """Configurations at shares of the duration: motions to be compared may have other steps."""
    t, at = solution.t, np.linspace(solution.t[0], solution.t[-1], _COMPARED)
    left = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    shares = (at - t[left]) / np.maximum(t[left + 1] - t[left], 1e-12)  # impacts take no time
    return between(robot, solution.qs[left], solution.qs[left + 1], shares)


def _distance(robot: Robot, q0: Array, q1: Array) -> float:
    return float(np.linalg.norm(robot.difference(q0, q1)))

"""The guesses from which a problem is solved several times."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain, count, islice

import numpy as np

from mbocp._arrays import dataclass
from mbocp.exceptions import ProblemError
from mbocp.formulation import Formulation
from mbocp.guesses.around import ways_around
from mbocp.guesses.from_solution import iterate_from_solution
from mbocp.guesses.make import explain_none_made, guess_candidates, kinds_in_turn, make_guess
from mbocp.guesses.straight_line import drive_line, line, may_take_longer
from mbocp.guesses.ways import Way, branch_ways, random_way, turn_ways
from mbocp.job import Warm
from mbocp.problem import Guess
from mbocp.programme import Iterate
from mbocp.programme.iterate import IterateRecord
from mbocp.solution import Solution
from mbocp.solution.rest import Rest

_MAX_BRANCHES = 4  # lines to other configurations at the goal, where one start alone fails
_MAX_AROUND = 3  # other ways around obstacles, where one start alone fails
_SLOWER = (1.5, 2.5)  # times as long as the line where the duration is free and one start alone fails
_MAX_FAILED = 8  # guesses that cannot be made, after which no more are tried

_Maker = Callable[[float], tuple[Iterate, str]]  # of a deadline


@dataclass(frozen=True, eq=False)
class StartGuess:
    """A guess, and words for it.

    Attributes
    ----------
    kind : str
        "" for those that a user cannot name.
    words : str
    iterate : Iterate
    """

    kind: str
    words: str
    iterate: Iterate


def start_guesses(formulation: Formulation, warm_start: Warm, deadline: float = math.inf) -> list[StartGuess]:
    """As many guesses as the problem asks for, `solver.starts`, or as can be made.

    First the warm start or the problem's own guess, then lines to other configurations with frames at the
    goal, then other ways around obstacles, then the other kinds that suit the problem, then ways on which a
    joint turns the other way around, then ways through random configurations.

    Raises
    ------
    ProblemError
        If the first one, asked for by name, cannot be made.
    """
    wanted = formulation.problem.solver.num_starts
    found: list[StartGuess] = []
    failed: dict[str, ProblemError] = {}
    for kind, make in _makers(formulation, warm_start):
        try:
            iterate, words = make(deadline)
        except ProblemError as error:
            if formulation.problem.guess.kind == kind:
                raise
            failed[kind or f"way {len(failed) + 1}"] = error
        else:
            found.append(StartGuess(kind, words, iterate))
        if len(found) == wanted or len(failed) == _MAX_FAILED:
            break
    if not found:
        raise explain_none_made(failed)
    return found


def further_kinds(formulation: Formulation, tried: list[StartGuess]) -> Iterator[StartGuess]:
    """Guesses of the kinds that suit the problem and have not been tried."""
    known = {guess.kind for guess in tried}
    for kind in _kinds(formulation):
        if kind not in known:
            try:
                iterate, words = make_guess(kind, formulation)
            except ProblemError:
                continue
            yield StartGuess(kind, words, iterate)


def guesses_in_turn(formulation: Formulation, warm_start: Warm) -> Iterator[tuple[str, _Maker]]:
    """What to call each guess, and what makes it, of those to try until one leads to a solution.

    The warm start alone, or the problem's own kind of guess. Where that was left to mbocp, the line follows
    over longer times, if they are free, then lines to other configurations with frames at the goal, other
    ways around obstacles, and the other kinds that suit the problem; after a saved solution these kinds.
    """
    if warm_start is not None:
        yield "warm start", partial(_warm, formulation, warm_start)
        return
    candidates = kinds_in_turn(formulation.problem)
    own = next(candidates)
    yield own, partial(make_guess, own, formulation)
    if formulation.problem.guess.kind == "auto":
        for times in _SLOWER:
            if own == "line" and may_take_longer(formulation.problem, times):
                yield f"line, {times:g} times as long", partial(_slow, formulation, times)
        for words, way in islice(branch_ways(formulation.problem), _MAX_BRANCHES):
            yield words, partial(_along, formulation, words, way)
        for words, way in ways_around(formulation.problem, _MAX_AROUND):
            yield words, partial(_along, formulation, words, way)
    for kind in _kinds(formulation)[1:] if own == "solution" else candidates:
        yield kind, partial(make_guess, kind, formulation)


def last_guesses(formulation: Formulation, warm_start: Warm) -> Iterator[tuple[str, _Maker]]:
    """What is left where no guess that suits the problem can be made: to stay at the start."""
    kinds = _kinds(formulation)
    if warm_start is None and formulation.problem.guess.kind == "auto" and "hold" not in kinds:
        yield "hold", partial(make_guess, "hold", formulation)


def _makers(formulation: Formulation, warm_start: Warm) -> Iterator[tuple[str, _Maker]]:
    if warm_start is not None:
        yield "warm start", partial(_warm, formulation, warm_start)
    own, *others = _kinds(formulation)
    yield own, partial(make_guess, own, formulation)
    for words, way in branch_ways(formulation.problem):
        yield "", partial(_along, formulation, words, way)
    for words, way in ways_around(formulation.problem, formulation.problem.solver.num_starts):
        yield "", partial(_along, formulation, words, way)
    for kind in others:
        yield kind, partial(make_guess, kind, formulation)
    for words, way in chain(turn_ways(formulation), _random_ways(formulation)):
        yield "", partial(_along, formulation, words, way)


def _warm(
    formulation: Formulation, start: Solution | Rest | IterateRecord, deadline: float
) -> tuple[Iterate, str]:
    if isinstance(start, IterateRecord):
        return start.into(formulation.programme), "what came before"
    solution, at = (start.solution, start.at) if isinstance(start, Rest) else (start, None)
    return iterate_from_solution(solution, formulation, at), "warm start from a solution"


def _kinds(formulation: Formulation) -> tuple[str, ...]:
    """The problem's own kind, then those that suit the problem."""
    problem = formulation.problem
    own = guess_candidates(problem)
    suited = guess_candidates(problem.with_(guess=Guess())) if problem.guess.kind != "auto" else ()
    return (*own, *(kind for kind in suited if kind not in own))


def _random_ways(formulation: Formulation) -> Iterator[tuple[str, Way]]:
    problem = formulation.problem
    for number in count(1):
        rng = np.random.default_rng([problem.solver.seed, number])
        yield f"line through random configuration {number}", random_way(problem, rng)


def _slow(formulation: Formulation, times: float, deadline: float) -> tuple[Iterate, str]:
    return line(formulation, None, deadline, times), f"straight line over {times:g} times as long"


def _along(formulation: Formulation, words: str, way: Way, deadline: float) -> tuple[Iterate, str]:
    if formulation.problem.robot.drives:
        return drive_line(formulation, way), words
    return line(formulation, way, deadline), words

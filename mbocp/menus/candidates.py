"""Ways from which a menu is solved: where a goal can be reached, and how a robot can get there.

First the problem's own guess, then lines to all other configurations with frames at the goal. Then, in
turn, one of each: lines on which a joint turns the other way around; ways past obstacles on either side, and
around them; where there are none, lines on which one joint goes first or last, and ways towards random
configurations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, count, islice

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import ProblemError
from mbocp.formulation import Formulation, formulate
from mbocp.guesses.around import ways_around
from mbocp.guesses.make import kinds_in_turn, make_guess
from mbocp.guesses.starts import start_guesses
from mbocp.guesses.straight_line import drive_line, is_whole, line
from mbocp.guesses.ways import Way, branch_ways, middle_of_line, random_way, through, turn_ways
from mbocp.job import Warm
from mbocp.problem import Guess, Problem
from mbocp.programme.iterate import IterateRecord
from mbocp.robot.collision.obstacle import Obstacle
from mbocp.robot.joints import joint_kind, velocity_slice

_RESTARTS = 100  # of the search for configurations at the goal: an arm of six joints has eight
_AROUND, _SWINGS = 4, 3  # ways around obstacles; joints that go first or last
_MOVES = 0.3  # [rad, m] that such a joint has to go at least
_REACHES = (0.5, 1.0)  # of ways to random configurations, one after the other
_ROOM, _TRIES = 0.1, 10  # [m] beside an obstacle; random configurations of a search for a place there
_CORNERS = 20  # configurations that say a way


@dataclass(frozen=True, eq=False)
class Candidate:
    """A way, and the problem of it.

    Attributes
    ----------
    words : str
    problem : Problem
        With one goal.
    way : Way, optional
        None: the problem's own guess.
    place : int, optional
        Of the goal among several.
    start : IterateRecord, optional
        Where the solve begins, of a problem that ways do not suit.
    """

    words: str
    problem: Problem
    way: Way | None = None
    place: int | None = None
    start: IterateRecord | None = None

    def begin(self, formulation: Formulation) -> tuple[Problem, Warm]:
        """The problem to solve, and its warm start."""
        problem, way = self.problem, self.way
        if way is None or self.start is not None:
            return problem, self.start
        if problem.clearance is None:
            make = drive_line if problem.robot.drives else line
            return problem, IterateRecord.of(make(formulation, way), formulation.programme)
        qs = way(problem.q_start, np.linspace(0.0, 1.0, _CORNERS))
        goal = replace(problem.goal, q=qs[-1])
        return replace(problem, goal=goal, guess=Guess(kind="way", q=qs[1:-1])), None


def candidates(formulation: Formulation, place: int | None, most: int) -> list[Candidate]:
    """Up to `most` ways of a problem with one goal; its own guess is the first."""
    problem = formulation.problem
    own = Candidate("the problem's own guess", problem, None, place)
    if not has_ways(problem):
        return [own, *_other_guesses(formulation, place, most)]
    if problem.clearance is None:
        others = (_swings(problem), _random_ways(problem))
    else:  # random ways lead through obstacles
        others = (_sides(problem), ways_around(problem, _AROUND))
    ways = chain(branch_ways(problem, _RESTARTS), _alternate([turn_ways(formulation), *others]))
    found = (Candidate(words, problem, way, place) for words, way in ways)
    kinds = _other_kinds(formulation, place) if formulation.programme.easing is not None else ()
    return [own, *islice(chain(kinds, found), most - 1)]


def has_ways(problem: Problem) -> bool:
    """Whether a way from start to goal is a guess for the whole motion."""
    timeline = problem.timeline
    is_plain = not timeline.waypoints and timeline.switches is None and timeline.is_even
    return is_plain and is_whole(problem) and problem.guess.kind in ("auto", "line")


def _other_kinds(formulation: Formulation, place: int | None) -> Iterator[Candidate]:
    """The other kinds of guess that suit a problem."""
    for kind in islice(kinds_in_turn(formulation.problem), 1, None):
        try:
            iterate, words = make_guess(kind, formulation)
        except ProblemError:
            continue
        start = IterateRecord.of(iterate, formulation.programme)
        yield Candidate(words, formulation.problem, None, place, start)


def _other_guesses(formulation: Formulation, place: int | None, most: int) -> Iterator[Candidate]:
    """Guesses of several starts, where ways do not suit."""
    problem = formulation.problem
    asked = formulate(problem.with_(solver=replace(problem.solver, starts=most)))
    try:
        found = start_guesses(asked, None)
    except ProblemError:  # the problem's own guess says so, too
        return
    for guess in found[1:]:
        start = IterateRecord.of(guess.iterate, formulation.programme)
        yield Candidate(guess.words, problem, None, place, start)


def _alternate(kinds: Sequence[Iterator[tuple[str, Way]]]) -> Iterator[tuple[str, Way]]:
    """One of each kind, then the next of each."""
    left = list(kinds)
    while left:
        for kind in list(left):
            found = next(kind, None)
            if found is None:
                left.remove(kind)
            else:
                yield found


def _sides(problem: Problem) -> Iterator[tuple[str, Way]]:
    """Lines in two legs that bring the tool past each obstacle: left of it, right of it, above it."""
    robot, tool = problem.robot, tool_of(problem)
    middle = middle_of_line(problem)
    for obstacle in problem.obstacle:
        if not obstacle.stands:
            continue
        centre, half = box_around(obstacle)
        start, end = (robot.frame_placement(tool, q).translation for q in (problem.q_start, problem.goal.q))
        left = np.cross([0.0, 0.0, 1.0], end - start)
        length = float(np.linalg.norm(left))
        if length < _MOVES * _ROOM:
            continue
        aside = left / length * (float(np.linalg.norm(half[:2])) + _ROOM)
        level = np.array([*centre[:2], 0.5 * (start[2] + end[2])])
        above = np.array([*centre[:2], centre[2] + half[2] + _ROOM])
        for words, place in (("left of", level + aside), ("right of", level - aside), ("above", above)):
            found = robot.inverse_kinematics({"name": tool, "position": place}, middle, restarts=_TRIES)
            if found.reached:
                corner = through(robot, [np.asarray(found.q), np.asarray(problem.goal.q)])
                yield f"line {words} {obstacle.name}", corner


def _swings(problem: Problem) -> Iterator[tuple[str, Way]]:
    """Lines in two legs: one joint goes first, or last, of those that go the farthest."""
    robot = problem.robot
    if robot.nc:
        return
    ahead, model = robot.difference(problem.q_start, problem.goal.q), robot.model
    joints = [joint for joint in range(1, model.njoints) if joint_kind(model, joint).v]
    lengths = {joint: float(np.linalg.norm(ahead[velocity_slice(model, joint)])) for joint in joints}
    far = sorted((joint for joint in joints if lengths[joint] > _MOVES), key=lambda joint: -lengths[joint])
    for joint in far[:_SWINGS] if len(far) > 1 else ():
        alone, at = np.zeros(robot.nv), velocity_slice(model, joint)
        alone[at] = ahead[at]
        for words, leg in (("first", alone), ("last", ahead - alone)):
            corner = robot.integrate(problem.q_start, leg)
            yield (
                f"line, {model.names[joint]} goes {words}",
                through(robot, [corner, np.asarray(problem.goal.q)]),
            )


def _random_ways(problem: Problem) -> Iterator[tuple[str, Way]]:
    middle = middle_of_line(problem)
    for number in count(1):
        rng, reach = np.random.default_rng([problem.solver.seed, number]), _REACHES[number % 2]
        yield f"line through random configuration {number}", random_way(problem, rng, reach, middle)


def tool_of(problem: Problem) -> str:
    """The frame that is to reach the goal, or leaves a trace; else the last one."""
    for names in ([pose.name for pose in problem.goal.poses], problem.robot.trace_frames):
        if names:
            return str(names[0])
    return str(problem.robot.frame_names[-1])


def box_around(obstacle: Obstacle) -> tuple[Array, Array]:
    """Centre and half the sides of a box around an obstacle, along its frame's axes [m]."""
    shape, place = obstacle.geometry, obstacle.placement
    shape.computeLocalAABB()
    low, high = np.asarray(shape.aabb_local.min_), np.asarray(shape.aabb_local.max_)
    centre = place.translation + place.rotation @ (0.5 * (low + high))
    return centre, np.abs(place.rotation) @ (0.5 * (high - low))

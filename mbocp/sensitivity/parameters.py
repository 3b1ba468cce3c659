"""Parameters that derivatives are taken in, each kind by its words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import ProblemError
from mbocp.formulation import Formulation
from mbocp.formulation.layout import places
from mbocp.problem import Problem
from mbocp.problem.limits import LIMITS
from mbocp.sensitivity.change import Change, ProblemNumbers, change_along, has_plain_numbers, says_all
from mbocp.sensitivity.of_ends import GoalOfJoints, StartNumbers, has_chord
from mbocp.sensitivity.of_frames import GoalOfFrame
from mbocp.sensitivity.of_robot import NumberByWord, NumbersOfRobot, PayloadNumbers
from mbocp.terms.cost import RunningTerm, WeightedCost
from mbocp.terms.kinds import Tracking

_SIDES = ("lower", "upper")
_LITTLE = 2.0**-15  # by which a number is moved to see what moves with it


@dataclass(frozen=True, eq=False)
class Weight(ProblemNumbers):
    """Weights of a term of the cost, in which it is linear."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Those of the terms that the functions have, of problems whose phases have none of their own."""
        problem, signature = formulation.problem, formulation.pieces.signature
        if not problem.weight_shares:
            for term in signature.cost:
                if isinstance(term, WeightedCost):
                    yield f"cost.{term.key}"
            if problem.cost.tracking > 0.0 and any(isinstance(term, Tracking) for term in signature.cost):
                yield "cost.tracking"
        if problem.cost.terminal > 0.0:
            yield "cost.terminal"

    @property
    def names(self) -> tuple[str, ...]:
        """What is weighed."""
        robot, over = self.problem.robot, ""
        if isinstance(self._term, WeightedCost):
            over = self._term.over
        labels = {"u": robot.u_labels, "v": robot.v_labels}.get(over)
        return (self.word,) if labels is None else tuple(label.name for label in labels)

    @property
    def value(self) -> Array:
        """Weights; one number where all is weighed alike."""
        weights = np.asarray(self.problem.cost.weight(self._key), dtype=np.float64)
        is_one = self.names == (self.word,)
        return weights.reshape(()) if is_one else np.array(np.broadcast_to(weights, len(self.names)))

    def put(self, problem: Problem, value: Array) -> Problem:
        """With others."""
        weights = np.array(value) if np.ndim(value) else float(value)
        return replace(problem, cost=problem.cost.with_weights({self._key: weights}))

    @property
    def _key(self) -> str:
        return self.word.removeprefix("cost.")

    @property
    def _term(self) -> RunningTerm | None:
        terms = self.formulation.pieces.signature.cost
        return next((term for term in terms if getattr(term, "key", "") == self._key), None)

    def change(self) -> Change:
        """Of the weights among the parameters."""
        found, layout, programme = self._none, self.formulation.pieces.parameters, self.formulation.programme
        if self.word == "cost.terminal":
            is_weight = programme.terminal_weights
            found.rho_terminal[0, is_weight] = programme.rho_terminal[is_weight] / self.problem.cost.terminal
            return found
        at, term = places(layout.theta), self._term
        for name in term.weights if term is not None else ():
            if self.word == "cost.tracking":
                found.theta[0, at[name]] = programme.theta[at[name]] / self.problem.cost.tracking
            else:
                found.theta[:, at[name]] = np.eye(len(self.names))
        return found


@dataclass(frozen=True, eq=False)
class Limit(ProblemNumbers):
    """One side of limits; they pull where they are active."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Those that are finite, of problems whose phases have none of their own."""
        problem = formulation.problem
        if problem.has_limits_of_phases:
            return
        for letter, key in LIMITS.items():
            for side in _SIDES:
                if np.isfinite(getattr(problem.limits, f"{letter}_{side}")).any():
                    yield f"{key}.{side}"

    @property
    def _field(self) -> str:
        key, _, side = self.word.rpartition(".")
        return f"{next(letter for letter, name in LIMITS.items() if name == key)}_{side}"

    @property
    def names(self) -> tuple[str, ...]:
        """What is limited."""
        robot, value = self.problem.robot, getattr(self.problem.limits, self._field)
        letter = self._field.partition("_")[0]
        labels = {"q": robot.q_labels, "v": robot.v_labels, "u": robot.u_labels}.get(letter)
        if labels is None:
            labels = robot.u_labels if len(value) == robot.nu else robot.v_labels
        return tuple(label.name for label in labels)

    def change(self) -> Change:
        """Of bounds of the same numbers, if these are all; else of what formulating anew makes of each."""
        value, problem = self.value, self.problem
        found = self._of_bounds()
        if has_plain_numbers(self.formulation):
            return found
        looser = 1.0 if self._field.endswith("upper") else -1.0
        steps = looser * np.linspace(_LITTLE, 2.0 * _LITTLE, len(value))
        if says_all(self.formulation, found, steps, self.put(problem, value + steps)):
            return found
        scales = np.where(np.isfinite(value) & (value != 0.0), np.abs(value), 1.0)  # powers may go with it
        is_finite = np.isfinite(value)
        moves = np.diag(scales)[is_finite]
        moved = change_along(
            self.formulation, *(lambda size, by=by: self.put(problem, value + size * by) for by in moves)
        )
        return moved.along(np.eye(len(value))[:, is_finite] / scales[is_finite])

    def _of_bounds(self) -> Change:
        """Of bounds of coordinates, of speeds, and of controls, of which steps may have several values."""
        found, at = self._none, self.formulation.layout
        letter, _, side = self._field.partition("_")
        columns, numbers = list[int](), list[int]()  # of states and controls, and which number is theirs
        if letter == "q":
            for part in self.formulation.space.parts:
                count = min(part.at_z.stop - part.at_z.start, part.at_q.stop - part.at_q.start)
                columns += range(part.at_z.start, part.at_z.start + count)
                numbers += range(part.at_q.start, part.at_q.start + count)
        elif letter == "v":
            numbers = list(range(min(at.ns, len(self.names))))
            columns = [at.s.start + k for k in numbers]
        elif letter == "u":
            columns = list(range(at.nx, at.nx + at.num_own))
            numbers = [k % len(self.names) for k in range(at.num_own)]
        pairs = zip(columns, numbers, strict=True)
        bounds = getattr(self.formulation.programme.bounds, side)
        of_bounds = np.zeros(found.lower.shape)
        for column, k in pairs:
            of_bounds[k, np.isfinite(bounds[:, column]), column] = 1.0
        return replace(found, **{side: of_bounds})

    @property
    def value(self) -> Array:
        """The bounds, infinite where there are none."""
        return np.array(getattr(self.problem.limits, self._field))

    def put(self, problem: Problem, value: Array) -> Problem:
        """With others."""
        return replace(problem, limits=replace(problem.limits, **{self._field: np.array(value)}))


@dataclass(frozen=True, eq=False)
class Duration(ProblemNumbers):
    """The given duration, of which all steps are equal shares."""

    scales_time = True

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Where the only lengths of steps are its shares."""
        problem = formulation.problem
        timeline = problem.timeline
        is_one = len(timeline.phases) == 1 and not (timeline.impacts or timeline.has_unequal_lengths)
        has_times = timeline.has_free_lengths or any(path.span.has_times for path in problem.path)
        if is_one and not (has_times or problem.limits_within or has_chord(problem)):
            yield "horizon.duration"

    @property
    def names(self) -> tuple[str, ...]:
        """The duration."""
        return (self.word,)

    def change(self) -> Change:
        """Of the length of a step, if that is all; else of all that depends on it or tells the time."""
        T, problem, found = self.problem.duration, self.problem, self._none
        found.theta[0, places(self.formulation.pieces.parameters.theta)["dt"]] = problem.dt / T
        if has_plain_numbers(self.formulation):
            return found
        if says_all(self.formulation, found, np.array([_LITTLE * T]), self.put(problem, T * (1.0 + _LITTLE))):
            return found
        moved = change_along(self.formulation, lambda size: self.put(problem, T * (1.0 + size)))
        return moved.along(np.array([[1.0 / T]]))

    @property
    def value(self) -> Array:
        """The duration."""
        return np.array(self.problem.duration)

    def put(self, problem: Problem, value: Array | float) -> Problem:
        """With another one."""
        timeline, duration = problem.timeline, float(value)
        phases = tuple(replace(phase, duration=duration) for phase in timeline.phases)
        return replace(problem, timeline=replace(timeline, duration=duration, phases=phases))


PARAMETERS: tuple[type[ProblemNumbers], ...] = (
    StartNumbers,
    GoalOfJoints,
    GoalOfFrame,
    Weight,
    Limit,
    Duration,
    PayloadNumbers,
    NumbersOfRobot,
    NumberByWord,
)


def parameters_of(formulation: Formulation, wrt: Sequence[str]) -> list[ProblemNumbers]:
    """Parameters by their words.

    Raises
    ------
    ProblemError
        If the problem has none of a word, or derivatives in it are not supported.
    """
    kinds: dict[str, type[ProblemNumbers]] = {}
    for kind in PARAMETERS:
        kinds |= dict.fromkeys(kind.words(formulation), kind)
        if wrt and kinds.keys() >= set(wrt):
            break
    for word in wrt or ("",):
        if word not in kinds:
            raise ProblemError(
                f"wrt: {word!r} is no parameter of this problem that derivatives are known in; it has "
                f"{', '.join(kinds)}"
            )
    return [kinds[word](formulation, word) for word in dict.fromkeys(wrt)]

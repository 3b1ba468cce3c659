"""Parameters that derivatives are taken in, each kind by its words."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.formulation import Formulation
from mbocp.formulation.gains import tangents
from mbocp.formulation.layout import places
from mbocp.formulation.parameters import NUMBERS
from mbocp.integrators import VELOCITY_TAU
from mbocp.problem import Problem
from mbocp.problem.coordinates import COORDINATES
from mbocp.problem.limits import LIMITS
from mbocp.robot.named_numbers import number_of, numbers_behind, put
from mbocp.robot.payload import INERTIA_KEYS
from mbocp.sensitivity.numbers import Change, change_along
from mbocp.terms import FrameEnd, FrameGoal, RunningTerm, Tracking, Weighted

_SIDES = ("lower", "upper")
_SAME = 1e-9  # [rad, m]


@dataclass(frozen=True, eq=False)
class Parameter(ABC):
    """Some numbers of a problem.

    Attributes
    ----------
    formulation : Formulation
    word : str
        What it is called, as in a problem file where there is a key.
    """

    formulation: Formulation
    word: str

    scales_time: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Words of this kind that a problem has."""

    @property
    @abstractmethod
    def names(self) -> tuple[str, ...]:
        """What each of the numbers is."""

    @abstractmethod
    def change(self) -> Change:
        """What a unit of each makes of the programme's numbers."""

    @property
    def problem(self) -> Problem:
        """That of the formulation."""
        return self.formulation.problem

    @property
    def _none(self) -> Change:
        return Change.none(self.formulation.programme, len(self.names))


def _moves(problem: Problem, q: Array) -> Array:
    """Directions along which a configuration moves with each number, a row each: as far as loops allow it."""
    if not problem.robot.nc:
        return np.eye(problem.robot.nv)
    basis = problem.free_at_end(q)
    found: Array = basis @ basis.T
    return found


def _is_plain(problem: Problem) -> bool:
    """Whether states are (q, v) of joints, all of them unknowns."""
    return COORDINATES[problem.coordinates].has_joint_states and not problem.robot.drives


def _begins_with_a_chord(problem: Problem) -> bool:
    """Whether the first velocity is not the given one, but fits the first step."""
    has_ties = problem.robot.nc or not COORDINATES[problem.coordinates].has_joint_states
    return VELOCITY_TAU.get(problem.scheme) == 0.0 and bool(has_ties)


@dataclass(frozen=True, eq=False)
class Start(Parameter):
    """Configuration or velocity at the start; configurations move in the tangent space."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Both, unless the start is found with the motion; drives leave no free choice of velocities."""
        problem = formulation.problem
        if problem.start_free is not None or problem.goal.periodic is not None:
            return
        if not (problem.robot.drives and problem.v_start.any()):
            yield "start.q"
        if not problem.robot.drives:
            yield "start.v"

    @property
    def names(self) -> tuple[str, ...]:
        """Tangent directions."""
        return tuple(label.name for label in self.problem.robot.v_labels)

    def change(self) -> Change:
        """Of the given state alone."""
        formulation, problem = self.formulation, self.problem
        moves, is_q = _moves(problem, problem.q_start), self.word == "start.q"
        if _begins_with_a_chord(problem) or not _is_plain(problem):
            changes = [change_along(formulation, partial(self._moved, move)) for move in moves]
            return Change.joined(changes)
        found, at = self._none, formulation.layout
        if is_q:
            found.start[:, : at.nw] = moves @ tangents(formulation, formulation.programme.x_start[None])[0].T
        else:
            found.start[:, at.ds] = moves
        return found

    def _moved(self, move: Array, size: float) -> Problem:
        problem = self.problem
        if self.word == "start.v":
            return replace(problem, v_start=problem.v_start + size * move)
        return replace(problem, q_start=problem.robot.integrate(problem.q_start, size * move))


@dataclass(frozen=True, eq=False)
class GoalOfJoints(Parameter):
    """Configuration, and velocity or momentum, at the end; configurations move in the tangent space."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Those that the goal asks for."""
        goal = formulation.problem.goal
        if goal.enforce == "none" or goal.periodic is not None:
            return
        if goal.q_active.any() and not _tracks_goal(formulation.problem):
            yield "goal.q"
        if goal.rate_active.any():
            yield f"goal.{goal.rate}"

    @property
    def names(self) -> tuple[str, ...]:
        """Tangent directions, or components."""
        robot = self.problem.robot
        labels = robot.p_labels if self.word == "goal.p" else robot.v_labels
        return tuple(label.name for label in labels)

    def change(self) -> Change:
        """Of numbers of the end."""
        formulation, problem = self.formulation, self.problem
        is_q = self.word == "goal.q"
        moves = np.eye(problem.robot.nv) if self.word == "goal.p" else _moves(problem, problem.goal.q)
        has_ties = problem.robot.nc or problem.timeline.switches is not None  # of which projections are made
        if has_ties or not _is_plain(problem):
            changes = [change_along(formulation, partial(self._moved, move)) for move in moves]
            return Change.joined(changes)
        found, space = self._none, formulation.pieces.joints
        at = places(formulation.pieces.parameters.terminal)
        if is_q:
            z = space.coordinates(np.asarray(problem.goal.q)[None])[0]
            found.rho_terminal[:, at["q"]] = space.tangents(z[None])[0].T
        else:
            found.rho_terminal[:, at["rate"]] = moves
        return found

    def _moved(self, move: Array, size: float) -> Problem:
        problem, goal = self.problem, self.problem.goal
        if self.word == "goal.q":
            moved = replace(goal, q=problem.robot.integrate(goal.q, size * move))
        else:
            moved = replace(goal, value=goal.value + size * move)
        return replace(problem, goal=moved)


def _tracks_goal(problem: Problem) -> bool:
    """Whether the running cost draws the motion to the goal, which it then moves with."""
    cost, goal, robot = problem.cost, problem.goal, problem.robot
    weighed = goal.q_active & (np.asarray(cost.tracking_weights)[: robot.nv] > 0.0)
    if cost.tracking == 0.0 or not weighed.any() or cost.target_q.ndim == 2:
        return False
    return bool(np.abs(robot.difference(cost.target_q, goal.q))[weighed].max() < _SAME)


@dataclass(frozen=True, eq=False)
class GoalOfFrame(Parameter):
    """Position or orientation of a frame at the end; orientations turn about the axes that are asked for."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Those that the goal asks for, without tolerances."""
        for goal in {goal.name: goal for end in _frame_ends(formulation) for goal in end.goals}.values():
            if goal.target.coordinates.size:
                yield f"goal.frame.{goal.name}.position"
            if goal.target.orientation is not None:
                yield f"goal.frame.{goal.name}.orientation"

    @property
    def names(self) -> tuple[str, ...]:
        """Axes."""
        if self.word.endswith(".position"):
            return tuple("xyz"[i] for i in self._goal.target.coordinates)
        return ("x", "y", "z")

    @property
    def _goal(self) -> FrameGoal:
        name = self.word.split(".", 2)[2].rpartition(".")[0]
        return next(goal for end in _frame_ends(self.formulation) for goal in end.goals if goal.name == name)

    def change(self) -> Change:
        """Of numbers of the end, which are linear in those of a pose."""
        found, goal = self._none, self._goal
        at = places(self.formulation.pieces.parameters.terminal)
        for end in _frame_ends(self.formulation):
            for k, move in enumerate(self._moves(goal)):
                for key, numbers in end.numbers_at(goal.name, move).items():
                    if numbers.any():  # of a position alone the rotation of zeros says nothing
                        found.rho_terminal[k, at[key]] = numbers
        return found

    def _moves(self, goal: FrameGoal) -> Iterator[Array]:
        """Derivatives of the pose's matrix."""
        if self.word.endswith(".position"):
            for i in goal.target.coordinates:
                yield np.eye(3)[i]
            return
        for axis in np.eye(3):
            move = np.zeros((4, 4))
            move[:3, :3] = goal.target.rotation @ np.cross(np.eye(3), axis)
            yield move


def _frame_ends(formulation: Formulation) -> list[FrameEnd]:
    return [end for end in formulation.pieces.signature.ends if isinstance(end, FrameEnd)]


@dataclass(frozen=True, eq=False)
class Weight(Parameter):
    """Weights of a term of the cost, in which it is linear."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Those of the terms that the functions have, of problems whose phases have none of their own."""
        problem, signature = formulation.problem, formulation.pieces.signature
        if not problem.weight_shares:
            for term in signature.cost:
                if isinstance(term, Weighted):
                    yield f"cost.{term.key}"
            if problem.cost.tracking > 0.0 and any(isinstance(term, Tracking) for term in signature.cost):
                yield "cost.tracking"
        if problem.cost.terminal > 0.0:
            yield "cost.terminal"

    @property
    def names(self) -> tuple[str, ...]:
        """What is weighed."""
        robot, over = self.problem.robot, ""
        if isinstance(self._term, Weighted):
            over = self._term.over
        labels = {"u": robot.u_labels, "v": robot.v_labels}.get(over)
        return (self.word,) if labels is None else tuple(label.name for label in labels)

    @property
    def _term(self) -> RunningTerm | None:
        key = self.word.removeprefix("cost.")
        terms = self.formulation.pieces.signature.cost
        return next((term for term in terms if getattr(term, "key", "") == key), None)

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
class Limit(Parameter):
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
        """Of bounds; those of controls are as many as controls have values in a step."""
        value, found = getattr(self.problem.limits, self._field), self._none
        letter, _, side = self._field.partition("_")
        if letter == "u" and not self.problem.inequalities:
            at, kind = self.formulation.layout, self.formulation.programme.kind
            bounds = getattr(self.formulation.programme.bounds, f"u_{side}")
            for column in range(at.num_own):
                k = column % len(value)
                is_finite = np.isfinite(bounds[:, column])
                getattr(found, side)[k, is_finite, kind.nx + column] = 1.0
            return found
        none = Change.none(self.formulation.programme, 1)
        return Change.joined(
            [
                change_along(self.formulation, partial(self._moved, k)) if np.isfinite(value[k]) else none
                for k in range(len(value))
            ]
        )

    def _moved(self, k: int, size: float) -> Problem:
        limits = self.problem.limits
        moved = np.array(getattr(limits, self._field))
        moved[k] += size
        return replace(self.problem, limits=replace(limits, **{self._field: moved}))


@dataclass(frozen=True, eq=False)
class Duration(Parameter):
    """The given duration, of which all steps are equal shares."""

    scales_time = True

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Where the only lengths of steps are its shares."""
        problem = formulation.problem
        timeline = problem.timeline
        is_one = len(timeline.phases) == 1 and not (timeline.impacts or timeline.has_unequal_lengths)
        has_times = timeline.has_free_lengths or problem.limits_within
        has_chord = _begins_with_a_chord(problem) and np.any(problem.v_start)
        if is_one and not has_times and not has_chord:
            yield "horizon.duration"

    @property
    def names(self) -> tuple[str, ...]:
        """The duration."""
        return (self.word,)

    def change(self) -> Change:
        """Of the length of a step."""
        found = self._none
        at = places(self.formulation.pieces.parameters.theta)
        found.theta[0, at["dt"]] = self.problem.dt / self.problem.duration
        return found


@dataclass(frozen=True, eq=False)
class OfRobot(Parameter):
    """What is a function of numbers of the robot."""

    @property
    @abstractmethod
    def in_numbers(self) -> Array:
        """Derivatives of `robot.varying_values`, a row for each number."""

    def change(self) -> Change:
        """Of the numbers among the parameters of steps and end."""
        found, layout, slopes = self._none, self.formulation.pieces.parameters, self.in_numbers
        found.theta[:, places(layout.theta)[NUMBERS]] = slopes
        found.rho_terminal[:, places(layout.terminal)[NUMBERS]] = slopes
        return found


@dataclass(frozen=True, eq=False)
class NumbersOfRobot(OfRobot):
    """All numbers of a robot that functions take as parameters, see `Robot.varying`."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """One, where there are such numbers."""
        if NUMBERS in formulation.pieces.parameters.theta:
            yield "robot.numbers"

    @property
    def names(self) -> tuple[str, ...]:
        """Kind, owner and entry."""
        model = self.problem.robot.model
        robot, joints = self.problem.robot, list(model.names)
        owners = {
            "frame_placement": [frame.name for frame in model.frames],
            "force": [element.name for element in robot.forces],
            "payload": [payload.name for payload in robot.payloads],
        }
        pairs = ((n, owners.get(n.of, joints)) for n in robot.varying)
        return tuple(f"{n.of} of {names[n.owner]}: {n.entry}" for n, names in pairs)

    @property
    def in_numbers(self) -> Array:
        """Themselves."""
        return np.eye(len(self.problem.robot.varying))


@dataclass(frozen=True, eq=False)
class PayloadNumbers(OfRobot):
    """Mass, centre of mass or moments of inertia of a payload."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """Of each payload, where functions take its numbers."""
        payloads = formulation.problem.robot.payloads
        carrying = {payload.frame for payload in payloads}  # what else stands on one would move with it
        if NUMBERS in formulation.pieces.parameters.theta:
            for payload in payloads:
                if payload.name not in carrying:
                    yield from (f"robot.payload.{payload.name}.{key}" for key in ("mass", "com", "inertia"))

    @property
    def names(self) -> tuple[str, ...]:
        """As the keys have them."""
        key = self.word.rpartition(".")[2]
        return {"mass": ("mass",), "com": ("x", "y", "z"), "inertia": INERTIA_KEYS}[key]

    @property
    def in_numbers(self) -> Array:
        """Of the body that carries it, and of the frame at its centre of mass."""
        robot, word = self.problem.robot, self.word.removeprefix("robot.")
        key, moved = word.rpartition(".")[2], ca.SX.sym("moved", len(self.names))
        words = [word] if key == "mass" else [f"{word}.{name}" for name in self.names]
        values = [number_of(robot, one) for one in words]
        given = numbers_behind(robot, words)
        now = {n: ca.SX(v) for n, v in zip(given, robot.values_of(given), strict=True)}
        now |= {n: ca.SX(v) for n, v in zip(robot.varying, robot.varying_values, strict=True)}
        pairs = zip(words, values, ca.vertsplit(moved), strict=True)
        after = put(robot, now, [(one, value + move) for one, value, move in pairs])
        slopes = ca.jacobian(ca.vertcat(*[after[number] for number in robot.varying]), moved)
        found: Array = np.asarray(ca.Function("slopes", [moved], [ca.densify(slopes)])(0.0)).T
        return found


PARAMETERS: tuple[type[Parameter], ...] = (
    Start,
    GoalOfJoints,
    GoalOfFrame,
    Weight,
    Limit,
    Duration,
    PayloadNumbers,
    NumbersOfRobot,
)


def parameters_of(formulation: Formulation, wrt: Sequence[str]) -> list[Parameter]:
    """Parameters by their words.

    Raises
    ------
    ProblemError
        If the problem has none of a word, or derivatives in it are not supported.
    """
    kinds = {word: kind for kind in PARAMETERS for word in kind.words(formulation)}
    for word in wrt or ("",):
        if word not in kinds:
            raise ProblemError(
                f"wrt: {word!r} is no parameter of this problem that derivatives are known in; it has "
                f"{', '.join(kinds)}"
            )
    return [kinds[word](formulation, word) for word in dict.fromkeys(wrt)]

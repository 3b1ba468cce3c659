"""Parameters that are numbers of the robot."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.formulation import Formulation
from mbocp.formulation.layout import places
from mbocp.formulation.parameter_layout import NUMBERS
from mbocp.problem import Problem
from mbocp.robot import Robot
from mbocp.robot.named_numbers import (
    OF_ROBOT,
    list_named_numbers,
    number_of,
    numbers_behind,
    open_numbers,
    put,
    take,
    with_numbers,
    with_numbers_of_model,
)
from mbocp.robot.payload import INERTIA_KEYS, Payload
from mbocp.sensitivity.change import Change, ProblemNumbers, change_along
from mbocp.sensitivity.of_ends import nearest_configuration
from mbocp.symbolic import ModelNumber

_OF_PAYLOAD = "payload."
_growth: dict[tuple[Hashable, ...], tuple[tuple[ModelNumber, ...], ca.Function]] = {}  # by shapes of robots
_KEPT = 64  # of these
_NAMES = {"mass": ("mass",), "com": ("x", "y", "z"), "inertia": INERTIA_KEYS}


@dataclass(frozen=True, eq=False)
class OfRobot(ProblemNumbers):
    """What is a function of numbers of the robot."""

    @property
    @abstractmethod
    def in_numbers(self) -> Array:
        """Derivatives of `robot.varying_values`, a row for each number."""

    def change(self) -> Change:
        """Of the numbers among the parameters of steps and end, and of controls that hold the robot."""
        slopes = self.in_numbers
        ends = ((self.problem.u_start, self.problem.u_before), (self.problem.goal.u, self.problem.u_after))
        if any(said.rule == "rest" and isinstance(u, np.ndarray) for said, u in ends):
            return change_along(self.formulation, *(partial(self._move, s) for s in slopes))
        found, layout = self._none, self.formulation.pieces.parameters
        found.theta[:, places(layout.theta)[NUMBERS]] = slopes
        found.rho_terminal[:, places(layout.terminal)[NUMBERS]] = slopes
        return found

    def _move(self, slopes: Array, size: float) -> Problem:
        robot = self.problem.robot
        return replace(self.problem, robot=_with_numbers(robot, robot.varying_values + size * slopes))


@dataclass(frozen=True, eq=False)
class NumbersOfRobot(OfRobot):
    """All numbers of a robot that functions take as parameters, see `Robot.varying`."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """One, where there are such numbers, all of them given, and of none the loops at the start depend."""
        problem = formulation.problem
        places_loops = problem.robot.nc and any("placement" in n.of for n in problem.robot.varying)
        if NUMBERS in formulation.pieces.parameters.theta and not (problem.parameter or places_loops):
            yield "robot.numbers"

    @property
    def names(self) -> tuple[str, ...]:
        """Kind, owner and entry."""
        robot, model = self.problem.robot, self.problem.robot.model
        joints = list(model.names)
        owners = {
            "frame_placement": [frame.name for frame in model.frames],
            "force": [element.name for element in robot.forces],
            "payload": [payload.name for payload in robot.payloads],
            "motor": [motor.name for motor in robot.motors],
            "resistance": [loss.name for loss in robot.resistances],
        }
        pairs = ((n, owners.get(n.of, joints)) for n in robot.varying)
        return tuple(f"{n.of} of {of_kind[n.owner]}: {n.entry}" for n, of_kind in pairs)

    @property
    def in_numbers(self) -> Array:
        """Themselves."""
        return np.eye(len(self.problem.robot.varying))

    @property
    def value(self) -> Array:
        """Themselves."""
        return np.array(self.problem.robot.varying_values)

    def put(self, problem: Problem, value: Array) -> Problem:
        """With a robot of other numbers."""
        return replace(problem, robot=_with_numbers(problem.robot, value))


def _with_numbers(robot: Robot, values: Array) -> Robot:
    return with_numbers_of_model(robot, dict(zip(robot.varying, values.tolist(), strict=True)))


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
                    yield from (f"{OF_ROBOT}payload.{payload.name}.{key}" for key in _NAMES)

    @property
    def names(self) -> tuple[str, ...]:
        """As the keys have them."""
        return _NAMES[self._key]

    @property
    def _key(self) -> str:
        return self.word.rpartition(".")[2]

    def _payload_of(self, robot: Robot) -> Payload:
        name = self.word.split(".", 3)[2]
        return next(payload for payload in robot.payloads if payload.name == name)

    def _numbers_after(self, robot: Robot, moved: Array) -> tuple[Array, Array]:
        word = self.word.removeprefix(OF_ROBOT)
        words = (word,) if len(self.names) == 1 else tuple(f"{word}.{name}" for name in self.names)
        return _numbers_with(robot, words, moved)

    @property
    def in_numbers(self) -> Array:
        """Of the body that carries it, and of the frame at its centre of mass."""
        return self._numbers_after(self.problem.robot, np.zeros(len(self.names)))[1].T

    @property
    def value(self) -> Array:
        """As the payload has it."""
        return np.array(getattr(self._payload_of(self.problem.robot), self._key), dtype=np.float64)

    def put(self, problem: Problem, value: Array) -> Problem:
        """With a robot that carries another payload.

        Raises
        ------
        InvalidValue
            If no body has such a mass or inertia.
        """
        robot, key = problem.robot, self._key
        payload = self._payload_of(robot)
        own = np.array(getattr(payload, key))
        said: Any = float(value) if key == "mass" else tuple(map(float, value))
        carried = tuple(replace(p, **{key: said}) if p is payload else p for p in robot.payloads)
        values, _ = self._numbers_after(robot, value - own)
        spec = {**robot.spec, "payload": [one.table for one in carried]}
        robot = replace(_with_numbers(robot, values), payloads=carried, spec=spec)
        return replace(problem, robot=robot)


@dataclass(frozen=True, eq=False)
class NumberByWord(OfRobot):
    """One number of a robot whose functions take what it is made of, see `open_words`."""

    @classmethod
    def words(cls, formulation: Formulation) -> Iterator[str]:
        """All of these but those of payloads; beside obstacles none that moves frames."""
        problem, robot = formulation.problem, formulation.problem.robot
        if NUMBERS not in formulation.pieces.parameters.theta or problem.parameter:
            return
        for word, number in list_named_numbers(robot).items():
            is_taken = set(number.takes) <= set(robot.varying) and not word.startswith(_OF_PAYLOAD)
            if is_taken and not (number.moves and problem.clearance is not None):
                yield OF_ROBOT + word

    @property
    def _word(self) -> str:
        return self.word.removeprefix(OF_ROBOT)

    @property
    def names(self) -> tuple[str, ...]:
        """The word."""
        return (self.word,)

    @property
    def in_numbers(self) -> Array:
        """Of all that it is made of."""
        return _numbers_with(self.problem.robot, (self._word,), np.zeros(1))[1].T

    def change(self) -> Change:
        """Of the numbers; where it moves closed loops or contacts, of start and goal, too, that keep them."""
        problem, value = self.problem, self.value
        has_ties = problem.robot.nc or problem.timeline.switches is not None
        if not (has_ties and take(problem.robot, self._word).moves):
            return super().change()
        scale = abs(float(value)) or 1.0
        moved = change_along(self.formulation, lambda size: self.put(problem, value + size * scale))
        return moved.along(np.array([[1.0 / scale]]))

    @property
    def value(self) -> Array:
        """As the robot has it."""
        return np.array(number_of(self.problem.robot, self._word))

    def put(self, problem: Problem, value: Array) -> Problem:
        """With a robot of another number, and start and goal nearest to what its loops allow."""
        moved = replace(problem, robot=with_numbers(problem.robot, {self._word: float(value)}))
        goal, robot = problem.goal, moved.robot
        if not robot.nc:
            return moved
        moved = replace(moved, q_start=nearest_configuration(robot, problem.q_start))
        moved = replace(moved, goal=replace(goal, q=nearest_configuration(robot, goal.q)))
        start, end = (moved.free_at_end(q) for q in (moved.q_start, moved.goal.q))
        rate = end @ end.T @ goal.value if goal.rate == "v" else goal.value
        goal = replace(moved.goal, value=rate)
        return replace(moved, v_start=start @ start.T @ problem.v_start, goal=goal)


def open_words(problem: Problem, wrt: Sequence[str]) -> Problem:
    """A problem whose functions take the robot's numbers of some words, as far as the robot has these."""
    asked = [word.removeprefix(OF_ROBOT) for word in wrt if word.startswith(OF_ROBOT)]
    asked = [word for word in asked if not word.startswith(_OF_PAYLOAD)]
    if not asked or problem.parameter:
        return problem
    known = list_named_numbers(problem.robot)
    words = [word for word in asked if word in known]
    return replace(problem, robot=open_numbers(problem.robot, words)) if words else problem


def _numbers_with(robot: Robot, words: tuple[str, ...], moved: Array) -> tuple[Array, Array]:
    """`robot.varying_values` after numbers of some words have grown, and derivatives of these in that."""
    payloads = tuple((payload.name, payload.position is None) for payload in robot.payloads)
    key = (robot.shape_fingerprint, robot.varying, payloads, words)
    found = _growth.get(key)
    if found is None:
        given = numbers_behind(robot, words)
        found = _growth[key] = given, _grow(robot, words, given)
        for oldest in list(_growth)[:-_KEPT]:
            _growth.pop(oldest, None)  # another thread may have been here
    given, grow = found
    values, slopes = grow(robot.values_of(given), robot.varying_values, moved)
    return np.asarray(values).ravel(), np.asarray(slopes)


def _grow(robot: Robot, words: tuple[str, ...], given: tuple[ModelNumber, ...]) -> ca.Function:
    symbols = [ca.SX.sym(name, len(of)) for name, of in (("g", given), ("v", robot.varying), ("m", words))]
    of_given, of_varying, moved = symbols
    now = dict(zip(given, ca.vertsplit(of_given), strict=True))
    now |= dict(zip(robot.varying, ca.vertsplit(of_varying), strict=True))
    pairs = zip(words, ca.vertsplit(moved), strict=True)
    after = put(robot, now, [(word, take(robot, word).get(now) + m) for word, m in pairs])
    numbers = ca.vertcat(*[after[number] for number in robot.varying])
    outputs = [ca.densify(numbers), ca.densify(ca.jacobian(numbers, moved))]
    return ca.Function("grow", symbols, outputs)

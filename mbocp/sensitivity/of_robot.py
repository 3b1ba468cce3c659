"""Parameters that are numbers of the robot."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.formulation import Formulation
from mbocp.formulation.layout import places
from mbocp.formulation.parameters import NUMBERS
from mbocp.problem import Problem
from mbocp.robot import Robot
from mbocp.robot.payload import INERTIA_KEYS, Payload
from mbocp.sensitivity.numbers import Change
from mbocp.sensitivity.parameter import Parameter
from mbocp.symbolic.numbers import with_values

_SIZES = {"mass": 1, "com": 3, "inertia": 6}


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
        frames, joints = [frame.name for frame in model.frames], list(model.names)
        pairs = ((n, frames if n.of == "frame_placement" else joints) for n in self.problem.robot.varying)
        return tuple(f"{n.of} of {owners[n.owner]}: {n.entry}" for n, owners in pairs)

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
    return replace(robot, model=with_values(robot.model, robot.varying, values))


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
                    yield from (f"robot.payload.{payload.name}.{key}" for key in _SIZES)

    @property
    def names(self) -> tuple[str, ...]:
        """As the keys have them."""
        return {"mass": ("mass",), "com": ("x", "y", "z"), "inertia": INERTIA_KEYS}[self._key]

    @property
    def _key(self) -> str:
        return self.word.rpartition(".")[2]

    def _payload_of(self, robot: Robot) -> Payload:
        name = self.word.split(".", 3)[2]
        return next(payload for payload in robot.payloads if payload.name == name)

    @property
    def in_numbers(self) -> Array:
        """Of the body that carries it, and of the frame at its centre of mass."""
        robot = self.problem.robot
        moved, numbers = _numbers_with(robot, self._payload_of(robot), self._key)
        slopes = ca.Function("slopes", [moved], [ca.densify(ca.jacobian(numbers, moved))])
        found: Array = np.asarray(slopes(np.zeros(moved.numel()))).T
        return found

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
        moved, numbers = _numbers_with(robot, payload, key)
        values = np.asarray(ca.Function("numbers", [moved], [ca.densify(numbers)])(value - own)).ravel()
        spec = {**robot.spec, "payload": [one.table for one in carried]}
        robot = replace(_with_numbers(robot, values), payloads=carried, spec=spec)
        return replace(problem, robot=robot)


def _numbers_with(robot: Robot, payload: Payload, key: str) -> tuple[ca.SX, ca.SX]:
    """By how much a key of a payload is changed, and what `robot.varying_values` are then.

    Sums of masses, first and second moments about the body's origin are what payloads add to.
    """
    moved = ca.SX.sym(key, _SIZES[key])
    moves = {name: moved if name == key else ca.SX.zeros(size) for name, size in _SIZES.items()}
    frame = robot.model.frames[robot.frame_id(payload.frame)]
    joint, tip = int(frame.parentJoint), robot.frame_id(payload.name)
    body, R, mass = robot.model.inertias[joint], frame.placement.rotation, payload.mass + moves["mass"]
    before = frame.placement.translation + R @ np.array(payload.com)
    centre = ca.SX(before) + ca.mtimes(ca.SX(R), moves["com"])
    xx, yy, zz, xy, xz, yz = ca.vertsplit(ca.SX(payload.inertia) + moves["inertia"])
    own = ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    whole = body.mass + moves["mass"]
    lever = (body.mass * body.lever - payload.mass * before + mass * centre) / whole
    about_origin = (
        body.inertia
        + body.mass * _second_moment(ca.SX(body.lever))
        - R @ payload.inertia_matrix @ R.T
        - payload.mass * _second_moment(ca.SX(before))
        + ca.mtimes([R, own, R.T])
        + mass * _second_moment(centre)
    )
    moments = about_origin - whole * _second_moment(lever)
    entries = [moments[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    of_body = [whole, *ca.vertsplit(lever), *entries]  # in the order of `ModelNumber`
    numbers = ca.SX(robot.varying_values)
    for place, number in enumerate(robot.varying):
        if number.of == "inertia" and number.owner == joint:
            numbers[place] = of_body[number.entry]
        is_tip = payload.position is None and number.of == "frame_placement" and number.owner == tip
        if is_tip and number.entry > 8:
            numbers[place] = centre[number.entry - 9]
    return moved, numbers


def _second_moment(c: ca.SX) -> ca.SX:
    return ca.dot(c, c) * ca.SX.eye(3) - ca.mtimes(c, c.T)

"""Constants of a robot that an estimator finds: what payloads weigh and where, and friction of joints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import ProblemError
from mbocp.mechanics.payload_numbers import body_numbers, payload_moments
from mbocp.robot import Robot
from mbocp.robot.resistance import FRICTION_SPEED
from mbocp.symbolic import values_of, with_values

_PAYLOAD = {"mass": ("",), "com": (".x", ".y", ".z")}  # keys, and what the names of their numbers end with
_FRICTION = ("viscous", "coulomb")


@dataclass(frozen=True)
class Unknown:
    """One constant.

    Attributes
    ----------
    name : str
        As `Estimate` has it.
    group : str
        The word that asked for it.
    value : float
        What the robot has [kg, m, N m s/rad, N m; N s/m, N of joints that slide].
    kind : {"mass", "com", "viscous", "coulomb"}
    owner : int
        Which payload, or which component of the velocity.
    entry : int
        Of a centre of mass.
    speed : float
        At which Coulomb friction is smoothed [rad/s, m/s].
    """

    name: str
    group: str
    value: float
    kind: str
    owner: int
    entry: int = 0
    speed: float = FRICTION_SPEED


def unknowns_of(robot: Robot, words: Iterable[str]) -> tuple[Unknown, ...]:
    """Constants by their words: `payload.NAME.mass`, `.com`, `friction.viscous`, `friction.coulomb`.

    The name of a joint may stand behind a word of friction.

    Raises
    ------
    ProblemError
        For a word that the robot has nothing for, or one that is said twice.
    """
    known = dict(_known(robot))
    for joint in (unknown for word in _FRICTION for unknown in known.get(f"friction.{word}", ())):
        known[joint.name] = (joint,)
    found = list[Unknown]()
    for word in words:
        if word not in known:
            options = ", ".join(known) or "nothing"
            raise ProblemError(f"unknowns: got {word!r}; robot {robot.name!r} has {options}")
        found += [replace(unknown, group=word) for unknown in known[word]]
    names = [unknown.name for unknown in found]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ProblemError(f"unknowns: {twice!r} is there twice; leave one out")
    return tuple(found)


def _known(robot: Robot) -> Iterator[tuple[str, tuple[Unknown, ...]]]:
    for index, payload in enumerate(robot.payloads):
        for key, ends in _PAYLOAD.items():
            word, values = f"payload.{payload.name}.{key}", np.atleast_1d(getattr(payload, key))
            yield (
                word,
                tuple(
                    Unknown(word + end, word, float(value), key, index, entry)
                    for entry, (end, value) in enumerate(zip(ends, values, strict=True))
                ),
            )
    places = {name: robot.velocity_indices(name) for name in robot.joint_names}
    single = {name: place.start for name, place in places.items() if place.stop - place.start == 1}
    own = {loss.dof: loss for loss in robot.resistances if single.get(loss.name) == loss.dof}
    for kind, attribute in zip(_FRICTION, ("damping", "friction"), strict=True):
        found = list[Unknown]()
        for name, dof in single.items():
            value, speed = (
                getattr(own.get(dof), attribute, 0.0),
                getattr(own.get(dof), "speed", FRICTION_SPEED),
            )
            found.append(Unknown(f"friction.{kind}.{name}", "", value, kind, dof, speed=speed))
        if found:
            yield f"friction.{kind}", tuple(found)


def numbers_in(robot: Robot, unknowns: Iterable[Unknown], p: ca.SX) -> ca.SX:
    """Return `robot.varying_values` as they follow from the constants p, shape (len(unknowns),)."""
    moves = dict[int, dict[str, list[ca.SX]]]()
    for k, unknown in enumerate(unknowns):
        if unknown.kind in _PAYLOAD:
            size = len(_PAYLOAD[unknown.kind])
            of_payload = moves.setdefault(unknown.owner, {})
            of_payload.setdefault(unknown.kind, [ca.SX(0)] * size)[unknown.entry] = p[k] - unknown.value
    changes = dict[int, ca.SX]()  # of each body that carries some
    for index, of_payload in moves.items():
        payload = robot.payloads[index]
        frame = robot.model.frames[robot.frame_id(payload.frame)]
        given = {key: ca.vertcat(*columns) for key, columns in of_payload.items()}
        change = payload_moments(frame.placement, payload, given) - payload_moments(
            frame.placement, payload, {}
        )
        joint = int(frame.parentJoint)
        changes[joint] = changes.get(joint, ca.SX.zeros(13)) + change
    bodies = {joint: body_numbers(robot.model.inertias[joint], change) for joint, change in changes.items()}
    constants = values_of(robot.model, robot.varying)
    return ca.vertcat(
        ca.SX.zeros(0, 1),
        *[
            bodies[number.owner][number.entry]
            if number.of == "inertia" and number.owner in bodies
            else constant
            for number, constant in zip(robot.varying, constants, strict=True)
        ],
    )


def numbers_function(robot: Robot, unknowns: Sequence[Unknown]) -> ca.Function:
    """Return the same as a function of numbers."""
    p = ca.SX.sym("p", len(unknowns))
    return ca.Function("numbers", [p], [numbers_in(robot, unknowns, p)])


def friction_in(unknowns: Iterable[Unknown], p: ca.SX, v: ca.SX) -> ca.SX:
    """Return the forces of friction beyond the robot's own, shape (nv,) [N, N m]."""
    force = ca.SX.zeros(v.shape)
    for k, unknown in enumerate(unknowns):
        if unknown.kind in _FRICTION:
            w = v[unknown.owner]
            force[unknown.owner] -= (p[k] - unknown.value) * (
                w if unknown.kind == "viscous" else ca.tanh(w / unknown.speed)
            )
    return force


def with_constants(robot: Robot, unknowns: Iterable[Unknown], numbers: Array, values: Array) -> Robot:
    """Return the robot with other payloads, whose masses are not below zero.

    Parameters
    ----------
    robot : Robot
    unknowns : iterable of Unknown
    numbers : ndarray
        Values of `robot.varying`.
    values : ndarray
        Of the unknowns.
    """
    payloads = list(robot.payloads)
    for unknown, value in zip(unknowns, values.tolist(), strict=True):
        if unknown.kind == "mass":
            payloads[unknown.owner] = replace(payloads[unknown.owner], mass=value)
        if unknown.kind == "com":
            x, y, z = (value if k == unknown.entry else c for k, c in enumerate(payloads[unknown.owner].com))
            payloads[unknown.owner] = replace(payloads[unknown.owner], com=(x, y, z))
    spec = {**robot.spec, "payload": [payload.table for payload in payloads]}
    model = with_values(robot.model, robot.varying, numbers)
    return replace(robot, model=model, payloads=tuple(payloads), spec=spec)

"""Constants of a robot that an estimator finds: what payloads weigh and where, and friction of joints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import dataclass
from mbocp._text import find_repeated
from mbocp.exceptions import ProblemError
from mbocp.mechanics import JointMechanics
from mbocp.robot import Robot
from mbocp.robot.named_numbers import OF_ROBOT
from mbocp.robot.resistance import FRICTION_SPEED, JointResistance

_PAYLOAD = {"mass": ("",), "com": (".x", ".y", ".z")}  # keys, and what the names of their numbers end with
_LOSSES = ("damping", "friction")
_OLD = {"friction.viscous": "damping", "friction.coulomb": "friction"}  # words that were


@dataclass(frozen=True)
class Constant:
    """One constant.

    Attributes
    ----------
    name : str
        As `Estimate` has it.
    group : str
        The word that asked for it.
    value : float
        What the robot has [kg, m, N m s/rad, N m; N s/m, N of joints that slide].
    kind : {"mass", "com", "damping", "friction"}
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


def unknowns_of(robot: Robot, words: Iterable[str]) -> tuple[Constant, ...]:
    """Return constants by their words, see `MovingHorizonEstimator`.

    Raises
    ------
    ProblemError
        For a word that the robot has nothing for, or one that is said twice.
    """
    known = dict(_unknowns_of(robot))
    for joint in (unknown for word in _LOSSES for unknown in known.get(OF_ROBOT + word, ())):
        known[joint.name] = (joint,)
    found = list[Constant]()
    for word in words:
        if word not in known:
            now = _word_now(word)
            has = f"robot {robot.name!r} has {', '.join(known) or 'nothing'}"
            advice = f"this is {now!r} now" if now in known else has
            raise ProblemError(f"unknowns: got {word!r}; {advice}")
        found += [replace(unknown, group=word) for unknown in known[word]]
    if repeated := find_repeated(unknown.name for unknown in found):
        raise ProblemError(f"unknowns: {repeated[0]!r} is there twice; leave one out")
    return tuple(found)


def _word_now(word: str) -> str:
    """Return the word of today for one that was."""
    for old, key in _OLD.items():
        if word.startswith(f"{old}."):
            return f"{OF_ROBOT}joint.{word.removeprefix(old + '.')}.{key}"
    return OF_ROBOT + _OLD.get(word, word)


def _unknowns_of(robot: Robot) -> Iterator[tuple[str, tuple[Constant, ...]]]:
    for index, payload in enumerate(robot.payloads):
        carries = payload.name in {other.frame for other in robot.payloads}  # they would move with it
        for key, ends in (("mass", _PAYLOAD["mass"]),) if carries else _PAYLOAD.items():
            word, values = f"{OF_ROBOT}payload.{payload.name}.{key}", np.atleast_1d(getattr(payload, key))
            yield (
                word,
                tuple(
                    Constant(word + end, word, float(value), key, index, entry)
                    for entry, (end, value) in enumerate(zip(ends, values, strict=True))
                ),
            )
    places = {name: robot.velocity_indices(name) for name in robot.joint_names}
    single = {name: place.start for name, place in places.items() if place.stop - place.start == 1}
    own = {loss.dof: loss for loss in robot.resistances if single.get(loss.name) == loss.dof}
    for kind in _LOSSES:
        found = list[Constant]()
        for name, dof in single.items():
            loss = own.get(dof, JointResistance(name, dof))
            value, word = float(getattr(loss, kind)), f"{OF_ROBOT}joint.{name}.{kind}"
            found.append(Constant(word, "", value, kind, dof, speed=loss.speed))
        if found:
            yield OF_ROBOT + kind, tuple(found)


def payload_forces(
    mechanics: JointMechanics, unknowns: Sequence[Constant], p: ca.SX, q: ca.SX, v: ca.SX, a: ca.SX
) -> ca.SX:
    """Return the forces that move the payloads beyond those of the robot, shape (nv,) [N, N m].

    They are linear in masses, so that one below zero, which a bad guess may be, is no harm.
    """
    found = ca.SX.zeros(v.shape)
    for index in dict.fromkeys(unknown.owner for unknown in unknowns if unknown.kind in _PAYLOAD):
        payload = mechanics.robot.payloads[index]
        mass, com = ca.SX(payload.mass), ca.SX(payload.com)
        for k, unknown in enumerate(unknowns):
            if unknown.kind == "mass" and unknown.owner == index:
                mass = p[k]
            if unknown.kind == "com" and unknown.owner == index:
                com[unknown.entry] = p[k]
        old_mass, old_com = payload.mass, ca.SX(payload.com)
        inertia = (
            mass - old_mass,
            mass * com - old_mass * old_com,
            mass * _second_moment(com) - old_mass * _second_moment(old_com),
        )
        V, A, jacobian = _frame_motion(mechanics, mechanics.robot.frame_id(payload.frame), q, v, a)
        (linear, angular), (force, torque) = _momentum(inertia, V), _momentum(inertia, A)
        turning = ca.cross(V[3:], angular) + ca.cross(V[:3], linear)
        found += jacobian.T @ ca.vertcat(force + ca.cross(V[3:], linear), torque + turning)
    return found


def _momentum(inertia: tuple[ca.SX, ca.SX, ca.SX], twist: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Momentum about a frame's origin, by mass, first and second moments there."""
    mass, first, second = inertia
    v, w = twist[:3], twist[3:]
    return mass * v + ca.cross(w, first), ca.cross(first, v) + second @ w


def _frame_motion(
    mechanics: JointMechanics, frame: int, q: ca.SX, v: ca.SX, a: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Twist of a frame in its axes, its derivative as if gravity were an acceleration, and its Jacobian."""
    functions = mechanics.functions
    at, rate, turn = (ca.SX.sym(name, value.shape) for name, value in (("q", q), ("v", v), ("turn", v)))
    twist = mechanics.evaluate(functions.frame_velocity(frame, "local"), mechanics.integrate(at, turn), rate)
    along = ca.Function("along", [at, rate, turn], [ca.jtimes(twist, turn, rate)])
    jacobian = mechanics.evaluate(functions.frame_jacobian(frame, "local"), q)
    gravity = mechanics.frame_rotation(frame, q).T @ ca.DM(mechanics.robot.model.gravity.linear)
    A = jacobian @ a + along(q, v, ca.SX.zeros(v.shape)) - ca.vertcat(gravity, ca.SX.zeros(3))
    return jacobian @ v, A, jacobian


def _second_moment(c: ca.SX) -> ca.SX:
    return ca.dot(c, c) * ca.SX.eye(3) - ca.mtimes(c, c.T)


def friction_in(unknowns: Iterable[Constant], p: ca.SX, v: ca.SX) -> ca.SX:
    """Return the forces of friction beyond the robot's own, shape (nv,) [N, N m]."""
    force = ca.SX.zeros(v.shape)
    for k, unknown in enumerate(unknowns):
        if unknown.kind in _LOSSES:
            w = v[unknown.owner]
            force[unknown.owner] -= (p[k] - unknown.value) * (
                w if unknown.kind == "damping" else ca.tanh(w / unknown.speed)
            )
    return force


def with_payloads(robot: Robot, unknowns: Iterable[Constant], values: Sequence[float]) -> Robot:
    """Return the robot with payloads as the constants say, of masses that are not below zero."""
    payloads, model = list(robot.payloads), robot.model.copy()
    for unknown, value in zip(unknowns, values, strict=True):
        payload = payloads[unknown.owner] if unknown.kind in _PAYLOAD else None
        if payload is not None and unknown.kind == "mass":
            payloads[unknown.owner] = replace(payload, mass=max(value, 0.0))
        elif payload is not None:
            x, y, z = (value if k == unknown.entry else c for k, c in enumerate(payload.com))
            payloads[unknown.owner] = replace(payload, com=(x, y, z))
    for old, new in zip(robot.payloads, payloads, strict=True):
        if new is not old:
            frame, tip = model.frames[robot.frame_id(old.frame)], model.frames[robot.frame_id(old.name)]
            before, after = (
                frame.placement.act(pin.Inertia(one.mass, np.array(one.com), one.inertia_matrix))
                for one in (old, new)
            )
            joint = frame.parentJoint
            model.inertias[joint] = model.inertias[joint] - before + after
            tip.placement = frame.placement * new.tip
    spec = {**robot.spec, "payload": [payload.table for payload in payloads]}
    return replace(robot, model=model, payloads=tuple(payloads), spec=spec)

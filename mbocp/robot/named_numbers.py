"""Numbers of a robot by words, as `payload.load.mass` or `joint.elbow.length`: read, and changed.

Each is a function of numbers that the equations have (`ModelNumber`), in numbers as in symbols. Masses and
inertias of links stay what they are where lengths change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple, TypeVar, cast

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp.exceptions import InvalidValue, suggest
from mbocp.robot import kinematics
from mbocp.robot.parts import Motor, QuarticSpring, SpringDamper
from mbocp.robot.payload import INERTIA_KEYS, Payload, shape_name
from mbocp.robot.resistance import JointResistance
from mbocp.robot.robot import Robot
from mbocp.symbolic.model_numbers import (
    ModelNumber,
    inertia_numbers,
    joint_placement_numbers,
    numbers_of_model,
    placement_numbers,
    values_of,
    with_values,
)

OF_ROBOT = "robot."  # what words begin with where a problem has others, too
_AXES = "xyz"
_COM = {f"com.{axis}": "m" for axis in _AXES}
_OF_PAYLOAD = {"mass": "kg", **_COM, **{f"inertia.{key}": "kg m^2" for key in INERTIA_KEYS}}
_ROUND_OFF = 1e-12  # [m]

E = TypeVar("E")
Numbers = Mapping[ModelNumber, ca.SX]


class NamedNumber(NamedTuple):
    """One number by its word.

    Attributes
    ----------
    unit : str
    takes : tuple of ModelNumber
        What it is read from and what it changes.
    get : callable
        These numbers -> its value.
    put : callable
        These numbers, another value -> those that change.
    moves : bool
        Whether places of frames depend on it.
    """

    unit: str
    takes: tuple[ModelNumber, ...]
    get: Callable[[Numbers], ca.SX]
    put: Callable[[Numbers, ca.SX], Numbers]
    moves: bool = True


def list_named_numbers(robot: Robot) -> dict[str, NamedNumber]:
    """All numbers of a robot that have words."""
    model = robot.model
    found: dict[str, NamedNumber] = {}
    for index, payload in enumerate(robot.payloads):
        if all(other.frame != payload.name for other in robot.payloads):  # else that would move with it
            found |= _of_payload(robot, index, payload)
    found |= _of_elements("spring", "force", robot.forces)
    found |= _of_elements("motor", "motor", robot.motors)
    turns = [loss if robot.v_labels[loss.dof].unit == "rad/s" else None for loss in robot.resistances]
    found |= _of_elements("joint", "resistance", turns)
    laden = {int(model.frames[robot.frame_id(payload.frame)].parentJoint) for payload in robot.payloads}
    for joint in range(1, model.njoints):
        if model.inertias[joint].mass > 0.0 and joint not in laden:
            found[f"joint.{model.names[joint]}.mass"] = _of_body(joint)
        found |= _of_place(f"joint.{model.names[joint]}", joint_placement_numbers(joint), model)
    taken = {payload.name for payload in robot.payloads} | {payload.frame for payload in robot.payloads}
    standing = {int(frame.parentFrame) for frame in model.frames[1:]}
    for index, frame in enumerate(model.frames):
        is_free = index not in standing and frame.name not in taken and frame.type != pin.FrameType.JOINT
        if is_free and frame.parentJoint > 0:
            found |= _of_place(f"frame.{frame.name}", placement_numbers(index), model)
    for word, prefix in _bases(robot).items():
        found |= _of_base(robot, word, prefix)
    return found


def take(robot: Robot, word: str) -> NamedNumber:
    """Return the number of a word.

    Raises
    ------
    InvalidValue
        If the robot has none of that word.
    """
    known = list_named_numbers(robot)
    if word not in known:
        raise InvalidValue(
            f"number of robot {robot.name!r}",
            repr(word),
            "payload.NAME.mass or .com.x, spring.NAME.stiffness, motor.JOINT.gear_ratio, joint.NAME.mass, "
            ".length or .x, frame.NAME.length "
            f"or .x, base.x and the like; {suggest(word, known)}",
        )
    return known[word]


def numbers_behind(robot: Robot, words: Iterable[str]) -> tuple[ModelNumber, ...]:
    """Numbers that words are about, in rising order."""
    return tuple(sorted({number for word in words for number in take(robot, word).takes}))


def open_numbers(robot: Robot, words: Iterable[str]) -> Robot:
    """Copy of a robot whose functions take the numbers behind these words as parameters."""
    return replace(robot, opened=numbers_behind(robot, words))


def put(robot: Robot, at: Numbers, values: Iterable[tuple[str, ca.SX]]) -> dict[ModelNumber, ca.SX]:
    """Numbers after those of some words have other values, one after the other."""
    found = dict(at)
    for word, value in values:
        found.update(take(robot, word).put(found, value))
    return found


def number_of(robot: Robot, word: str) -> float:
    """Value of the number of a word in a robot, in its unit.

    Raises
    ------
    InvalidValue
        If the robot has none of that word.
    """
    named = take(robot, word)
    at = zip(named.takes, robot.values_of(named.takes), strict=True)
    return float(ca.evalf(named.get({number: ca.SX(value) for number, value in at})))


def with_numbers(robot: Robot, values: Mapping[str, float]) -> Robot:
    """Copy of a robot in which the numbers of some words have other values; loops are closed again.

    Raises
    ------
    InvalidValue
        For a word that the robot has not, and a value that cannot be.
    LoopNotClosed
        If no initial pose closes the loops with these values.
    """
    for word, value in values.items():
        if word.startswith("joint.") and word.endswith(".mass") and value < 0.0:
            raise InvalidValue(OF_ROBOT + word, value, "a mass, 0 or above [kg]")
        if word.endswith(".length") and take(robot, word).moves and value <= 0.0:
            raise InvalidValue(OF_ROBOT + word, value, "a length above 0 [m]")
    numbers = numbers_behind(robot, values)
    at = {n: ca.SX(value) for n, value in zip(numbers, robot.values_of(numbers), strict=True)}
    found = put(robot, at, [(word, ca.SX(value)) for word, value in values.items()])
    now = {number: float(ca.evalf(ca.SX(value))) for number, value in found.items()}
    payloads = tuple(_change_payload(now, k, payload) for k, payload in enumerate(robot.payloads))
    other = with_numbers_of_model(robot, now)
    visuals = pin.GeometryModel(robot.visual_model)
    _move_visuals(robot, other.model, visuals, values)
    spec = {**robot.spec, "numbers": {**robot.spec.get("numbers", {}), **values}}
    if "payload" in spec:
        spec["payload"] = [payload.table for payload in payloads]
    other = replace(other, visual_model=visuals, payloads=payloads, spec=spec)
    is_open = other.nc and np.abs(other.constraint_residual(other.q0)).max() > _ROUND_OFF
    return replace(other, q0=other.assemble(other.q0)) if is_open else other


def with_numbers_of_model(robot: Robot, now: Mapping[ModelNumber, float]) -> Robot:
    """Copy of a robot in which numbers of its model, springs, motors and losses have other values."""
    of_model = numbers_of_model(now)
    motors = _replace_values(now, "motor", robot.motors)
    other = replace(
        robot,
        model=with_values(robot.model, of_model, [now[number] for number in of_model]),
        forces=_replace_values(now, "force", robot.forces),
        resistances=_replace_values(now, "resistance", robot.resistances),
    )
    return put_motors(other, motors) if motors != robot.motors else other


def _replace_values(now: Mapping[ModelNumber, float], of: str, elements: Sequence[E]) -> tuple[E, ...]:
    """Springs or motors with other numbers."""
    found = list(elements)
    for number, value in now.items():
        if number.of == of:
            element: Any = found[number.owner]
            found[number.owner] = replace(element, **{list(element.units)[number.entry]: value})
    return tuple(found)


def put_motors(robot: Robot, motors: tuple[Motor, ...]) -> Robot:
    """Copy of a robot with these motors: torques, rotors and speeds of the joints follow from their gears."""
    model, selection = pin.Model(robot.model), np.array(robot.actuation.selection)
    armature, speeds = np.array(model.armature), np.array(robot.limits.velocity)
    for motor in motors:
        selection[motor.dof, motor.column] = motor.gear_ratio
        armature[motor.dof] = motor.gear_ratio**2 * motor.inertia
        speeds[motor.dof] = motor.speed / motor.gear_ratio
    model.armature = armature
    return replace(
        robot,
        model=model,
        motors=motors,
        actuation=replace(robot.actuation, selection=selection),
        limits=replace(robot.limits, velocity=speeds),
    )


def _change_payload(now: Mapping[ModelNumber, float], index: int, payload: Payload) -> Payload:
    own = [payload.mass, *payload.com, *payload.inertia]
    for number, value in now.items():
        if number.of == "payload" and number.owner == index:
            own[number.entry] = value
    return replace(cast(Any, payload), mass=own[0], com=tuple(own[1:4]), inertia=tuple(own[4:]))


def _move_visuals(robot: Robot, model: pin.Model, visuals: pin.GeometryModel, values: Iterable[str]) -> None:
    """What is drawn of a base moves with it, and a payload with its centre of mass."""
    for base, prefix in _bases(robot).items():
        if any(word.startswith(f"{base}.") for word in values):
            root = _find_fixed_frames(robot, prefix)[0]
            away = model.frames[root].placement * robot.model.frames[root].placement.inverse()
            for shape in visuals.geometryObjects:
                if shape.parentJoint == 0 and robot.model.frames[shape.parentFrame].name.startswith(prefix):
                    shape.placement = away * shape.placement
    for payload in robot.payloads:
        moved = any(word.startswith(f"payload.{payload.name}.com.") for word in values)
        if moved and payload.position is None:
            shape = visuals.geometryObjects[visuals.getGeometryId(shape_name(payload))]
            shape.placement = model.frames[robot.frame_id(payload.name)].placement


def _plain(number: ModelNumber, unit: str, *, moves: bool = True) -> NamedNumber:
    return NamedNumber(unit, (number,), lambda at: at[number], lambda at, value: {number: value}, moves)


def _of_place(word: str, placement: Sequence[ModelNumber], model: pin.Model) -> dict[str, NamedNumber]:
    """Coordinates of a joint or frame in the link before it, and its distance from that link's joint."""
    own = tuple(placement[9:])
    found = {f"{word}.{axis}": _plain(number, "m") for axis, number in zip(_AXES, own, strict=True)}
    if np.linalg.norm(values_of(model, own)) > _ROUND_OFF:

        def length(at: Numbers) -> ca.SX:
            return ca.norm_2(ca.vertcat(*[at[number] for number in own]))

        def stretch(at: Numbers, value: ca.SX) -> Numbers:
            return {number: at[number] * (value / length(at)) for number in own}

        found[f"{word}.length"] = NamedNumber("m", own, length, stretch)
    return found


def _of_elements(
    word: str,
    of: Literal["force", "motor", "resistance"],
    elements: Sequence[SpringDamper | QuarticSpring | Motor | JointResistance | None],
) -> dict[str, NamedNumber]:
    return {
        f"{word}.{element.name}.{key}": _plain(ModelNumber(of, index, entry), unit, moves=False)
        for index, element in enumerate(elements)
        if element is not None
        for entry, (key, unit) in enumerate(element.units.items())
    }


def _of_body(joint: int) -> NamedNumber:
    """Mass of what a joint moves; its moments of inertia grow with it."""
    mass, *moments = takes = [n for n in inertia_numbers(joint) if n.entry not in (1, 2, 3)]

    def scale(at: Numbers, value: ca.SX) -> Numbers:
        return {mass: value, **{number: at[number] * (value / at[mass]) for number in moments}}

    return NamedNumber("kg", tuple(takes), lambda at: at[mass], scale, moves=False)


def _bases(robot: Robot) -> dict[str, str]:
    """Words of what stands in the world, with what the names of its joints and frames begin with."""
    if not robot.parts:
        return {"base": ""}
    return {f"part.{part.name}": part.prefix for part in robot.parts if part.parent == kinematics.WORLD}


def _find_fixed_frames(robot: Robot, prefix: str) -> list[int]:
    """Frames that stand in the world with a robot or part, its root link first."""
    frames = enumerate(robot.model.frames)
    return [k for k, f in frames if k and f.parentJoint == 0 and f.name.startswith(prefix)]


def _of_base(robot: Robot, word: str, prefix: str) -> dict[str, NamedNumber]:
    """Where its root link stands in the world, and the turn about the vertical."""
    model, frames = robot.model, _find_fixed_frames(robot, prefix)
    if not frames:
        return {}
    first = [
        j for j in range(1, model.njoints) if model.parents[j] == 0 and model.names[j].startswith(prefix)
    ]
    moved = [*map(placement_numbers, frames), *map(joint_placement_numbers, first)]
    base = moved[0]
    places = tuple(number for placement in moved for number in placement[9:])
    everything = tuple(number for placement in moved for number in placement)

    def coordinate(i: int) -> NamedNumber:
        def shift(at: Numbers, value: ca.SX) -> Numbers:
            away = value - at[base[9 + i]]
            return {placement[9 + i]: at[placement[9 + i]] + away for placement in moved}

        return NamedNumber("m", places, lambda at: at[base[9 + i]], shift)

    def heading(at: Numbers) -> ca.SX:
        return ca.atan2(at[base[1]], at[base[0]])

    def turn(at: Numbers, value: ca.SX) -> Numbers:
        angle, centre = value - heading(at), [at[number] for number in base[9:]]
        c, s, found = ca.cos(angle), ca.sin(angle), dict[ModelNumber, ca.SX]()
        for placement in moved:
            for k in range(0, 12, 3):
                x, y = (at[placement[k + i]] - (centre[i] if k == 9 else 0) for i in (0, 1))
                found[placement[k]] = c * x - s * y + (centre[0] if k == 9 else 0)
                found[placement[k + 1]] = s * x + c * y + (centre[1] if k == 9 else 0)
        return found

    numbers = {f"{word}.{axis}": coordinate(i) for i, axis in enumerate(_AXES)}
    return {**numbers, f"{word}.yaw": NamedNumber("rad", everything, heading, turn)}


def _of_payload(robot: Robot, index: int, payload: Payload) -> dict[str, NamedNumber]:
    """Mass, centre of mass and moments of inertia, of which the body that carries it is a function."""
    frame, tip = robot.frame_id(payload.frame), placement_numbers(robot.frame_id(payload.name))[9:]
    joint = int(robot.model.frames[frame].parentJoint)
    own = tuple(ModelNumber("payload", index, entry) for entry in range(10))
    body = tuple(ModelNumber("inertia", joint, entry) for entry in range(10))
    at_frame = placement_numbers(frame)
    takes = (*own, *body, *at_frame, *tip)

    def number(entry: int, unit: str) -> NamedNumber:
        def change(at: Numbers, value: ca.SX) -> Numbers:
            R = ca.reshape(ca.vertcat(*[at[n] for n in at_frame[:9]]), 3, 3)
            t = ca.vertcat(*[at[n] for n in at_frame[9:]])
            now = {**at, own[entry]: value}
            mass, first, second = _about_origin([at[n] for n in body])
            was, is_now = (_of_load([of[n] for n in own], R, t) for of in (at, now))
            mass, first, second = (
                mass - was[0] + is_now[0],
                first - was[1] + is_now[1],
                second - was[2] + is_now[2],
            )
            centre = first / mass
            moments = second - mass * _second_moment(centre)
            entries = [moments[i, j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
            found = dict(zip(body, (mass, *ca.vertsplit(centre), *entries), strict=True))
            if payload.position is None:
                found |= dict(
                    zip(tip, ca.vertsplit(t + R @ ca.vertcat(*[now[n] for n in own[1:4]])), strict=True)
                )
            return {own[entry]: value, **found}

        is_place = unit == "m" and payload.position is None
        return NamedNumber(unit, takes, lambda at: at[own[entry]], change, is_place)

    words = enumerate(_OF_PAYLOAD.items())
    return {f"payload.{payload.name}.{key}": number(entry, unit) for entry, (key, unit) in words}


def _about_origin(body: Sequence[ca.SX]) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Mass, first and second moment about the origin of a body's ten numbers."""
    mass, c, (xx, xy, yy, xz, yz, zz) = body[0], ca.vertcat(*body[1:4]), body[4:]
    own = ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return mass, mass * c, own + mass * _second_moment(c)


def _of_load(own: Sequence[ca.SX], R: ca.SX, t: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
    """The same of a payload's ten numbers, in the axes of the body that carries it."""
    mass, (xx, yy, zz, xy, xz, yz) = own[0], own[4:]
    c = t + R @ ca.vertcat(*own[1:4])
    inertia = ca.blockcat([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return mass, mass * c, R @ inertia @ R.T + mass * _second_moment(c)


def _second_moment(c: ca.SX) -> ca.SX:
    return ca.dot(c, c) * ca.SX.eye(3) - c @ c.T

"""Several models as one: names with the prefix of each part, numbers of joints copied."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import RobotError, UnknownFrame, UnsupportedRobot, reword_errors
from mbocp.robot import joints, kinematics
from mbocp.robot.loading.description import Description
from mbocp.robot.loading.joint_numbers import Losses, MimicJoint
from mbocp.robot.loading.whole_table import RobotPart, combine_tables, joint_positions, prefix, prefix_frame
from mbocp.robot.payload import Payload
from mbocp.robot.placed import SEPARATOR
from mbocp.robot.rotors import unit_rotors


def combine(parts: Sequence[RobotPart], name: str, file: Path, settled: Collection[str] = ()) -> Description:
    """Make one description of several, in their order; a part on another one's frame follows its joint.

    Parameters
    ----------
    parts : sequence of RobotPart
    name : str
        What to call the whole.
    file : Path
        Where the tables of parts stand, for messages.
    settled : collection of str
        Which of gravity and rotations an option says, so that the files of the parts need not agree.

    Raises
    ------
    UnknownFrame
        If a parent frame does not exist.
    RobotError
        If parts are attached to each other in a circle.
    UnsupportedRobot
        If a part without dynamics moves one that has masses, or is moved by one.
    """
    model, visuals = pin.Model(), pin.GeometryModel()
    for part in _parents_first(parts):
        parent = _parent(model, part, parts)
        model, visuals = _append(model, visuals, part, parent)
    model.name = name
    for part in parts:
        _copy_numbers(part, model)
    _refuse_masses_on_rotors(model, parts)
    return Description(
        name=name,
        file=file,
        model=model,
        visuals=visuals,
        q0=_pose(model, parts),
        table=combine_tables(parts, settled),
        followers=_each(parts, "followers", _follower),
        shapes=_each(parts, "shapes", lambda source, part: source.within(part + SEPARATOR)),
        parts=tuple(leaf for part in parts for leaf in part.leaves),
        losses=tuple(_losses(losses, part) for part in parts for losses in part.description.losses),
        carried=_each(parts, "carried", _payload),
        link_inertias=_each(
            parts, "link_inertias", lambda one, part: replace(one, link=prefix(one.link, part))
        ),
        named_locks=frozenset(_each(parts, "named_locks", prefix)),
    )


def _each(parts: Sequence[RobotPart], key: str, renamed: Callable[[Any, str], Any]) -> tuple[Any, ...]:
    """What each part has of something, in the names of the whole."""
    return tuple(
        renamed(entry, part.placed.name) for part in parts for entry in getattr(part.description, key)
    )


def _follower(follower: MimicJoint, part: str) -> MimicJoint:
    return replace(follower, name=prefix(follower.name, part), leader=prefix(follower.leader, part))


def _payload(payload: Payload, part: str) -> Payload:
    return replace(payload, name=prefix(payload.name, part), frame=prefix_frame(payload.frame, part))


def _losses(losses: Losses, part: RobotPart) -> Losses:
    own = losses.joints or joints.joint_names(part.description.model)
    return replace(losses, joints=frozenset(map(part.name_of, own)))


def _parents_first(parts: Sequence[RobotPart]) -> list[RobotPart]:
    names = [part.placed.name for part in parts]
    waiting, done = list(parts), list[RobotPart]()
    while waiting:
        there = {part.placed.name for part in done}
        ready = [part for part in waiting if _owner(part, names) in (None, *there)]
        if not ready:
            circle = ", ".join(repr(part.placed.name) for part in waiting)
            raise RobotError(f"part: {circle} hang on each other in a circle; let one stand in the world")
        done += ready
        waiting = [part for part in waiting if part not in done]
    return done


def _owner(part: RobotPart, names: Iterable[str]) -> str | None:
    """Part that the parent frame belongs to."""
    return next((name for name in names if part.placed.parent.startswith(name + SEPARATOR)), None)


def _parent(model: pin.Model, part: RobotPart, parts: Sequence[RobotPart]) -> int:
    names = " or ".join(repr(p.placed.name) for p in parts if p is not part) or "a part"
    where, remedy = f"part {part.placed.name!r}: parent", f'it is "world", or PART/FRAME of {names}'
    with reword_errors(lambda words: f"{where}: {words}; {remedy}", UnknownFrame):
        return kinematics.frame_id(model, part.placed.parent, "the world")


def _append(
    model: pin.Model, visuals: pin.GeometryModel, part: RobotPart, parent: int
) -> tuple[pin.Model, pin.GeometryModel]:
    """The model with one more part; a joint of several children keeps its subtree together."""
    added, shown = pin.Model(part.description.model), pin.GeometryModel(part.description.visuals)
    for joint in range(1, added.njoints):
        added.names[joint] = part.placed.prefix + added.names[joint]
    for frame in list(added.frames)[1:]:
        frame.name = part.placed.prefix + frame.name
    base = prefix_frame(kinematics.WORLD, part.placed.name)
    added.addFrame(pin.Frame(base, 0, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME), False)
    for shape in shown.geometryObjects:
        shape.name = part.placed.prefix + shape.name
    known = _number(model, "a")
    new = _number(added, "b")
    model, visuals = pin.appendModel(model, added, visuals, shown, parent, part.placement)
    for frame in list(model.frames)[1:]:
        frame.name = {**known, **new}[frame.name]
    return model, visuals


def _number(model: pin.Model, letter: str) -> dict[str, str]:
    """Give each frame a name of its own, as `pin.appendModel` needs; return the names that they had."""
    names = {}
    for number, frame in enumerate(list(model.frames)[1:]):
        names[f"{letter}{number}"] = frame.name
        frame.name = f"{letter}{number}"
    return names


def _copy_numbers(part: RobotPart, model: pin.Model) -> None:
    """Limits, losses and rotors of the joints; `pin.appendModel` forgets some of them."""
    own = part.description.model
    for joint in range(1, own.njoints):
        there = joints.joint_id(model, part.name_of(own.names[joint]), part.placed.name)
        joints.copy_numbers(own, joint, model, there)


def _refuse_masses_on_rotors(model: pin.Model, parts: Sequence[RobotPart]) -> None:
    rotors = unit_rotors(model)
    for part in parts:
        own = part.description.model
        for joint in range(1, own.njoints):
            if not unit_rotors(own)[joints.velocity_slice(own, joint)].any():
                continue
            name = part.name_of(own.names[joint])
            chain = [int(j) for j in model.supports[joints.joint_id(model, name, part.placed.name)] if j]
            if not all(rotors[joints.velocity_slice(model, j)].all() for j in chain):
                words = "moves parts that have masses, or is moved by one: give all of them dynamics, or none"
                raise UnsupportedRobot(f"part {part.placed.name!r}: dynamics = false: joint {name!r} {words}")


def _pose(model: pin.Model, parts: Sequence[RobotPart]) -> Array:
    q = pin.neutral(model)
    for part in parts:
        for joint, numbers in joint_positions(part):
            there = joints.joint_id(model, part.name_of(joint), part.placed.name)
            q[joints.configuration_slice(model, there)] = numbers
    return q

"""Several models as one: names with the prefix of each part, tables one after the other."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import pinocchio as pin
from pydantic import BaseModel

from mbocp._arrays import Array
from mbocp.exceptions import RobotError, UnknownFrame
from mbocp.robot import joints, kinematics
from mbocp.robot.loading.actuator_tables import ActuationTable, JointActuator
from mbocp.robot.loading.body import Body, initial_pose, posed_joints
from mbocp.robot.loading.schema import InitialTable, RobotTable
from mbocp.robot.placed import SEPARATOR, PlacedRobot

_SHARED = {"gravity": (0.0, 0.0, -9.81), "rotations": "quaternion"}  # of all parts, and what is usual
_OF_VELOCITIES = (
    "armature",
    "rotorInertia",
    "rotorGearRatio",
    "damping",
    "lowerDryFrictionLimit",
    "upperDryFrictionLimit",
    "lowerEffortLimit",
    "upperEffortLimit",
    "lowerVelocityLimit",
    "upperVelocityLimit",
)
_OF_POSITIONS = ("lowerPositionLimit", "upperPositionLimit")
_UNIVERSE = "universe"  # what Pinocchio calls the frame that stands still; no other can have this name

Table = TypeVar("Table", bound=BaseModel)


@dataclass(frozen=True, eq=False)
class Part:
    """A body and what its options make of its tables.

    Parameters
    ----------
    body : Body
    placed : PlacedRobot
    placement : pin.SE3
        Of the base in the parent frame.
    lock : mapping
        Joint to position, in the names of the body.
    motors : sequence of str
        Joints with motors, in the names of the body.
    trace : sequence of str
        Frames to trace, in the names of the body.
    is_object : bool
        Whether it is a simple body, which has no opinion on gravity and rotations.
    """

    body: Body
    placed: PlacedRobot
    placement: pin.SE3
    lock: Mapping[str, Any]
    motors: Sequence[str]
    trace: Sequence[str]
    is_object: bool = False

    @property
    def leaves(self) -> tuple[PlacedRobot, ...]:
        """The robots that it consists of, in the names of the whole: itself, if it has no parts."""
        name = self.placed.name
        if not self.body.parts:
            return (self.placed,)
        return tuple(
            replace(part, name=prefixed(part.name, name), parent=prefixed_frame(part.parent, name))
            for part in self.body.parts
        )


def prefixed(name: str, part: str) -> str:
    """Name of a part's joint or element among those of all."""
    return part + SEPARATOR + name


def prefixed_frame(name: str, part: str) -> str:
    """Name of a part's frame among those of all; what "world" was to it is the frame that its base is."""
    return prefixed(_UNIVERSE if name == kinematics.WORLD else name, part)


# Keys of tables that hold a name; in the plural they hold several.
_NAMES = {"frame": prefixed_frame, "joint": prefixed}


def combined(parts: Sequence[Part], name: str, file: Path, settled: Collection[str] = ()) -> Body:
    """One body of several, in their order; a part on another one's frame follows the joint that moves it.

    Parameters
    ----------
    parts : sequence of Part
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
    """
    model, visuals = pin.Model(), pin.GeometryModel()
    for part in _parents_first(parts):
        parent = _parent(model, part, parts)
        model, visuals = _appended(model, visuals, part, parent)
    model.name = name
    for part in parts:
        _copy_numbers(part, model)
    return Body(
        model=model,
        visuals=visuals,
        q0=_pose(model, parts),
        urdf=None,
        name=name,
        table=_table(parts, settled),
        file=file,
        followers=tuple(
            replace(f, name=prefixed(f.name, part.placed.name), leader=prefixed(f.leader, part.placed.name))
            for part in parts
            for f in part.body.followers
        ),
        parts=tuple(leaf for part in parts for leaf in part.leaves),
        collision=tuple(
            source.within(part.placed.prefix) for part in parts for source in part.body.collision
        ),
        named_locks=frozenset(
            prefixed(joint, part.placed.name) for part in parts for joint in part.body.named_locks
        ),
    )


def _parents_first(parts: Sequence[Part]) -> list[Part]:
    names = [part.placed.name for part in parts]
    waiting, done = list(parts), list[Part]()
    while waiting:
        there = {part.placed.name for part in done}
        ready = [part for part in waiting if _owner(part, names) in (None, *there)]
        if not ready:
            circle = ", ".join(repr(part.placed.name) for part in waiting)
            raise RobotError(f"part: {circle} hang on each other in a circle; let one stand in the world")
        done += ready
        waiting = [part for part in waiting if part not in done]
    return done


def _owner(part: Part, names: Iterable[str]) -> str | None:
    """Part that the parent frame belongs to."""
    return next((name for name in names if part.placed.parent.startswith(name + SEPARATOR)), None)


def _parent(model: pin.Model, part: Part, parts: Sequence[Part]) -> int:
    where = f"part {part.placed.name!r}: parent"
    try:
        return kinematics.frame_id(model, part.placed.parent, "the world")
    except UnknownFrame as error:
        names = [repr(p.placed.name) for p in parts if p is not part]
        error.args = (f'{where}: {error}; it is "world", or PART/FRAME of {" or ".join(names) or "a part"}',)
        raise


def _appended(
    model: pin.Model, visuals: pin.GeometryModel, part: Part, parent: int
) -> tuple[pin.Model, pin.GeometryModel]:
    """The model with one more part; a joint of several children keeps its subtree together."""
    added, shown = pin.Model(part.body.model), pin.GeometryModel(part.body.visuals)
    for joint in range(1, added.njoints):
        added.names[joint] = part.placed.prefix + added.names[joint]
    for frame in list(added.frames)[1:]:
        frame.name = part.placed.prefix + frame.name
    base = prefixed_frame(kinematics.WORLD, part.placed.name)
    added.addFrame(pin.Frame(base, 0, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME), False)
    for shape in shown.geometryObjects:
        shape.name = part.placed.prefix + shape.name
    known = _numbered(model, "a")
    new = _numbered(added, "b")
    model, visuals = pin.appendModel(model, added, visuals, shown, parent, part.placement)
    for frame in list(model.frames)[1:]:
        frame.name = {**known, **new}[frame.name]
    return model, visuals


def _numbered(model: pin.Model, letter: str) -> dict[str, str]:
    """Give each frame a name of its own, as `pin.appendModel` needs; return the names that they had."""
    names = {}
    for number, frame in enumerate(list(model.frames)[1:]):
        names[f"{letter}{number}"] = frame.name
        frame.name = f"{letter}{number}"
    return names


def _copy_numbers(part: Part, model: pin.Model) -> None:
    """Limits, losses and rotors of the joints; `pin.appendModel` forgets some of them."""
    own = part.body.model
    for joint in range(1, own.njoints):
        there = joints.joint_id(model, part.placed.prefix + own.names[joint], part.placed.name)
        for keys, where in (
            (_OF_VELOCITIES, joints.velocity_slice),
            (_OF_POSITIONS, joints.configuration_slice),
        ):
            for key in keys:
                getattr(model, key)[where(model, there)] = getattr(own, key)[where(own, joint)]


def _pose(model: pin.Model, parts: Sequence[Part]) -> Array:
    q = pin.neutral(model)
    for part in parts:
        own = initial_pose(part.body)
        for joint in range(1, part.body.model.njoints):
            name = prefixed(part.body.model.names[joint], part.placed.name)
            there = joints.configuration_slice(model, joints.joint_id(model, name, part.placed.name))
            q[there] = own[joints.configuration_slice(part.body.model, joint)]
    pose: Array = q
    return pose


def _table(parts: Sequence[Part], settled: Collection[str]) -> RobotTable:
    """Tables of all parts, in their names."""
    lists = (
        "actuators",
        "drives",
        "constraints",
        "springs",
        "spring_dampers",
        "visuals",
        "collision_spheres",
    )
    changes: dict[str, Any] = {key: [row for part in parts for row in _rows(part, key)] for key in lists}
    lock, initial = dict[str, Any](), dict[str, Any]()
    motors, trace = list[str](), list[str]()
    for part in parts:
        name = part.placed.name
        lock |= {prefixed(joint, name): value for joint, value in part.lock.items()}
        motors += [prefixed(joint, name) for joint in part.motors]
        trace += [prefixed_frame(frame, name) for frame in part.trace]
        initial |= _initial(part)
    changes |= {"lock": lock, "actuation": ActuationTable(joints=motors), "trace": trace}
    changes["initial"] = InitialTable(q=initial) if initial else None
    changes |= {key: _agreed(parts, key, usual) for key, usual in _SHARED.items() if key not in settled}
    changes["description"] = "; ".join(f"{part.placed.name}: {part.placed.robot}" for part in parts)
    return RobotTable.model_construct().model_copy(update=changes)


def _agreed(parts: Sequence[Part], key: str, default: Any) -> Any:
    """Value of a key that holds for all parts."""
    asked = [part for part in parts if not part.is_object] or parts
    values = {part.placed.name: getattr(part.body.table, key) or default for part in asked}
    if len(set(values.values())) > 1:
        told = ", ".join(f"{name}: {value}" for name, value in values.items())
        raise RobotError(f"{key}: the files of the parts do not agree ({told}); give {key} beside the parts")
    return next(iter(values.values()))


def _initial(part: Part) -> dict[str, Any]:
    body, q = part.body, initial_pose(part.body)
    ids = {name: joints.joint_id(body.model, name, body.name) for name in posed_joints(body)}
    slices = {name: joints.configuration_slice(body.model, joint) for name, joint in ids.items()}
    return {
        prefixed(name, part.placed.name): q[where].tolist()
        for name, where in slices.items()
        if where.stop > where.start
    }


def _rows(part: Part, key: str) -> list[BaseModel]:
    """Tables of one list, in the names of the whole; motors that options took away are left out."""
    found = []
    for number, row in enumerate(getattr(part.body.table, key)):
        if isinstance(row, JointActuator) and row.joint not in part.motors:
            continue
        kind = {"springs": "spring", "spring_dampers": "spring_damper"}.get(key, getattr(row, "type", None))
        default = f"{kind}_{number}" if key in ("constraints", "springs", "spring_dampers") else None
        found.append(_in_part(row, part.placed.name, default))
    return found


def _in_part(row: Table, part: str, default: str | None) -> Table:
    """A table with the prefix before every name."""
    said = {key: getattr(row, key) for key in type(row).model_fields}
    changes: dict[str, Any] = {}
    for key, renamed in _NAMES.items():
        if said.get(key) is not None:
            changes[key] = renamed(said[key], part)
        if said.get(f"{key}s") is not None:
            several = said[f"{key}s"]
            changes[f"{key}s"] = type(several)(renamed(name, part) for name in several)
    name = said.get("name") or default
    if name is not None:
        changes["name"] = prefixed(name, part)
    return row.model_copy(update=changes)

"""Tables of several robots as one: those of the parts with the prefix of each, and those beside them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import pinocchio as pin
from pydantic import BaseModel

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import DimensionMismatch, RobotError
from mbocp.robot import joints, kinematics
from mbocp.robot.loading.description import Description
from mbocp.robot.loading.locking import by_joint
from mbocp.robot.loading.robot_toml import ActuationTable, InitialTable, JointActuator, RobotTable
from mbocp.robot.placed import SEPARATOR, PlacedRobot

_SHARED = {"gravity": (0.0, 0.0, -9.81), "rotations": "quaternion"}  # of all parts, and what is usual
_UNIVERSE = "universe"  # what Pinocchio calls the frame that stands still; no other can have this name
_LISTS = (
    *("actuators", "drives", "visuals", "collision_spheres"),
    *("constraints", "springs", "spring_dampers", "elastic", "motor"),
)

Table = TypeVar("Table", bound=BaseModel)


@dataclass(frozen=True, eq=False)
class RobotPart:
    """One of several robots: its description with all options said in its tables, and where it stands.

    Parameters
    ----------
    description : Description
        Its table names motors, locked joints with their positions, and frames to trace.
    placed : PlacedRobot
    placement : pin.SE3
        Of the base in the parent frame.
    spec : mapping
        Table that loads the part again from any folder.
    """

    description: Description
    placed: PlacedRobot
    placement: pin.SE3
    spec: Mapping[str, Any]

    def name_of(self, name: str) -> str:
        """Name of its joint or element among those of all."""
        return prefix(name, self.placed.name)

    @property
    def leaves(self) -> tuple[PlacedRobot, ...]:
        """The robots that it consists of, in the names of the whole: itself, if it has no parts."""
        name = self.placed.name
        if not self.description.parts:
            return (self.placed,)
        return tuple(
            replace(part, name=prefix(part.name, name), parent=prefix_frame(part.parent, name))
            for part in self.description.parts
        )


def prefix(name: str, part: str) -> str:
    """Name of a part's joint or element among those of all."""
    return part + SEPARATOR + name


def prefix_frame(name: str, part: str) -> str:
    """Name of a part's frame among those of all; what "world" was to it is the frame that its base is."""
    return prefix(_UNIVERSE if name == kinematics.WORLD else name, part)


# Keys of tables that hold a name; in the plural they hold several.
_NAMES = {"frame": prefix_frame, "joint": prefix}


def joint_positions(part: RobotPart, among: Collection[str] | None = None) -> Iterator[tuple[str, Array]]:
    """Joints of a part that have positions, and these in its pose."""
    model, q = part.description.model, part.description.pose
    for joint in joints.joint_names(model) if among is None else among:
        where = joints.configuration_slice(model, joints.joint_id(model, joint, part.description.name))
        if where.stop > where.start:
            yield joint, q[where]


def combine_tables(parts: Sequence[RobotPart], settled: Collection[str]) -> RobotTable:
    """Make one table of those of all parts, in the names of the whole.

    Parameters
    ----------
    parts : sequence of RobotPart
    settled : collection of str
        Which of gravity and rotations is said beside the parts, so that their files need not agree.
    """
    changes: dict[str, Any] = {key: [row for part in parts for row in _rows(part, key)] for key in _LISTS}
    changes |= _names_in_tables(parts)
    changes |= {key: _common_value(parts, key, usual) for key, usual in _SHARED.items() if key not in settled}
    holds = any(part.description.table.undriven == "hold" for part in parts)
    changes["undriven"] = "hold" if holds else "free"
    changes["description"] = "; ".join(f"{part.placed.name}: {part.placed.robot}" for part in parts)
    return RobotTable.model_construct().model_copy(update=changes)


def _names_in_tables(parts: Sequence[RobotPart]) -> dict[str, Any]:
    """What tables say by names: locked joints, motors, frames to trace, initial positions."""
    lock, initial = dict[str, Any](), dict[str, Any]()
    motors, trace = list[str](), list[str]()
    for part in parts:
        table = part.description.table
        lock |= {part.name_of(joint): value for joint, value in by_joint(table.lock).items()}
        motors += map(part.name_of, table.actuation.joints or ())
        trace += [prefix_frame(frame, part.placed.name) for frame in table.trace or ()]
        posed = joint_positions(part, part.description.posed_joints)
        initial |= {part.name_of(joint): numbers.tolist() for joint, numbers in posed}
    pose = InitialTable(q=initial) if initial else None
    return {"lock": lock, "initial": pose, "actuation": ActuationTable(joints=motors), "trace": trace}


def _common_value(parts: Sequence[RobotPart], key: str, default: Any) -> Any:
    """Value of a key that holds for all parts."""
    asked = [part for part in parts if not part.placed.is_object] or parts
    values = {part.placed.name: getattr(part.description.table, key) or default for part in asked}
    if len(set(values.values())) > 1:
        told = ", ".join(f"{name}: {value}" for name, value in values.items())
        raise RobotError(f"{key}: the files of the parts do not agree ({told}); give {key} beside the parts")
    return next(iter(values.values()))


def _rows(part: RobotPart, key: str) -> list[BaseModel]:
    """Tables of one list, in the names of the whole; motors that options took away are left out."""
    table, name = part.description.table, part.placed.name
    return [
        _in_part(row, name)
        for row in getattr(table, key)
        if not isinstance(row, JointActuator) or row.joint in (table.actuation.joints or ())
    ]


def _in_part(row: Table, part: str) -> Table:
    """A table with the prefix before every name."""
    said = {key: getattr(row, key) for key in type(row).model_fields}
    changes: dict[str, Any] = {}
    for key, renamed in _NAMES.items():
        if said.get(key) is not None:
            changes[key] = renamed(said[key], part)
        if said.get(f"{key}s") is not None:
            several = said[f"{key}s"]
            changes[f"{key}s"] = type(several)(renamed(name, part) for name in several)
    if said.get("name"):
        changes["name"] = prefix(said["name"], part)
    return row.model_copy(update=changes)


def with_own_tables(description: Description, own: RobotTable) -> Description:
    """The description of several parts with the tables that stand beside them, in the names of the whole.

    Lists come after those of the parts. Motors, frames to trace and a description take the place of theirs;
    locked joints and initial positions are beside theirs.
    """
    table = description.table
    changes: dict[str, Any] = {key: [*getattr(table, key), *getattr(own, key)] for key in _LISTS}
    changes["lock"] = {**by_joint(table.lock), **by_joint(own.lock)}
    if own.actuation.joints is not None:
        changes["actuation"] = ActuationTable(joints=own.actuation.joints)
    if own.initial is not None:
        changes["initial"] = _initial(description, own.initial)
    for key in ("trace", "gravity", "rotations"):
        if getattr(own, key) is not None:
            changes[key] = getattr(own, key)
    if own.undriven == "hold":
        changes["undriven"] = "hold"
    if own.description:
        changes["description"] = own.description
    return replace(description, table=table.model_copy(update=changes))


def _initial(description: Description, own: InitialTable) -> InitialTable:
    """Initial positions of the whole, on those of the parts."""
    if not isinstance(own.q, dict):
        return own
    said = description.table.initial
    before = said.q if said is not None and isinstance(said.q, dict) else {}
    return InitialTable(q={**before, **_spread(description, own.q)})


def _spread(description: Description, given: Mapping[str, Any]) -> dict[str, Any]:
    """Positions by joint, where a list may stand for all joints of a part."""
    found: dict[str, Any] = {}
    for name, value in given.items():
        inner = [j for j in joints.joint_names(description.model) if j.startswith(name + SEPARATOR)]
        if not inner or name in description.model.names:
            found[name] = value
            continue
        numbers = list(value) if isinstance(value, Sequence) else [value]
        found |= _by_size(description, f"initial.q.{name}", inner, numbers)
    return found


def _by_size(
    description: Description, key: str, names: Sequence[str], numbers: Sequence[float]
) -> dict[str, Any]:
    kinds = [
        joints.joint_kind(description.model, joints.joint_id(description.model, name, description.name))
        for name in names
    ]
    full = [len(kind.q) for kind in kinds]
    angles = [len(kind.q) - (kind.word in ("continuous", "planar")) for kind in kinds]
    for sizes in (full, angles):
        if sum(sizes) == len(numbers):
            ends = [sum(sizes[: i + 1]) for i in range(len(sizes))]
            return {
                name: list(numbers[end - size : end])
                for name, size, end in zip(names, sizes, ends, strict=True)
                if size
            }
    own = ", ".join(name for name, size in zip(names, full, strict=True) if size)
    raise DimensionMismatch(key, len(numbers), sum(full), f"joints, with those that are locked: {own}")

"""Tables of a whole beside those of its parts: what joins them, its initial pose, its motors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from mbocp.exceptions import DimensionMismatch
from mbocp.robot import joints
from mbocp.robot.loading.actuator_tables import ActuationTable
from mbocp.robot.loading.body import Body
from mbocp.robot.loading.schema import InitialTable, RobotTable
from mbocp.robot.placed import SEPARATOR

_NAMED = {"constraints": "constraint", "springs": "spring", "spring_dampers": "spring_damper"}
_LISTS = ("actuators", "drives", "visuals", "collision_spheres", *_NAMED)


def with_own_tables(body: Body, own: RobotTable) -> Body:
    """The body of several parts with the tables that stand beside them, in the names of the whole.

    Lists come after those of the parts. Motors, frames to trace and a description take the place of theirs;
    locked joints and initial positions are beside theirs.
    """
    table = body.table
    changes: dict[str, Any] = {key: [*getattr(table, key), *_rows(own, key)] for key in _LISTS}
    changes["lock"] = {**by_joint(table.lock), **by_joint(own.lock)}
    if own.actuation.joints is not None:
        changes["actuation"] = ActuationTable(joints=own.actuation.joints)
    if own.initial is not None:
        changes["initial"] = _initial(body, own.initial)
    for key in ("trace", "gravity", "rotations"):
        if getattr(own, key) is not None:
            changes[key] = getattr(own, key)
    if own.description:
        changes["description"] = own.description
    return replace(body, table=table.model_copy(update=changes))


def by_joint(lock: Any) -> dict[str, Any]:
    """Locked joints and their positions; None: at the initial pose."""
    return dict(lock) if isinstance(lock, Mapping) else dict.fromkeys(lock)


def _rows(own: RobotTable, key: str) -> list[Any]:
    """Tables of one list; those that need a name are called by kind and place."""
    rows = getattr(own, key)
    if key not in _NAMED:
        return list(rows)
    kinds = [row.type if key == "constraints" else _NAMED[key] for row in rows]
    return [
        row if row.name else row.model_copy(update={"name": f"{kind}_{number}"})
        for number, (row, kind) in enumerate(zip(rows, kinds, strict=True))
    ]


def _initial(body: Body, own: InitialTable) -> InitialTable:
    """Initial positions of the whole, on those of the parts."""
    if not isinstance(own.q, dict):
        return own
    said = body.table.initial
    before = said.q if said is not None and isinstance(said.q, dict) else {}
    return InitialTable(q={**before, **_spread(body, own.q)})


def _spread(body: Body, given: Mapping[str, Any]) -> dict[str, Any]:
    """Positions by joint, where a list may stand for all joints of a part."""
    found: dict[str, Any] = {}
    for name, value in given.items():
        inner = [j for j in joints.joint_names(body.model) if j.startswith(name + SEPARATOR)]
        if not inner or name in body.model.names:
            found[name] = value
            continue
        numbers = list(value) if isinstance(value, Sequence) else [value]
        found |= _by_size(body, f"initial.q.{name}", inner, numbers)
    return found


def _by_size(body: Body, key: str, names: Sequence[str], numbers: Sequence[float]) -> dict[str, Any]:
    kinds = [joints.joint_kind(body.model, joints.joint_id(body.model, name, body.name)) for name in names]
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
    raise DimensionMismatch(key, len(numbers), sum(full), f"joints: {', '.join(names)}")

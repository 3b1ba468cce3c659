"""`load_parts`: several robots in one world as one `Robot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbocp.exceptions import RobotError
from mbocp.robot.loading.assemble import assemble_robot
from mbocp.robot.loading.locking import Lock
from mbocp.robot.loading.part_table import PartTable, part_of
from mbocp.robot.loading.payload_table import payloads_of
from mbocp.robot.loading.schema import tables_from
from mbocp.robot.loading.whole import whole_of
from mbocp.robot.loading.whole_table import by_joint
from mbocp.robot.payload import Payload
from mbocp.robot.robot import Robot


def load_parts(
    parts: Sequence[PartTable | Mapping[str, Any]],
    *,
    lock: Lock | None = None,
    gravity: Sequence[float] | None = None,
    actuated: Sequence[str] | None = None,
    rotations: str | None = None,
    payload: Sequence[Payload | Mapping[str, Any]] = (),
    constraint: Sequence[Mapping[str, Any]] = (),
    initial: Mapping[str, Any] | None = None,
    name: str | None = None,
    base: Path | None = None,
) -> Robot:
    """Load several robots and bodies that stand in one world, or on each other, as one.

    Parameters
    ----------
    parts : sequence of mapping
        Tables with ``robot`` (name or path), ``name`` (joints and frames of the part are called
        ``name/...``), ``position`` [m] and ``orientation`` (quaternion xyzw, or roll, pitch, yaw [rad]) of
        its base in the frame ``parent`` ("world" by default), and the options of `load_robot` free_flyer,
        lock, actuated, mimic, damping, friction, friction_speed, package_dirs and payload. In place of
        ``robot`` a simple body has ``mass`` [kg], ``com``, ``inertia`` and ``box``, ``sphere`` or
        ``cylinder`` [m], as a `Payload`; it floats unless free_flyer is False.
    lock : mapping or sequence of str, optional
        More joints to make rigid, by their names in the whole.
    gravity : sequence of 3 floats, optional
        Acceleration [m/s^2]. Default: what the files of the parts say.
    actuated : sequence of str, optional
        Joints with motors, by their names in the whole, in place of those of the parts.
    rotations : {"quaternion", "dcm"}, optional
        See `load_robot`.
    payload : sequence of Payload or mapping, optional
        Bodies that frames carry, by their names in the whole, beside those of the parts.
    constraint : sequence of mapping, optional
        What joins frames of the parts: tables as ``[[constraint]]`` of a robot.toml, in names of the whole.
    initial : mapping, optional
        ``{"q": ...}``, the initial pose, as ``[initial]`` of a robot.toml: by joint or part, or as a whole.
    name : str, optional
        What to call the whole. Default: the names of the parts, joined by "+".
    base : Path, optional
        Folder that relative paths start from.

    Returns
    -------
    Robot
        q, v and u have the joints and motors of the parts in their order; those of a part on a moving frame
        follow the joint that moves the frame. Its initial pose closes the loops.

    Raises
    ------
    RobotError
        For a wrong table, parts of the same name, and all that `load_robot` refuses, naming the part.
    LoopNotClosed
        If no pose closes the loops that constraints make.
    """
    tables = [part_of(entry, number) for number, entry in enumerate(parts)]
    if not tables:
        raise RobotError("part: there is none; give at least one table with robot and name")
    beside = {"constraint": [dict(row) for row in constraint]} if constraint else {}
    own = tables_from(beside | ({"initial": initial} if initial is not None else {}))
    title = name or "+".join(table.name for table in tables)
    settled = [key for key, value in (("gravity", gravity), ("rotations", rotations)) if value is not None]
    whole = whole_of(tables, own, title, Path("part"), settled=settled, base=base)
    options = {
        "lock": lock if lock is None or isinstance(lock, Mapping) else list(lock),
        "gravity": None if gravity is None else [float(g) for g in gravity],
        "actuated": None if actuated is None else list(actuated),
        "rotations": rotations,
        "label": name,
        "constraint": [_listed(row.model_dump(exclude_defaults=True)) for row in own.constraints] or None,
        "initial": own.initial if own.initial is None else _listed(own.initial.model_dump()),
    }
    written = {key: value for key, value in options.items() if value is not None}
    return assemble_robot(
        whole.body,
        lock={**by_joint(whole.body.table.lock), **by_joint(lock or {})},
        named_locks=tuple(lock or ()),
        gravity=gravity,
        actuated=actuated,
        rotations=rotations,
        losses=whole.losses,
        carried=payloads_of([*whole.carried, *payload]),
        spec={"part": list(whole.specs), **written},
    )


def _listed(value: Any) -> Any:
    """The value with lists for tuples, as files have them."""
    if isinstance(value, Mapping):
        return {key: _listed(entry) for key, entry in value.items()}
    return [_listed(entry) for entry in value] if isinstance(value, list | tuple) else value

"""`load_robot`: from a name or path to a `Robot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from mbocp._files import path_of
from mbocp._text import shown
from mbocp.exceptions import RobotError, suggest
from mbocp.robot.loading.assemble import assemble_robot
from mbocp.robot.loading.sources import find_source
from mbocp.robot.loading.whole import Options, whole_from_source
from mbocp.robot.loading.world import load_parts
from mbocp.robot.payload import Payload
from mbocp.robot.robot import Robot

LockOption: TypeAlias = dict[str, float | list[float]] | list[str]

# Options of each part; beside several parts they would not say whose.
_OF_PARTS = ("name", "free_flyer", "mimic", "damping", "friction", "friction_speed", "package_dirs")


def load_robot(
    spec: str | Path,
    *,
    free_flyer: bool | None = None,
    lock: Mapping[str, float | Sequence[float]] | Sequence[str] | None = None,
    gravity: Sequence[float] | None = None,
    actuated: Sequence[str] | None = None,
    mimic: bool | None = None,
    damping: bool | None = None,
    friction: str | None = None,
    friction_speed: float | None = None,
    name: str | None = None,
    package_dirs: Sequence[str | Path] = (),
    rotations: str | None = None,
    payload: Sequence[Payload | Mapping[str, Any]] | None = None,
    base: Path | None = None,
) -> Robot:
    """Load a robot.

    Parameters
    ----------
    spec : str or Path
        A path (to a URDF, a robot.toml or robot.yaml, or a folder that holds one), or a name. A text counts
        as a path if it has a path separator or ends in .urdf, .xml, .toml or .yaml. Names are looked up under
        the folders of MBOCP_ROBOT_PATH, in mbocp's own robots/, in example-robot-data, and in
        robot_descriptions, in this order.
    free_flyer : bool, optional
        Whether the root link floats (joint "root_joint") or is fixed to the world. Default: what robot.toml
        or example-robot-data says; fixed for a plain URDF.
    lock : mapping or sequence of str, optional
        Joints to make rigid: name to value [rad, m], or names of joints to lock at the initial pose. Joints
        that mimic them are locked, too. In place of what robot.toml says.
    gravity : sequence of 3 floats, optional
        Acceleration [m/s^2]. Default: what robot.toml says, else (0, 0, -9.81).
    actuated : sequence of str, optional
        Joints with motors, in the order of the controls; a joint with several velocities gets a control for
        each. Default: what robot.toml says, else all revolute, continuous and prismatic joints in the order
        of the model.
    mimic : bool, optional
        Whether mimic joints follow their leader (then they have no coordinate) or are joints of their own,
        with a motor. Default: True for a URDF or robot.toml, False for a robot.yaml and for a name of
        example-robot-data, which are meant so.
    damping : bool, optional
        Whether the viscous damping that the URDF gives joints acts. Default: what robot.toml says, else True.
    friction : {"none", "smooth"}, optional
        Whether the Coulomb friction that the URDF gives joints acts, smoothed where they stop. Default: what
        robot.toml says, else it is left out, and told.
    friction_speed : float, optional
        Speed over which friction is smoothed, F tanh(v / friction_speed) [rad/s, m/s]. Default: what
        robot.toml says, else 0.1.
    name : str, optional
        What to call the robot. Default: the name that was given, or that robot.toml or the URDF gives.
    package_dirs : sequence of str or Path, optional
        Folders that hold the packages of ``package://`` addresses.
    rotations : {"quaternion", "dcm"}, optional
        How explicit schemes represent rotations in their state, see `Robot`. Default: what robot.toml says,
        else "quaternion".
    payload : sequence of Payload or mapping, optional
        Bodies that the robot carries, as `Payload` or as tables of its keys. Default: what robot.toml says.
    base : Path, optional
        Folder that relative paths start from. Default: the working directory.

    Returns
    -------
    Robot

    Raises
    ------
    UnknownRobot, UnknownJoint, UnknownFrame
        For a name that does not exist, with near misses.
    RobotFileError
        For a file that is missing, malformed or says something wrong, naming file and key.
    UnsupportedRobot
        For what mbocp cannot handle, by name.

    Warns
    -----
    MissingMeshWarning
        If meshes are missing; the robot is shown without them.
    NotModelledWarning
        If the URDF says something about the physics that is left out.
    """
    source = find_source(spec, base)
    dirs = tuple(_absolute(d, base) for d in package_dirs)
    options = {
        "free_flyer": free_flyer,
        "lock": _plain_lock(lock),
        "gravity": None if gravity is None else [float(g) for g in gravity],
        "actuated": None if actuated is None else list(actuated),
        "mimic": mimic,
        "damping": damping,
        "friction": friction,
        "friction_speed": friction_speed,
        "label": name,
        "package_dirs": [str(d) for d in dirs] or None,
        "rotations": rotations,
        "payload": None if payload is None else [],  # those that it has in the end name themselves
    }
    whole = whole_from_source(
        source, Options(free_flyer, mimic, damping, friction, friction_speed, payload, dirs)
    )
    body = whole.body if name is None else replace(whole.body, name=name)
    echo = {
        "name": source.address,
        **{key: value for key, value in options.items() if value is not None},
    }
    return assemble_robot(
        body,
        lock=lock,
        named_locks=tuple(lock or ()),
        gravity=gravity,
        actuated=actuated,
        rotations=rotations,
        losses=whole.losses,
        carried=whole.carried,
        spec=echo,
    )


class _Spec(BaseModel):
    """The table form of `load_robot`: a problem file's [robot]."""

    model_config = ConfigDict(extra="forbid", defer_build=True)

    name: str | None = None
    part: list[dict[str, Any]] | None = None
    free_flyer: bool | None = None
    lock: dict[str, float | list[float]] | list[str] | None = None
    gravity: tuple[float, float, float] | None = None
    actuated: list[str] | None = None
    mimic: bool | None = None
    damping: bool | None = None
    friction: str | None = None
    friction_speed: float | None = None
    label: str | None = None
    package_dirs: list[str] = []
    rotations: str | None = None
    payload: list[dict[str, Any]] | None = None
    constraint: list[dict[str, Any]] | None = None
    initial: dict[str, Any] | None = None


def robot_from_spec(spec: Mapping[str, Any], *, base: Path | None = None) -> Robot:
    """Load a robot from a table: a problem file's ``[robot]``, or `Robot.spec`.

    Parameters
    ----------
    spec : mapping
        ``name`` (name or path) and the options of `load_robot`: free_flyer, lock, gravity, actuated, mimic,
        damping, friction, friction_speed, package_dirs, rotations, payload, and ``label``: what to call it.
        Or ``part`` and the options of `load_parts`.
    base : Path, optional
        Folder that relative paths start from.

    Raises
    ------
    RobotError
        For an unknown key or a wrong value, naming it, and for all that `load_robot` refuses.
    """
    try:
        table = _Spec.model_validate(dict(spec))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(step) for step in first["loc"][:1])
        if first["type"] == "extra_forbidden":
            raise RobotError(f"robot: unknown key {key!r}; {suggest(key, _Spec.model_fields)}") from error
        raise RobotError(f"robot.{key}: got {shown(first['input'])}: {first['msg']}") from error
    if table.part is not None:
        return _world(table, base)
    if table.name is None:
        raise RobotError("robot.name: is required: name or path of a robot; or give tables [[robot.part]]")
    for key in ("constraint", "initial"):
        if getattr(table, key) is not None:
            raise RobotError(f"robot.{key}: goes with robot.part; a single robot says it in its robot.toml")
    options = table.model_dump(exclude={"name", "label", "part", "constraint", "initial"})
    return load_robot(table.name, name=table.label, base=base, **options)


def _world(table: _Spec, base: Path | None) -> Robot:
    """Several robots; what is a matter of each of them is refused beside them."""
    for key in _OF_PARTS:
        if getattr(table, key) not in (None, []):
            raise RobotError(f"robot.{key}: does not go with robot.part; write it into each part")
    return load_parts(
        table.part or [],
        lock=table.lock,
        gravity=table.gravity,
        actuated=table.actuated,
        rotations=table.rotations,
        payload=table.payload or (),
        constraint=table.constraint or (),
        initial=table.initial,
        name=table.label,
        base=base,
    )


def _plain_lock(lock: Mapping[str, float | Sequence[float]] | Sequence[str] | None) -> Any:
    if lock is None:
        return None
    if isinstance(lock, Mapping):
        return {name: np.asarray(value, dtype=float).tolist() for name, value in lock.items()}
    return list(lock)


def _absolute(path: str | Path, base: Path | None) -> Path:
    expanded = path_of(path)
    return (expanded if base is None else base / expanded).resolve()

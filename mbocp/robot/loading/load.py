"""`load_robot`: from a name or path to a `Robot`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from pydantic import BaseModel, ConfigDict, ValidationError

from mbocp._arrays import Array
from mbocp._files import path_of
from mbocp._text import shown
from mbocp.exceptions import (
    DimensionMismatch,
    InvalidValue,
    RobotError,
    RobotFileError,
    UnsupportedRobot,
    suggest,
)
from mbocp.robot import joints
from mbocp.robot.loading.ball_joints import make_spherical
from mbocp.robot.loading.chain import chain_description, chain_urdf, num_links
from mbocp.robot.loading.checks import check_mechanics
from mbocp.robot.loading.drive_checks import check_drives
from mbocp.robot.loading.elements import Assembly
from mbocp.robot.loading.examples import load_example
from mbocp.robot.loading.initial_pose import close_loops
from mbocp.robot.loading.locking import lock_joints, pose_by_joint
from mbocp.robot.loading.mimic import Follower, followers
from mbocp.robot.loading.payload_table import payloads_of
from mbocp.robot.loading.resistances import Losses, joint_resistances
from mbocp.robot.loading.robot_yaml import read_robot_yaml
from mbocp.robot.loading.schema import RobotTable, read_robot_toml
from mbocp.robot.loading.sources import Source, find_source
from mbocp.robot.loading.urdf import ROOT_JOINT, Urdf, build_model, read_urdf
from mbocp.robot.loading.visuals import build_visuals, resolve
from mbocp.robot.payload import Payload
from mbocp.robot.resistance import FRICTION_SPEED
from mbocp.robot.robot import Robot

__all__ = ["load_robot", "robot_from_spec"]

LockOption: TypeAlias = dict[str, float | list[float]] | list[str]

# A URDF that says "mimic" means it. example-robot-data builds its models without, as do the collections that
# have a robot.yaml, whose motors may be on such joints.
_MIMIC = {"toml": True, "yaml": False, "urdf": True, "chain": True, "example": False}

_BASE_NQ = 7  # numbers of a free-flyer's configuration


@dataclass(frozen=True, eq=False)
class _Body:
    """A model before locking, with its visuals, pose and tables."""

    model: pin.Model
    visuals: pin.GeometryModel
    q0: Array
    urdf: Path | None
    name: str
    table: RobotTable
    file: Path
    followers: tuple[Follower, ...] = ()


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
    body = _body(source, free_flyer, mimic, dirs)
    body = body if name is None else replace(body, name=name)
    echo = {
        "name": source.address,
        **{key: value for key, value in options.items() if value is not None},
    }
    losses = _losses(body.table, damping, friction, friction_speed)
    carried = payloads_of(body.table.payloads if payload is None else payload)
    return _assemble(body, lock, gravity, actuated, rotations, losses, carried, echo)


class _Spec(BaseModel):
    """The table form of `load_robot`: a problem file's [robot]."""

    model_config = ConfigDict(extra="forbid")

    name: str
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


def robot_from_spec(spec: Mapping[str, Any], *, base: Path | None = None) -> Robot:
    """Load a robot from a table: a problem file's ``[robot]``, or `Robot.spec`.

    Parameters
    ----------
    spec : mapping
        ``name`` (name or path) and the options of `load_robot`: free_flyer, lock, gravity, actuated, mimic,
        damping, friction, friction_speed, package_dirs, rotations, payload, and ``label``: what to call it.
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
    options = table.model_dump(exclude={"name", "label"})
    return load_robot(table.name, name=table.label, base=base, **options)


def _body(source: Source, free_flyer: bool | None, mimic: bool | None, dirs: tuple[Path, ...]) -> _Body:
    follow = _MIMIC[source.kind] if mimic is None else mimic
    if source.kind == "example":
        example = load_example(source.name, free_flyer=free_flyer, mimic=follow, packages=list(dirs))
        return _Body(
            example.model,
            example.visuals,
            example.q0,
            example.path,
            source.name,
            RobotTable(),
            example.path,
            example.followers,
        )
    if source.kind == "chain":
        return _chain(source.name, bool(free_flyer), follow)
    table, path, name, folders = RobotTable(), source.path, None, [*dirs, *source.package_dirs]
    if source.kind == "toml":
        table = read_robot_toml(source.path)
        folder = source.path.parent
        folders += [folder / d for d in table.package_dirs]
        try:
            path = resolve(table.urdf, folder, folders)
        except FileNotFoundError as error:
            raise RobotFileError(source.path, str(error), "urdf") from error
        name = table.name or source.name
        follow = table.mimic if mimic is None and table.mimic is not None else follow
    if source.kind == "yaml":
        return _from_yaml(source, bool(free_flyer), follow, folders)
    urdf = read_urdf(path)
    floating = bool(table.free_flyer) if free_flyer is None else free_flyer
    model = build_model(urdf, free_flyer=floating, mimic=follow)
    model = make_spherical(model, table.spherical, name or urdf.name)
    visuals = build_visuals(urdf, model, folders)
    return _body_of(urdf, model, visuals, name or urdf.name, table, source.path, follow)


def _body_of(
    urdf: Urdf,
    model: pin.Model,
    visuals: pin.GeometryModel,
    name: str,
    table: RobotTable,
    file: Path,
    follow: bool,
) -> _Body:
    """Model, visuals and tables from a URDF."""
    tied = followers(urdf.path, urdf.root) if follow else ()
    return _Body(model, visuals, pin.neutral(model), urdf.path, name, table, file, tied)


def _from_yaml(source: Source, free_flyer: bool, mimic: bool, folders: list[Path]) -> _Body:
    """A URDF with a robot.yaml beside it; the URDF is robot.urdf, or the only one."""
    told, folder = read_robot_yaml(source.path), source.path.parent
    held = sorted(folder.glob("*.urdf"))
    path = folder / "robot.urdf" if len(held) != 1 else held[0]
    urdf = read_urdf(path)
    table = told.table(urdf)
    urdf = told.with_joints(urdf, source.path)
    model = make_spherical(
        build_model(urdf, free_flyer=free_flyer, mimic=mimic), table.spherical, source.name
    )
    visuals = build_visuals(urdf, model, folders)
    return _body_of(urdf, model, visuals, source.name, table, source.path, mimic)


def _chain(name: str, free_flyer: bool, mimic: bool) -> _Body:
    links = num_links(name) or 0
    urdf, table = chain_urdf(links), RobotTable(description=chain_description(links))
    model = build_model(urdf, free_flyer=free_flyer, mimic=mimic)
    return _Body(model, build_visuals(urdf, model, []), pin.neutral(model), None, name, table, urdf.path)


def _assemble(
    body: _Body,
    lock: Mapping[str, float | Sequence[float]] | Sequence[str] | None,
    gravity: Sequence[float] | None,
    actuated: Sequence[str] | None,
    rotations: str | None,
    losses: Losses,
    carried: tuple[Payload, ...],
    echo: dict[str, Any],
) -> Robot:
    joints.check_joints(body.model, body.name)
    if body.model.nv == 0:
        raise UnsupportedRobot(f"robot {body.name!r}: has no joint that moves")
    locks = body.table.lock if lock is None else lock
    model, visuals, q0 = lock_joints(body.model, body.visuals, _initial_pose(body), locks, body.name)
    _set_gravity(model, gravity if gravity is not None else body.table.gravity, body.name)
    gone = tuple(set(body.model.names) - set(model.names))
    tied = tuple(follower for follower in body.followers if follower.name not in gone)
    parts = Assembly(model, gone, q0, body.table, body.name, body.file, tied)
    actuation, efforts = parts.actuation(actuated)
    constraints, forces = parts.constraints(), parts.forces()
    robot = Robot(
        name=body.name,
        model=model,
        visual_model=visuals,
        actuation=actuation,
        constraints=constraints,
        forces=forces,
        q0=q0,
        limits=parts.limits(efforts),
        source=body.urdf,
        trace_frames=parts.trace_frames(),
        connectors=parts.connectors((*constraints, *forces)),
        spec=echo,
        description=body.table.description,
        rotations=rotations or body.table.rotations or "quaternion",
        resistances=joint_resistances(model, tied, losses, body.name),
    )
    robot = close_loops(robot, _posed(body.table, robot))  # a pose that does not depend on what it carries
    robot = robot.with_payload(*carried) if carried else robot
    check_drives(robot)
    check_mechanics(robot)
    return robot


def _losses(table: RobotTable, damping: bool | None, friction: str | None, speed: float | None) -> Losses:
    """Losses: options take precedence over robot.toml, and robot.toml over defaults."""
    said = ((damping, table.damping, True), (speed, table.friction_speed, FRICTION_SPEED))
    acts, scale = (next(value for value in values if value is not None) for values in said)
    return Losses(bool(acts), table.friction if friction is None else friction, float(scale))


def _initial_pose(body: _Body) -> Array:
    """The pose that the body came with, and [initial] q of the robot.toml on it."""
    model, table = body.model, body.table
    if table.initial is None:
        return body.q0
    if isinstance(table.initial.q, dict):
        return pose_by_joint(model, body.q0, table.initial.q, body.name)
    floats, meant = ROOT_JOINT in model.names, bool(table.free_flyer)  # the option may differ from the file
    given = np.array(table.initial.q[_BASE_NQ:] if meant and not floats else table.initial.q)
    base = _BASE_NQ if floats and not meant else 0
    if given.shape != (model.nq - base,):
        raise DimensionMismatch(f"{body.file}: initial.q", given.shape, (model.nq - base,))
    q = np.concatenate([body.q0[:base], given])
    parts = {
        model.names[j]: q[joints.configuration_slice(model, j)].tolist()
        for j in range(1, model.njoints)
        if model.joints[j].nq > 0
    }
    return pose_by_joint(model, q, parts, body.name)  # each joint checks and normalises its own part


def _posed(table: RobotTable, robot: Robot) -> list[str]:
    """Joints whose initial position was written."""
    if table.initial is None:
        return []
    written = table.initial.q if isinstance(table.initial.q, dict) else robot.joint_names
    return [name for name in written if name in robot.joint_names]


def _set_gravity(model: pin.Model, gravity: Sequence[float] | None, robot: str) -> None:
    if gravity is None:
        return
    vector = np.array(gravity, dtype=float)
    if vector.shape != (3,):
        raise DimensionMismatch(f"robot {robot!r}: gravity", vector.shape, (3,))
    if not np.isfinite(vector).all():
        raise InvalidValue(f"robot {robot!r}: gravity", vector.tolist(), "three finite numbers [m/s^2]")
    model.gravity.linear = vector


def _plain_lock(lock: Mapping[str, float | Sequence[float]] | Sequence[str] | None) -> Any:
    if lock is None:
        return None
    if isinstance(lock, Mapping):
        return {name: np.asarray(value, dtype=float).tolist() for name, value in lock.items()}
    return list(lock)


def _absolute(path: str | Path, base: Path | None) -> Path:
    expanded = path_of(path)
    return (expanded if base is None else base / expanded).resolve()

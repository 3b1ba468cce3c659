"""`load_robot` and `load_parts`: from names, paths and tables to a `Robot`.

All ways make the keys of `[robot]`, and a description of them: of one robot, or of the parts of a world.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mbocp._arrays import plain
from mbocp._measured import plain_number
from mbocp.exceptions import RobotError
from mbocp.robot.loading.assemble import assemble_robot
from mbocp.robot.loading.describe import describe_parts, describe_source, inertias_of, read_parts
from mbocp.robot.loading.description import Description
from mbocp.robot.loading.robot_keys import OF_FILES, PartTable, RobotKeys, read_part, read_robot_keys
from mbocp.robot.loading.robot_sources import find_source
from mbocp.robot.loading.robot_tables import ElasticTable, MotorTable, payloads_of, read_inertias, read_rows
from mbocp.robot.loading.robot_toml import tables_from
from mbocp.robot.named_numbers import take, with_numbers
from mbocp.robot.payload import Payload
from mbocp.robot.robot import Robot

# Keys of each part; beside several parts they would not say whose.
_OF_PARTS = ("name", *OF_FILES, "package_dirs")
# They take the place of what the tables of a robot say.
_OF_THE_WHOLE = ("lock", "gravity", "rotations", "elastic", "motor")


def load_robot(
    spec: str | Path,
    *,
    free_flyer: bool | None = None,
    lock: Mapping[str, float | Sequence[float]] | Sequence[str] | None = None,
    gravity: Sequence[float] | None = None,
    actuated: Sequence[str] | None = None,
    mimic: bool | None = None,
    dynamics: bool | None = None,
    inertias: Mapping[str, Any] | None = None,
    damping: bool | None = None,
    friction: str | None = None,
    friction_speed: float | None = None,
    arguments: Mapping[str, Any] | None = None,
    name: str | None = None,
    package_dirs: Sequence[str | Path] = (),
    rotations: str | None = None,
    payload: Sequence[Payload | Mapping[str, Any]] | None = None,
    elastic: Sequence[Mapping[str, Any]] | None = None,
    motor: Sequence[Mapping[str, Any]] | None = None,
    numbers: Mapping[str, float] | None = None,
    base: Path | None = None,
) -> Robot:
    """Load a robot.

    Parameters
    ----------
    spec : str or Path
        A path (to a robot.toml, a URDF or a file of another format, or a folder that holds one), or a name. A
        text counts as a path if it has a path separator or the ending of such a file. Names are looked up
        under the folders of MBOCP_ROBOT_PATH, in mbocp's own robots/, in example-robot-data, and in
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
    dynamics : bool, optional
        False: controls are the accelerations of the joints, and links need no inertias. Default: what
        robot.toml says, else True.
    inertias : mapping, optional
        Masses and inertias that the file does not give: `density` [kg/m^3] of the shapes of links, or `mass`
        [kg] of the whole robot, and `links`, by name. Default: what robot.toml says.
    damping : bool, optional
        Whether the viscous damping that the file gives joints acts. Default: what robot.toml says, else True.
    friction : {"none", "smooth"}, optional
        Whether the Coulomb friction that the file gives joints acts, smoothed where they stop. Default: what
        robot.toml says, else it is left out, and told.
    friction_speed : float, optional
        Speed over which friction is smoothed, F tanh(v / friction_speed) [rad/s, m/s]. Default: what
        robot.toml says, else 0.1.
    arguments : mapping, optional
        Values of the arguments of a xacro file, beside those that robot.toml gives.
    name : str, optional
        What to call the robot. Default: the name that was given, or that robot.toml or the URDF gives.
    package_dirs : sequence of str or Path, optional
        Folders that hold the packages of ``package://`` addresses.
    rotations : {"quaternion", "dcm"}, optional
        How explicit schemes represent rotations in their state, see `Robot`. Default: what robot.toml says,
        else "quaternion".
    payload : sequence of Payload or mapping, optional
        Bodies that the robot carries, as `Payload` or as tables of its keys. Default: what robot.toml says.
    elastic : sequence of mapping, optional
        Joints that springs join to their motors: tables with ``joint``, ``stiffness`` [N m/rad, N/m],
        ``damping`` [N m s/rad, N s/m] and ``motor_inertia`` [kg m^2, kg]. Default: what robot.toml says.
    motor : sequence of mapping, optional
        Motors that turn joints by gears: tables with ``joint``, ``gear_ratio``, ``inertia`` [kg m^2],
        ``effort`` [N m] and ``speed`` [rad/s], all before the gear. Default: what robot.toml says.
    numbers : mapping, optional
        Other values of numbers by their words, see `mbocp.robot.with_numbers`.
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
        If the file says something about the physics that is left out.
    EstimatedInertiaWarning
        If `inertias` gives links masses and inertias of their shapes.
    """
    return load_keys(
        RobotKeys.model_construct(
            name=spec,
            free_flyer=free_flyer,
            lock=plain(lock),
            gravity=None if gravity is None else [float(g) for g in gravity],
            actuated=None if actuated is None else list(actuated),
            mimic=mimic,
            dynamics=dynamics,
            inertias=read_inertias(inertias),
            damping=damping,
            friction=friction,
            friction_speed=friction_speed,
            arguments=plain(arguments),
            label=name,
            package_dirs=[str(folder) for folder in package_dirs],
            rotations=rotations,
            payload=payload,
            elastic=read_rows(ElasticTable, "elastic", elastic),
            motor=read_rows(MotorTable, "motor", motor),
            numbers=plain(numbers),
        ),
        base,
    )


def load_parts(
    parts: Sequence[PartTable | Mapping[str, Any]],
    *,
    lock: Mapping[str, float | Sequence[float]] | Sequence[str] | None = None,
    gravity: Sequence[float] | None = None,
    actuated: Sequence[str] | None = None,
    rotations: str | None = None,
    payload: Sequence[Payload | Mapping[str, Any]] = (),
    elastic: Sequence[Mapping[str, Any]] | None = None,
    motor: Sequence[Mapping[str, Any]] | None = None,
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
        lock, actuated, mimic, dynamics, inertias, damping, friction, friction_speed, arguments, package_dirs
        and payload. In place of ``robot`` a simple body has ``mass`` [kg], ``com``, ``inertia`` and ``box``,
        ``sphere`` or ``cylinder`` [m], as a `Payload`; it floats unless free_flyer is False.
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
    elastic, motor : sequence of mapping, optional
        See `load_robot`; in names of the whole, beside those of the parts.
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
    return load_keys(
        RobotKeys.model_construct(
            part=[read_part(entry, number) for number, entry in enumerate(parts)],
            lock=plain(lock),
            gravity=None if gravity is None else [float(g) for g in gravity],
            actuated=None if actuated is None else list(actuated),
            label=name,
            rotations=rotations,
            payload=payload or None,
            elastic=read_rows(ElasticTable, "elastic", elastic),
            motor=read_rows(MotorTable, "motor", motor),
            constraint=plain(constraint) or None,
            initial=plain(initial),
        ),
        base,
    )


def robot_from_spec(spec: Mapping[str, Any], *, base: Path | None = None) -> Robot:
    """Load a robot from a table: a problem file's ``[robot]``, or `Robot.spec`.

    Parameters
    ----------
    spec : mapping
        ``name`` (name or path) and the options of `load_robot`: free_flyer, lock, gravity, actuated, mimic,
        dynamics, inertias, damping, friction, friction_speed, arguments, package_dirs, rotations, payload,
        elastic, motor, numbers, and ``label``: what to call it. Or ``part`` and the options of `load_parts`.
    base : Path, optional
        Folder that relative paths start from.

    Raises
    ------
    RobotError
        For an unknown key or a wrong value, naming it, and for all that `load_robot` refuses.
    """
    return load_keys(read_robot_keys(spec), base)


def load_keys(keys: RobotKeys, base: Path | None) -> Robot:
    """Load what the keys of `[robot]` name; relative paths start from the folder `base`.

    Raises
    ------
    RobotError
        For keys that do not go together, and for all that `load_robot` refuses.
    """
    found, spec = _alone(keys, base) if keys.part is None else _together(keys, keys.part, base)
    named = replace(found, named_locks=found.named_locks | set(keys.lock or ()))
    spec |= keys.portable(base, "name", "part")
    spec |= inertias_of(found) if keys.part is None else {}
    if keys.payload is not None:
        spec["payload"] = []  # those that it has in the end name themselves
    robot = assemble_robot(named, keys.actuated, spec)
    if not keys.numbers:
        return robot
    numbers = keys.numbers.items()
    return with_numbers(robot, {w: plain_number(x, take(robot, w).unit, f"numbers.{w}") for w, x in numbers})


def _alone(keys: RobotKeys, base: Path | None) -> tuple[Description, dict[str, Any]]:
    """A single robot, and what names it from any folder."""
    for key in ("constraint", "initial"):
        if getattr(keys, key) is not None:
            raise RobotError(f"robot.{key}: goes with robot.part; a single robot says it in its robot.toml")
    source = find_source(keys.name or "", base)
    found = describe_source(source, keys, keys.folders(base))
    table = found.table.model_copy(update=_find_keys_given(keys))
    return replace(found, name=keys.label or found.name, table=table), {"name": source.address}


def _together(
    keys: RobotKeys, tables: Sequence[PartTable], base: Path | None
) -> tuple[Description, dict[str, Any]]:
    """Several robots in one world, and what names them from any folder."""
    for key in _OF_PARTS:
        if getattr(keys, key) not in (None, []):
            raise RobotError(f"robot.{key}: does not go with robot.part; write it into each part")
    if not tables:
        raise RobotError("part: there is none; give at least one table with robot and name")
    beside = {key: getattr(keys, key) for key in ("constraint", "initial") if getattr(keys, key) is not None}
    own = tables_from(beside).model_copy(update=_find_keys_given(keys))
    parts = read_parts(tables, base)
    name = keys.label or "+".join(table.name for table in tables)
    found = describe_parts(parts, own, name, Path("part"))
    carried = payloads_of([*found.carried, *(keys.payload or ())])
    return replace(found, carried=carried), {"part": [part.spec for part in parts]}


def _find_keys_given(keys: RobotKeys) -> dict[str, Any]:
    return {key: getattr(keys, key) for key in _OF_THE_WHOLE if getattr(keys, key) is not None}

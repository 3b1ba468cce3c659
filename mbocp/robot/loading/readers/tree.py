"""From a tree of bodies to the model of a robot, for formats whose files Pinocchio does not read."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._text import find_repeated, has_control_characters, list_names, show, warn_caller
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.robot import joints
from mbocp.robot.collision.geometry import LinkShape, ShapeSource
from mbocp.robot.kinematics import WORLD
from mbocp.robot.loading.description import ROOT_JOINT, Description, Oddity, ReadOptions
from mbocp.robot.loading.readers.urdf_checks import MAX_CHAIN_LENGTH, MAX_MOVING_JOINTS
from mbocp.robot.loading.readers.urdf_inertia import tell_impossible_inertias
from mbocp.robot.loading.readers.urdf_shapes import object_of
from mbocp.robot.loading.robot_toml import RobotTable
from mbocp.robot.warnings import MissingMeshWarning, NotModelledWarning

ELLIPSOIDS = "ellipsoids, neither drawn nor solid, of"  # coal's obstacles and pages have no such shape
_MAX_NAMES = 5
_MAX_NAME_LENGTH = 255
_MODELS: dict[str, Callable[[Array], Any]] = {
    "revolute": lambda axis: pin.JointModelRevoluteUnaligned(axis),
    "prismatic": lambda axis: pin.JointModelPrismaticUnaligned(axis),
    "ball": lambda _: pin.JointModelSpherical(),
    "free": lambda _: pin.JointModelFreeFlyer(),
}
_ALIGNED = {
    "revolute": (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ),
    "prismatic": (pin.JointModelPX, pin.JointModelPY, pin.JointModelPZ),
}


@dataclass
class TreeJoint:
    """A joint between a body and its parent.

    Attributes
    ----------
    name : str
    kind : {"revolute", "prismatic", "ball", "free"}
    axis : ndarray, shape (3,)
        Unit vector in the axes of the body.
    anchor : pin.SE3
        Where the joint is in the body.
    reference : float
        Displacement with which the body is placed as it is written [rad, m].
    lower, upper : float
        Of the displacement [rad, m].
    velocity, effort : float
        [rad/s, m/s; N m, N].
    effort_lower : float, optional
        Least effort [N m, N]; default ``-effort``.
    damping, friction, armature : float
        [N m s/rad, N s/m; N m, N; kg m^2, kg].
    held : float, optional
        Displacement at which it is rigid [rad, m]; then the model has no such joint.
    """

    name: str
    kind: str
    axis: Array = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    anchor: pin.SE3 = field(default_factory=pin.SE3.Identity)
    reference: float = 0.0
    lower: float = -math.inf
    upper: float = math.inf
    velocity: float = math.inf
    effort: float = math.inf
    effort_lower: float | None = None
    damping: float = 0.0
    friction: float = 0.0
    armature: float = 0.0
    held: float | None = None

    @property
    def has_axis(self) -> bool:
        """Whether it has one displacement, about an axis or along it."""
        return self.kind in _ALIGNED

    def motion(self, displacement: float) -> pin.SE3:
        """What the joint does from the reference to a displacement, of one without an axis nothing."""
        change = displacement - self.reference
        if self.kind == "prismatic":
            return pin.SE3(np.eye(3), change * self.axis)
        if self.kind == "revolute":
            return pin.SE3(pin.exp3(change * self.axis), np.zeros(3))
        return pin.SE3.Identity()


@dataclass
class TreeShape:
    """A shape of a body, drawn or solid or both."""

    shape: LinkShape
    color: Array | None
    is_drawn: bool = True
    is_solid: bool = True


class MissingMesh(NamedTuple):
    """A mesh that is not there: whose it is, why, and whether it may collide."""

    where: str
    reason: str
    is_solid: bool


@dataclass
class TreeBody:
    """A body.

    Attributes
    ----------
    name : str
    parent : str or None
        Body that it hangs on; None: the world.
    placement : pin.SE3
        In the parent, where the joints are at their references.
    joints : list of TreeJoint
        From the parent to the body; none: it is fixed.
    inertia : pin.Inertia
        In the body.
    shapes : list of TreeShape
    frames : list of (str, pin.SE3)
        Named places on the body.
    missing : list of MissingMesh
    """

    name: str
    parent: str | None
    placement: pin.SE3 = field(default_factory=pin.SE3.Identity)
    joints: list[TreeJoint] = field(default_factory=list)
    inertia: pin.Inertia = field(default_factory=pin.Inertia.Zero)
    shapes: list[TreeShape] = field(default_factory=list)
    frames: list[tuple[str, pin.SE3]] = field(default_factory=list)
    missing: list[MissingMesh] = field(default_factory=list)


@dataclass
class LeftOut:
    """What a file says and the model does not have: names by kind."""

    names: dict[str, list[str]] = field(default_factory=dict)

    def add(self, kind: str, name: str) -> None:
        """Note something."""
        self.names.setdefault(kind, []).append(name)


class _Place(NamedTuple):
    """Where a body is in the model: its joint, its placement there, its frame."""

    joint: int
    placement: pin.SE3
    frame: int


def describe_tree(
    path: Path,
    name: str,
    bodies: Sequence[TreeBody],
    table: RobotTable,
    left_out: LeftOut,
    how: ReadOptions,
    disabled: Callable[[], frozenset[frozenset[str]]] = frozenset,
) -> Description:
    """Describe the robot that bodies make, parents before children; q has the order of the bodies.

    Parameters
    ----------
    path : Path
        Of the file.
    name : str
        Of the robot.
    bodies : sequence of TreeBody
    table : RobotTable
        What else the file says.
    left_out : LeftOut
        What is not modelled.
    how : ReadOptions
        With `free_flyer` False bodies that float in the world are fixed to it; with True what is fixed to it
        floats as a whole.
    disabled : callable
        Returns the pairs of bodies that do not collide.

    Raises
    ------
    RobotFileError, UnsupportedRobot
        For names that occur twice, for more joints than there may be, and for estimates of masses: these
        formats give every body one, by numbers or by its shapes.

    Warns
    -----
    NotModelledWarning, ImpossibleInertiaWarning, MissingMeshWarning
        Each once for the robot.
    """
    if how.inertias is not None:
        raise RobotFileError(path, "estimates are for URDF and xacro; write the numbers here", "inertias")
    _check_free_joints(path, bodies, how.free_flyer)
    _check_names(path, bodies)
    model = _build(name, bodies, how.free_flyer)
    _tell_left_out(path, left_out)
    tell_impossible_inertias(path, model)
    _tell_missing(path, bodies)
    visuals = pin.GeometryModel()
    for drawn in (shape for body in bodies for shape in body.shapes if shape.is_drawn):
        visuals.addGeometryObject(object_of(model, drawn.shape, drawn.color))
    with_pictures = frozenset(body.name for body in bodies if any(shape.is_drawn for shape in body.shapes))
    return Description(
        name=name,
        file=path,
        model=model,
        visuals=visuals,
        q0=_place_at_references(model, bodies),
        table=table,
        source=path,
        shapes=(ShapeSource(path, partial(_solid, path, bodies), disabled, with_pictures),),
    )


def oddities_of(bodies: Sequence[TreeBody]) -> Iterator[Oddity]:
    """Joints that cannot move."""
    for joint in (joint for body in bodies for joint in body.joints):
        if joint.lower >= joint.upper:
            yield Oddity(
                f"its limits {joint.lower:g} ... {joint.upper:g} leave it no range", joint=joint.name
            )


def _build(name: str, bodies: Sequence[TreeBody], free_flyer: bool | None) -> pin.Model:
    model = pin.Model()
    model.name = name
    root = 0
    if free_flyer and not any(joint.kind == "free" for body in bodies for joint in body.joints):
        root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), ROOT_JOINT)
        model.addJointFrame(root, 0)
    places: dict[str | None, _Place] = {None: _Place(root, pin.SE3.Identity(), 0)}
    for body in bodies:
        places[body.name] = _add(model, body, places[body.parent])
    return model


def _place_at_references(model: pin.Model, bodies: Sequence[TreeBody]) -> Array:
    """The configuration in which bodies are placed as they are written, shape (nq,)."""
    q: Array = pin.neutral(model)
    for body in bodies:
        for joint in body.joints:
            if not model.existJointName(joint.name):
                continue
            where = joints.configuration_slice(model, model.getJointId(joint.name))
            if joint.kind == "free":
                q[where] = pin.SE3ToXYZQUAT(body.placement)
            elif joint.kind != "ball":
                q[where] = joint.reference
    return q


def placements_of(bodies: Sequence[TreeBody]) -> dict[str, pin.SE3]:
    """Where bodies are in the world as they are written."""
    placed = {WORLD: pin.SE3.Identity()}
    for body in bodies:
        placed[body.name] = placed[body.parent or WORLD] * body.placement
    return placed


def _tell_left_out(path: Path, left_out: LeftOut) -> None:
    """Warn of what is not modelled, naming each."""
    if left_out.names:
        told = (f"{kind} {list_names(names, _MAX_NAMES)}" for kind, names in left_out.names.items())
        warn_caller(f"{path}: not modelled, and left out: {'; '.join(told)}", NotModelledWarning)


def _tell_missing(path: Path, bodies: Sequence[TreeBody]) -> None:
    """Warn of meshes that are not there, naming the first."""
    missing = [mesh for body in bodies for mesh in body.missing]
    if missing:
        more = f", and {len(missing) - 1} more" if len(missing) > 1 else ""
        first = f"{missing[0].where}: {missing[0].reason}"
        warn_caller(f"{path}: shown without its missing meshes ({first}{more})", MissingMeshWarning)


def _solid(path: Path, bodies: Sequence[TreeBody]) -> Iterator[LinkShape]:
    """Shapes that bodies collide with."""
    for body in bodies:
        for mesh in body.missing:
            if mesh.is_solid:
                raise RobotFileError(path, f"{mesh.where}: its mesh is missing: {mesh.reason}")
        yield from (each.shape for each in body.shapes if each.is_solid)


def _check_free_joints(path: Path, bodies: Sequence[TreeBody], free_flyer: bool | None) -> None:
    """Refuse free joints where none may be; the only one is called as that of a URDF."""
    floating = [body for body in bodies if any(joint.kind == "free" for joint in body.joints)]
    for body in floating:
        if body.parent is not None or len(body.joints) > 1:
            raise UnsupportedRobot(
                f"{path}: body {show(body.name)} has a free joint, but it hangs on {show(body.parent)}"
                if body.parent is not None
                else f"{path}: body {show(body.name)} has other joints beside its free joint"
            )
        if free_flyer is False:
            body.joints.clear()
        elif len(floating) == 1:
            body.joints[0].name = ROOT_JOINT


def _add(model: pin.Model, body: TreeBody, parent: _Place) -> _Place:
    """A body and its joints, from the outermost to the innermost."""
    joint, frame = parent.joint, parent.frame
    is_free = bool(body.joints) and body.joints[0].kind == "free"
    placement = pin.SE3.Identity() if is_free else parent.placement * body.placement
    for each in body.joints:
        placement = placement * each.anchor * each.motion(0.0 if each.held is None else each.held)
        if each.held is not None:
            placement = placement * each.anchor.inverse()
            continue
        joint = model.addJoint(joint, _joint_model(each), placement, each.name)
        frame = model.addJointFrame(joint, frame)
        _say_numbers(model, joint, each)
        placement = each.anchor.inverse()
    if joint:
        model.appendBodyToJoint(joint, body.inertia, placement)
    frame = model.addFrame(
        pin.Frame(body.name, joint, frame, placement, pin.FrameType.BODY, pin.Inertia.Zero()), False
    )
    for name, at in body.frames:
        model.addFrame(
            pin.Frame(name, joint, frame, placement * at, pin.FrameType.OP_FRAME, pin.Inertia.Zero()), False
        )
    return _Place(joint, placement, frame)


def _joint_model(joint: TreeJoint) -> Any:
    """Pinocchio's joint, by its own type for an axis of the frame."""
    if joint.has_axis:
        for axis, kind in zip(np.eye(3), _ALIGNED[joint.kind], strict=True):
            if np.array_equal(joint.axis, axis):
                return kind()
    return _MODELS[joint.kind](joint.axis)


def _say_numbers(model: pin.Model, joint: int, said: TreeJoint) -> None:
    q, v = joints.configuration_slice(model, joint), joints.velocity_slice(model, joint)
    if said.has_axis:
        lower, upper = (_as_limit(x) for x in (said.lower, said.upper))
        model.lowerPositionLimit[q], model.upperPositionLimit[q] = lower, upper
    for key in ("armature", "damping"):
        getattr(model, key)[v] = getattr(said, key)
    model.upperDryFrictionLimit[v], model.lowerDryFrictionLimit[v] = said.friction, -said.friction
    model.upperVelocityLimit[v], model.upperEffortLimit[v] = _as_limit(said.velocity), _as_limit(said.effort)
    model.lowerVelocityLimit[v] = -_as_limit(said.velocity)
    model.lowerEffortLimit[v] = _as_limit(-said.effort if said.effort_lower is None else said.effort_lower)


def _as_limit(limit: float) -> float:
    """A limit as Pinocchio writes it: the largest double for none."""
    return float(np.clip(limit, -np.finfo(float).max, np.finfo(float).max))


def _check_names(path: Path, bodies: Sequence[TreeBody]) -> None:
    moving = [joint.name for body in bodies for joint in body.joints]
    frames = [name for body in bodies for name, _ in body.frames]
    for what, names in (("body", [body.name for body in bodies]), ("joint", moving), ("frame", frames)):
        for name in names:
            if not name or len(name) > _MAX_NAME_LENGTH or has_control_characters(name):
                words = f"expected 1 to {_MAX_NAME_LENGTH} characters that print"
                raise RobotFileError(path, f"a {what} is called {show(name)}, {words}")
        if twice := find_repeated(names):
            raise RobotFileError(path, f"{what} {list_names(twice, _MAX_NAMES)} is defined more than once")
    if not bodies:
        raise RobotFileError(path, "has no body")
    if len(moving) > MAX_MOVING_JOINTS:
        raise UnsupportedRobot(
            f"{path}: has {len(moving):,} joints that move; supported are at most {MAX_MOVING_JOINTS:,}"
        )
    depths: dict[str | None, int] = {None: 0}
    for body in bodies:
        depths[body.name] = depths[body.parent] + 1
    if max(depths.values()) > MAX_CHAIN_LENGTH:
        raise UnsupportedRobot(f"{path}: has more than {MAX_CHAIN_LENGTH:,} bodies one behind the other")

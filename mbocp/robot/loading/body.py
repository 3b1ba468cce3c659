"""From a source to a model with its visuals, pose and tables, before joints are locked."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.exceptions import DimensionMismatch, RobotFileError
from mbocp.robot import joints
from mbocp.robot.collision.source import CollisionSource
from mbocp.robot.loading.ball_joints import make_spherical
from mbocp.robot.loading.chain import chain_description, chain_urdf, num_links
from mbocp.robot.loading.examples import load_example
from mbocp.robot.loading.locking import pose_by_joint
from mbocp.robot.loading.mimic import Follower, followers
from mbocp.robot.loading.object_urdf import object_urdf
from mbocp.robot.loading.schema import RobotTable, read_robot_toml
from mbocp.robot.loading.sources import Source
from mbocp.robot.loading.urdf import ROOT_JOINT, Urdf, build_model, read_urdf
from mbocp.robot.loading.visuals import build_visuals, resolve
from mbocp.robot.payload import Payload
from mbocp.robot.placed import PlacedRobot

# A URDF that says "mimic" means it. example-robot-data builds its models without, as do the collections that
# have a robot.yaml, whose motors may be on such joints.
_MIMIC = {"toml": True, "yaml": False, "urdf": True, "chain": True, "example": False}

_BASE_NQ = 7  # numbers of a free-flyer's configuration


@dataclass(frozen=True, eq=False)
class Body:
    """A model before locking, with its visuals, pose and tables."""

    model: pin.Model
    visuals: pin.GeometryModel
    q0: Array
    urdf: Path | None
    name: str
    table: RobotTable
    file: Path
    followers: tuple[Follower, ...] = ()
    parts: tuple[PlacedRobot, ...] = ()
    collision: tuple[CollisionSource, ...] = ()
    named_locks: frozenset[str] = frozenset()  # joints that options of its parts lock


def make_body(source: Source, free_flyer: bool | None, mimic: bool | None, dirs: tuple[Path, ...]) -> Body:
    """Read a source; options are those of `load_robot`, None where they say nothing."""
    follow = _MIMIC[source.kind] if mimic is None else mimic
    if source.kind == "example":
        example = load_example(
            source.name, free_flyer=free_flyer, mimic=follow, packages=list(dirs), facts=source.example
        )
        return Body(
            example.model,
            example.visuals,
            example.q0,
            example.path,
            source.name,
            RobotTable.model_construct(),
            example.path,
            example.followers,
            collision=example.collision,
        )
    if source.kind == "chain":
        return _chain(source.name, bool(free_flyer), follow)
    table, path, name = RobotTable.model_construct(), source.path, None
    folders = [*dirs, *source.package_dirs]
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
    return _body_of(urdf, model, visuals, name or urdf.name, table, source.path, follow, folders)


def _body_of(
    urdf: Urdf,
    model: pin.Model,
    visuals: pin.GeometryModel,
    name: str,
    table: RobotTable,
    file: Path,
    follow: bool,
    folders: list[Path],
) -> Body:
    """Model, visuals and tables from a URDF."""
    tied = followers(urdf.path, urdf.root) if follow else ()
    collision = (CollisionSource(urdf, tuple(folders)),)
    q = pin.neutral(model)
    return Body(model, visuals, q, urdf.path, name, table, file, tied, collision=collision)


def _from_yaml(source: Source, free_flyer: bool, mimic: bool, folders: list[Path]) -> Body:
    """A URDF with a robot.yaml beside it; the URDF is robot.urdf, or the only one."""
    from mbocp.robot.loading.robot_yaml import read_robot_yaml  # few robots have one

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
    return _body_of(urdf, model, visuals, source.name, table, source.path, mimic, folders)


def object_body(name: str, shape: Payload, *, free_flyer: bool) -> Body:
    """A simple body of given mass and shape; without a free-flyer it stands still."""
    urdf = object_urdf(name, shape)
    model = build_model(urdf, free_flyer=free_flyer, mimic=False)
    visuals = build_visuals(urdf, model, [])
    collision = (CollisionSource(urdf),)
    return Body(model, visuals, pin.neutral(model), None, name, RobotTable(), urdf.path, collision=collision)


def _chain(name: str, free_flyer: bool, mimic: bool) -> Body:
    links = num_links(name) or 0
    urdf, table = chain_urdf(links), RobotTable(description=chain_description(links))
    model = build_model(urdf, free_flyer=free_flyer, mimic=mimic)
    visuals, q = build_visuals(urdf, model, []), pin.neutral(model)
    collision = (CollisionSource(urdf),)
    return Body(model, visuals, q, None, name, table, urdf.path, collision=collision)


def initial_pose(body: Body) -> Array:
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


def posed_joints(body: Body) -> list[str]:
    """Joints whose initial position was written."""
    if body.table.initial is None:
        return []
    written = body.table.initial.q
    return list(written) if isinstance(written, dict) else list(joints.joint_names(body.model))

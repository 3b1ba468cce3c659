"""Robots of example-robot-data, by name, through its own table of loaders.

The loaders read every mesh, which takes seconds. Those that only name files (nearly all) are therefore
followed by hand: same URDF, same base, same SRDF (rotor inertias, reference pose). Those with code of their
own are called.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import RobotFileError, UnsupportedRobot
from mbocp.robot.loading.description import Description, ReadOptions
from mbocp.robot.loading.readers.urdf import capture_stderr, describe_urdf, read_urdf

# Upstream, "ur3" loads the UR5; and the other loader's own code only edits collision shapes, unused here.
_CORRECTED = {"ur3": "UR3Loader"}
_COLLISION_ONLY = ("PandaLoaderCollision",)


@dataclass(frozen=True)
class ExampleFacts:
    """What example-robot-data says of a robot beside its URDF.

    Attributes
    ----------
    path : Path
        URDF.
    free_flyer : bool
    srdf : Path or None
    has_rotors : bool
        Whether the SRDF has inertias and gear ratios of motors.
    posture : str or None
        Name of the SRDF's configuration to begin in.
    packages : tuple of Path
        Folders to search for meshes.
    """

    path: Path
    free_flyer: bool
    srdf: Path | None
    has_rotors: bool
    posture: str | None
    packages: tuple[Path, ...] = ()

    @classmethod
    def of_table(cls, table: Mapping[str, Any], root: Path) -> ExampleFacts:
        """From a table whose paths are relative to `root`; packages do not matter there."""
        srdf = None if table["srdf"] is None else root / table["srdf"]
        return cls(**{**table, "path": root / table["path"], "srdf": srdf})

    def table(self, placed: Callable[[Path], str]) -> dict[str, Any]:
        """The table, with paths as they are placed."""
        said = {key: value for key, value in vars(self).items() if key != "packages"}
        srdf = None if self.srdf is None else placed(self.srdf)
        return {**said, "path": placed(self.path), "srdf": srdf}


def names() -> list[str]:
    """Names that example-robot-data has; empty if it is not installed."""
    return sorted(_loaders())


def description(name: str) -> str:
    """One line about a robot, without loading it."""
    loader = _loaders()[name]
    if not loader.urdf_filename:
        return f"{loader.sdf_filename}: an SDF file, to be loaded by its path"
    return f"{loader.urdf_filename}, {'free-flying' if loader.free_flyer else 'fixed'} base"


def describe_example(name: str, facts: ExampleFacts | None, how: ReadOptions) -> Description:
    """Describe a robot of example-robot-data.

    Parameters
    ----------
    name : str
        One of `names()`.
    facts : ExampleFacts, optional
        What was stored of it; then example-robot-data itself is not asked.
    how : ReadOptions
        Mimic joints do not follow their leaders unless they are asked to, as upstream.
    """
    if facts is None:
        facts = _readable_facts(name)
        if _has_own_code(_loaders()[name]):
            if how.mimic or how.inertias or how.free_flyer not in (None, facts.free_flyer):
                raise UnsupportedRobot(
                    f"robot {name!r} is built by code of example-robot-data: free_flyer, mimic and inertias "
                    f"cannot be changed; load its URDF instead: {facts.path}"
                )
            return _describe_built(name, facts.path)
    base = facts.free_flyer if how.free_flyer is None else how.free_flyer
    folders = (*how.folders, *facts.packages)
    whole = replace(how, free_flyer=base, mimic=bool(how.mimic), folders=folders)
    found = describe_urdf(read_urdf(facts.path), whole)
    return replace(found, name=name, q0=_reference_pose(facts, found.model))


def example_facts(name: str) -> ExampleFacts:
    """What is said of a robot, where files and these facts are all that it is made of.

    Raises
    ------
    UnsupportedRobot
        If it is built by code, or is no URDF.
    """
    facts = _readable_facts(name)
    if _has_own_code(_loaders()[name]):
        raise UnsupportedRobot(f"robot {name!r} is built by code of example-robot-data, not from files alone")
    return facts


def _readable_facts(name: str) -> ExampleFacts:
    loader = _loaders()[name]
    if not loader.urdf_filename:
        raise UnsupportedRobot(
            f"robot {name!r} is described by {loader.sdf_filename}, an SDF file: load it by its path"
        )
    root = Path(
        loader.model_path or _model_path(f"{loader.path}/{loader.urdf_subpath}/{loader.urdf_filename}")
    )
    srdf = root / loader.path / loader.srdf_subpath / loader.srdf_filename if loader.srdf_filename else None
    return ExampleFacts(
        path=(root / loader.path / loader.urdf_subpath / loader.urdf_filename).resolve(),
        free_flyer=bool(loader.free_flyer),
        srdf=srdf,
        has_rotors=bool(loader.has_rotor_parameters),
        posture=loader.ref_posture,
        packages=(root.parent.parent,),
    )


@cache
def _loaders() -> dict[str, Any]:
    try:
        from example_robot_data import robots_loader
    except ImportError:
        return {}
    table = dict(robots_loader.ROBOTS)
    table.update(
        {name: getattr(robots_loader, cls, table[name]) for name, cls in _CORRECTED.items() if name in table}
    )
    return table


def _model_path(subpath: str) -> str:
    from example_robot_data.utils import getModelPath

    try:
        return str(getModelPath(subpath))
    except OSError as error:
        raise RobotFileError(
            subpath, "example-robot-data does not have this file: is it installed whole?"
        ) from error


def _has_own_code(loader: Any) -> bool:
    from example_robot_data.utils import RobotLoader

    return loader.__init__ is not RobotLoader.__init__ and loader.__name__ not in _COLLISION_ONLY


def _describe_built(name: str, path: Path) -> Description:
    robot = _build(name)
    shapes = pin.GeometryModel(robot.visual_model)
    return Description(name, path, pin.Model(robot.model), shapes, np.array(robot.q0), source=path)


@cache  # upstream reads all meshes, of collisions, too
def _build(name: str) -> Any:
    with contextlib.redirect_stdout(io.StringIO()), capture_stderr([]):
        return _loaders()[name]().robot


def _reference_pose(facts: ExampleFacts, model: pin.Model) -> Array:
    """Initial pose of the SRDF, and its rotor inertias into the model, as the loaders do."""
    neutral: Array = pin.neutral(model)
    if facts.srdf is None:
        return neutral
    with capture_stderr([]):
        if facts.has_rotors:
            pin.loadRotorParameters(model, str(facts.srdf), False)
            model.armature = model.rotorInertia * model.rotorGearRatio**2
        pin.loadReferenceConfigurations(model, str(facts.srdf), False)
    poses = model.referenceConfigurations
    if facts.posture is None or facts.posture not in poses:
        return neutral
    return pin.normalize(model, np.array(poses[facts.posture]))

"""From what a robot is loaded by to all files that it is made of, and back."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mbocp._files import MEGABYTE, read_bytes
from mbocp.exceptions import MbocpError, RobotFileError
from mbocp.meshes.mesh_parts import MESH_LIMIT
from mbocp.meshes.pictures import MATERIALS, PACKAGE, companions, picture_folders, read_picture
from mbocp.robot.loading.addresses import absolute, resolve
from mbocp.robot.loading.describe import model_file
from mbocp.robot.loading.loaders import robot_from_spec
from mbocp.robot.loading.readers.example_robots import ExampleFacts, example_facts
from mbocp.robot.loading.robot_formats import FORMATS, format_of, reader_of
from mbocp.robot.loading.robot_keys import read_part
from mbocp.robot.loading.robot_sources import Source, find_source
from mbocp.robot.loading.robot_toml import read_robot_toml
from mbocp.robot.robot import Robot
from mbocp.robot.robot_files import RobotFiles, StoredFile, digest_of, pack

_TOP = "."  # the folder of the list, from which the robot itself is asked for
_FILES = "files"  # and below it the folder of all files
_LIMIT = 16 * MEGABYTE  # of a file that is no mesh
_MESHES = (".stl", ".dae", ".obj", ".ply", ".off", ".3ds", ".fbx", ".glb")


def gather(spec: Mapping[str, Any]) -> RobotFiles:
    """All files of the robot that `spec` loads now: those that describe it, meshes, pictures.

    Parameters
    ----------
    spec : mapping
        `Robot.spec`, with absolute paths.

    Raises
    ------
    RobotError
        If the robot is not there, or is not made of files alone.
    """
    found = _Findings()
    if spec.get("part"):
        for number, entry in enumerate(spec["part"]):
            _of_part(found, entry, number, None, ())
    else:
        folders = [absolute(folder, None) for folder in spec.get("package_dirs", ())]
        _of_name(found, str(spec["name"]), None, folders, spec.get("arguments"))
    return found.files(spec)


@dataclass(eq=False)
class _Findings:
    """What was found so far."""

    contents: dict[Path, bytes] = field(default_factory=dict)
    meshes: set[Path] = field(default_factory=set)
    sources: list[tuple[str, Path | None, Source, ExampleFacts | None]] = field(default_factory=list)
    addresses: list[tuple[str, Path, Path]] = field(default_factory=list)

    def add(self, path: Path, limit: int = _LIMIT) -> bytes:
        """Read a file, if that is not done yet."""
        plain = _plain(path)
        if plain not in self.contents:
            with RobotFileError.where_unreadable(path):
                self.contents[plain] = read_bytes(path, limit=limit)
        return self.contents[plain]

    def files(self, spec: Mapping[str, Any]) -> RobotFiles:
        """All of it, below the folder that all files have in common."""
        folders = [str(path.parent) for path in self.contents]
        top = Path(os.path.commonpath(folders)) if folders else Path("/")

        def place_of(path: Path) -> str:
            return f"{_FILES}/{_plain(path).relative_to(top).as_posix()}"

        def within(folder: Path | None) -> str:
            return _TOP if folder is None else str(Path(place_of(folder)))

        sources = [
            {
                "asked": asked,
                "within": within(folder),
                "kind": source.kind,
                "name": source.name,
                "address": source.address,
                "path": place_of(source.path) if source.is_file else "",
                "example": None if facts is None else facts.table(place_of),
            }
            for asked, folder, source, facts in self.sources
        ]
        addresses = [
            {"asked": asked, "within": within(folder), "path": place_of(path)}
            for asked, folder, path in self.addresses
        ]
        digests = {path: digest_of(content) for path, content in self.contents.items()}
        files = [
            StoredFile(
                path=place_of(path),
                digest=digests[path],
                size=len(content),
                origin=str(path),
                is_mesh=path in self.meshes,
            ).model_dump()
            for path, content in self.contents.items()
        ]
        listed = {"spec": dict(spec), "sources": sources, "addresses": addresses, "files": files}
        packed = {digest: pack(self.contents[path]) for path, digest in digests.items()}
        return RobotFiles(json.loads(json.dumps(listed)), packed)


def _of_part(found: _Findings, entry: Any, number: int, base: Path | None, dirs: Sequence[Path]) -> None:
    table = read_part(entry, number)
    if table.robot is not None:
        _of_name(found, table.robot, base, (*table.folders(base), *dirs), table.arguments)


def _of_name(
    found: _Findings, name: str, base: Path | None, dirs: Sequence[Path], arguments: Mapping[str, Any] | None
) -> None:
    """Follow what a name or a path leads to, as `mbocp.robot.loading.describe` does."""
    source = find_source(name, base)
    facts = example_facts(source.name) if source.kind == "example" else None
    row = (name, base, source, facts)
    if any(seen[:2] == row[:2] for seen in found.sources):
        return
    if source.kind in FORMATS:
        path = _of_model(found, source.path, (*dirs, *source.package_dirs), arguments)
        row = (name, base, replace(source, path=path, kind=format_of(path).kind), facts)
    found.sources.append(row)
    if facts is not None:
        if facts.srdf is not None:
            found.add(facts.srdf)
        _of_model(found, facts.path, (*dirs, *facts.packages))
    elif source.kind == "toml":
        _of_tables(found, source.path, dirs, arguments)


def _of_tables(
    found: _Findings, path: Path, dirs: Sequence[Path], arguments: Mapping[str, Any] | None
) -> None:
    """A robot.toml, its parts, or the model that it names."""
    found.add(path)
    folder, table = path.parent, read_robot_toml(path)
    for number, part in enumerate(table.parts):
        _of_part(found, part, number, folder, dirs)
    if not table.parts:
        model, dirs = model_file(path, table, dirs)
        kept = _of_model(found, model, dirs, {**(table.arguments or {}), **(arguments or {})})
        found.addresses.append((table.urdf, folder, kept))


def _of_model(
    found: _Findings, path: Path, dirs: Sequence[Path], arguments: Mapping[str, Any] | None = None
) -> Path:
    """A file that describes a robot, those that belong to it, and its meshes; the one to read it from."""
    reader = reader_of(path, dirs, arguments)
    belonging = reader.companions(path)
    for file in (path, *belonging):
        found.add(file)
    kept = _expand(found, path, reader)
    _add_package(found, path)
    for address in reader.addresses(path):
        try:
            file = resolve(address, path.parent, dirs)
        except FileNotFoundError:  # whoever loads the robot warns of it
            continue
        if file.suffix.lower() in _MESHES:
            found.addresses.append((address, path.parent, file))
            _of_mesh(found, file, path)
        elif file in belonging:
            found.addresses.append((address, path.parent, file))
    return kept


def _expand(found: _Findings, path: Path, reader: Any) -> Path:
    """The file itself, or the URDF that it is the source of, which needs no other file and no arguments."""
    if format_of(path).expander is None:
        return path
    made = path.with_name(f"{path.name}.urdf")
    found.contents[_plain(made)] = reader.expand(path).urdf.text.encode()
    return made


def _of_mesh(found: _Findings, mesh: Path, robot: Path) -> None:
    """A mesh, its material files, and those pictures that a page would show."""
    if _plain(mesh) in found.meshes:
        return
    try:
        content = found.add(mesh, MESH_LIMIT)
    except RobotFileError:  # whoever draws it warns of it
        return
    found.meshes.add(_plain(mesh))
    _add_package(found, mesh)
    for named in companions(mesh, content):
        try:
            if named.suffix.lower() == MATERIALS:
                found.add(named)
            else:
                found.contents[_plain(named)] = read_picture(named, picture_folders([robot], mesh)).content
        except MbocpError:  # as above
            continue
        found.meshes.add(_plain(named))


def _add_package(found: _Findings, path: Path) -> None:
    """The nearest package.xml above a file: it says which pictures belong to the robot."""
    above = (folder / PACKAGE for folder in path.resolve().parents)
    package = next((file for file in above if file.is_file()), None)
    if package is not None and path.is_relative_to(package.parent):
        found.add(package)


def _plain(path: Path) -> Path:
    """Absolute, without `..`; links are not followed, for addresses are relative to where a file seems."""
    return Path(os.path.abspath(path))  # noqa: PTH100  # Path.absolute keeps ..


def load_stored(files: RobotFiles, spec: Mapping[str, Any] | None = None) -> Robot:
    """Load the robot that `files` are of, from them and nothing else.

    Parameters
    ----------
    files : RobotFiles
    spec : mapping, optional
        The same robot with other options; by default those that the files came with.

    Raises
    ------
    RobotError
        If they are damaged, or not all that the robot needs.

    Warns
    -----
    MissingMeshWarning
        If meshes were left out.
    """
    robot = robot_from_spec(files.spec if spec is None else spec, base=files.folder)
    return replace(robot, stored=files)

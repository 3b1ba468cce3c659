"""Where a robot comes from: a path, a folder of robots/, a chain, example-robot-data, robot_descriptions.

Look-up order of `find_source`:

1. a `Path`, or a text with a path separator or the ending of a file of a robot: that file or folder;
2. a folder of that name with a robot.toml or robot.yaml in it, under the folders of MBOCP_ROBOT_PATH, then
   under mbocp's robots/;
3. "chain_N": a chain of N links, see `mbocp.robot.loading.readers.in_memory`;
4. a name of example-robot-data ("ur5", "panda", "talos");
5. a name of robot_descriptions ("panda_description"), if that package is installed.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import mbocp
from mbocp._arrays import dataclass
from mbocp._files import is_file, is_folder, path_of
from mbocp.exceptions import RobotFileError, UnknownRobot
from mbocp.robot.loading.addresses import find_root_of_stored, find_row
from mbocp.robot.loading.readers import example_robots, in_memory
from mbocp.robot.loading.robot_formats import FORMATS, format_of
from mbocp.robot.loading.robot_toml import read_robot_toml

PATH_VARIABLE = "MBOCP_ROBOT_PATH"
_FILE_ENDINGS = (".toml", *(ending for each in FORMATS.values() for ending in each.endings))
_DESCRIBED_BY = ("URDF_PATH", "MJCF_PATH")  # in modules of robot_descriptions
# The first of them in a folder of the robot's name.
_FILES = {"toml": "robot.toml", **{each.kind: each.file for each in FORMATS.values() if each.file}}


@dataclass(frozen=True)
class Source:
    """Source of a robot: a file, a chain, or a loader of example-robot-data.

    `address` is the name or absolute path that leads here again from any folder; `example` is what
    example-robot-data says of it, where that was stored.
    """

    kind: str
    name: str
    address: str
    path: Path
    package_dirs: tuple[Path, ...] = ()
    example: example_robots.ExampleFacts | None = None

    @property
    def is_file(self) -> bool:
        """Whether it is a file of a robot, and no name that makes one."""
        return self.kind == "toml" or self.kind in FORMATS


@dataclass(frozen=True)
class RobotEntry:
    """A robot that can be loaded by name."""

    name: str
    source: str
    description: str


def find_source(spec: str | Path, base: Path | None = None) -> Source:
    """Find the source that `spec` names.

    Parameters
    ----------
    spec : str or Path
        Name or path.
    base : Path, optional
        Folder that relative paths start from; the working directory if None.
    """
    root = find_root_of_stored(base)
    if root is not None and base is not None:
        return _find_stored(root, str(spec), base)
    if isinstance(spec, Path) or _looks_like_path(spec):
        path = path_of(spec)
        return _from_path(path if base is None else base / path)
    found = _from_folders(spec) or _find_made(spec) or _from_robot_descriptions(spec)
    if found is None:
        folder = f"{os.curdir}{os.sep}{spec}" if is_folder((base or Path()) / spec) else ""
        has_profile = is_file(Path(mbocp.__file__).resolve().parent / "profiles" / f"{spec}.toml")
        raise UnknownRobot(spec, [entry.name for entry in list_robots()], folder, has_profile=has_profile)
    return found


def _from_folders(name: str) -> Source | None:
    """File of a robot in a folder of its name."""
    for folder in robot_folders():
        for kind, file in _FILES.items():
            if is_file(folder / name / file):
                return Source(kind, name, name, folder / name / file)
    return None


def _find_made(name: str) -> Source | None:
    """A chain, or a robot of example-robot-data."""
    if in_memory.num_links(name) is not None:
        return Source("chain", name, name, Path())
    return Source("example", name, name, Path()) if name in example_robots.names() else None


def robot_folders() -> list[Path]:
    """Folders that hold robots by name: those of MBOCP_ROBOT_PATH, then mbocp's own."""
    package = Path(mbocp.__file__).resolve().parent
    listed = [path_of(p) for p in os.environ.get(PATH_VARIABLE, "").split(os.pathsep) if p]
    return [
        folder
        for folder in (*listed, package / "data" / "robots", package.parent / "robots")
        if folder.is_dir()
    ]


def list_robots() -> list[RobotEntry]:
    """All robots that can be loaded by name; a name that occurs twice is listed where it would be found."""
    found: dict[str, RobotEntry] = {}
    for folder in robot_folders():
        for inner in _inner(folder):
            file = next((inner / name for name in _FILES.values() if (inner / name).is_file()), None)
            if file is not None:
                found.setdefault(inner.name, RobotEntry(inner.name, "robots/", _description(file)))
    words = f"{in_memory.chain_description(8)}; chain_N has N, 1 to {in_memory.MAX_LINKS}"
    found.setdefault(in_memory.EXAMPLE, RobotEntry(in_memory.EXAMPLE, "chains of any length", words))
    for name in example_robots.names():
        found.setdefault(name, RobotEntry(name, "example-robot-data", example_robots.description(name)))
    return list(found.values())


def _inner(folder: Path) -> list[Path]:
    try:
        return sorted(folder.iterdir())
    except OSError:  # a folder that may not be read holds no robots for us; the others are listed
        return []


def _description(file: Path) -> str:
    if file.suffix != ".toml":
        return format_of(file).about
    try:
        return read_robot_toml(file).description
    except RobotFileError as error:  # a broken file must not hide the other robots
        return f"cannot be read: {error.reason}"


def _looks_like_path(spec: str) -> bool:
    separators = [s for s in (os.sep, os.altsep) if s]
    return spec in (".", "..", "~") or spec.endswith(_FILE_ENDINGS) or any(s in spec for s in separators)


def _from_path(path: Path) -> Source:
    try:
        path = path.resolve()
        there = path.exists()
    except (OSError, RuntimeError, ValueError) as error:  # too long, a circle of links, a NUL
        raise RobotFileError(path, f"no such file or folder ({error.__class__.__name__})") from error
    if path.is_dir():
        path = _file_in(path)
    elif not there:
        raise RobotFileError(path, "no such file or folder")
    if path.suffix == ".toml":
        return Source("toml", path.parent.name, str(path), path)
    found = format_of(path)
    return Source(found.kind, path.parent.name if found.file else path.stem, str(path), path)


def _file_in(folder: Path) -> Path:
    """The file of a folder that describes its robot."""
    for file in _FILES.values():
        if (folder / file).is_file():
            return folder / file
    usual = {each.name: each.endings[0] for each in FORMATS.values() if not each.file}
    held = {name: sorted(folder.glob(f"*{ending}")) for name, ending in usual.items()}
    alone = next((files[0] for files in held.values() if len(files) == 1), None)  # a URDF beside its xacro
    if alone is not None:
        return alone
    raise RobotFileError(
        folder,
        f"this folder has no {' or '.join(_FILES.values())}, and not exactly one {_either(usual)} (it "
        f"has: {', '.join(file.name for files in held.values() for file in files) or 'none'})",
    )


def _either(names: Iterable[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} or {last}"


def _find_stored(root: Path, spec: str, base: Path) -> Source:
    """The source that a stored robot meant; it is called as it was there."""
    row = find_row(root, "sources", spec, base)
    if row is None:
        raise RobotFileError(spec, "is not among the files of the stored robot")
    facts = row.get("example")
    example = None if facts is None else example_robots.ExampleFacts.of_table(facts, root)
    path = root / row["path"] if row["path"] else Path()
    return Source(row["kind"], row["name"], row["address"], path, example=example)


def _from_robot_descriptions(name: str) -> Source | None:
    """File that the package robot_descriptions knows by this name; None if it or the name is not there."""
    if not name.isidentifier() or importlib.util.find_spec("robot_descriptions") is None:
        return None
    try:
        if importlib.util.find_spec(f"robot_descriptions.{name}") is None:
            return None
        module: Any = importlib.import_module(f"robot_descriptions.{name}")
    except Exception as error:  # it clones repositories on import: anything may go wrong, the network first
        raise RobotFileError(f"robot_descriptions.{name}", f"could not be fetched: {error}") from error
    path = next((getattr(module, key) for key in _DESCRIBED_BY if hasattr(module, key)), None)
    if path is None:
        raise RobotFileError(f"robot_descriptions.{name}", "has no URDF and no MJCF")
    keys = [key for key in ("PACKAGE_PATH", "REPOSITORY_PATH") if hasattr(module, key)]
    packages = [Path(getattr(module, key)) for key in keys]
    path, folders = Path(path), (f for folder in packages for f in (folder, folder.parent))
    return Source(format_of(path).kind, name, name, path, tuple(folders))

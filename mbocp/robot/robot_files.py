"""The files of a robot as they were: to be put into a result file, and unpacked on any machine."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import weakref
import zlib
from collections.abc import Mapping
from dataclasses import field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from mbocp._arrays import dataclass
from mbocp._files import MEGABYTE, is_file
from mbocp._text import show
from mbocp.exceptions import InvalidValue, RobotFileError
from mbocp.robot.loading.addresses import LIST, PREFIX
from mbocp.robot.loading.robot_formats import FORMATS, OTHER_KINDS

_MAX_BYTES = 1024 * MEGABYTE  # of all files of a robot, unpacked
_MAX_FILES = 20_000
_LEVEL = 1  # of zlib: 2.4 MB of a UR5's 6.7 in 0.07 s; level 6 makes 2.1 in 0.42 s


class _Row(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True, extra="forbid", defer_build=True)


def _within(path: str) -> str:
    """Refuse what would be written outside of the folder, or cannot be the name of a file."""
    parts = PurePosixPath(path).parts
    is_odd = path.startswith("/") or "\\" in path or "\0" in path or not _is_name(path)
    if not parts or is_odd or {"..", "."} & set(parts):
        raise ValueError(f"got {show(path)}, expected a path within the folder")
    return path


def _is_name(path: str) -> bool:
    """Whether files can be called so: a half of a character of two, as JSON may have, is no name."""
    try:
        os.fsencode(path)
    except UnicodeEncodeError:
        return False
    return True


def _is_kind(kind: str) -> str:
    known = (*OTHER_KINDS, *FORMATS)
    if kind not in known:
        raise ValueError(f"expected one of {', '.join(known)}")
    return kind


Within: TypeAlias = Annotated[str, AfterValidator(_within)]


class StoredFile(_Row):
    """One file: where it is below the folder, its content's SHA-256 and size, and where it was."""

    path: Within
    digest: Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")]
    size: Annotated[int, Field(ge=0, le=_MAX_BYTES)]
    origin: str
    is_mesh: bool


class _Example(_Row):
    path: Within
    free_flyer: bool
    srdf: Within | None
    has_rotors: bool
    posture: str | None


class _Source(_Row):
    asked: str
    within: str
    kind: Annotated[str, AfterValidator(_is_kind)]
    name: str
    address: str
    path: Annotated[str, AfterValidator(lambda path: path and _within(path))]
    example: _Example | None = None


class _Address(_Row):
    asked: str
    within: str
    path: Within


class _List(_Row):
    spec: dict[str, Any]
    sources: list[_Source]
    addresses: list[_Address]
    files: Annotated[list[StoredFile], Field(max_length=_MAX_FILES)]


@dataclass(frozen=True, eq=False, repr=False)
class RobotFiles:
    """The files that a robot was loaded from, and what its names and addresses meant.

    Parameters
    ----------
    listed : mapping
        ``spec`` of the robot, ``sources``, ``addresses`` and ``files``; what `gather` makes.
    contents : mapping
        Compressed content of files by digest, each once; what is not in it was left out.

    Raises
    ------
    InvalidValue
        If the list is not what mbocp writes.
    """

    listed: Mapping[str, Any]
    contents: Mapping[str, bytes]

    def __post_init__(self) -> None:
        try:
            checked = _List.model_validate(dict(self.listed))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            key = ".".join(str(step) for step in first["loc"])
            raise InvalidValue(f"robot: {key}", show(first["input"]), first["msg"]) from error
        if sum(file.size for file in checked.files) > _MAX_BYTES:
            raise InvalidValue("robot: files", "more bytes", f"{_MAX_BYTES} at most")
        object.__setattr__(self, "files", tuple(checked.files))

    files: tuple[StoredFile, ...] = field(init=False)

    def __repr__(self) -> str:
        name = self.spec.get("name", "several robots")
        return f"<RobotFiles of {name!r}: {len(self.files)}, {self.size} bytes>"

    @property
    def spec(self) -> Mapping[str, Any]:
        """What `mbocp.robot.robot_from_spec` took."""
        return self.listed["spec"]

    @property
    def size(self) -> int:
        """Bytes that the contents take, compressed."""
        return sum(map(len, self.contents.values()))

    @property
    def left_out(self) -> tuple[StoredFile, ...]:
        """Files whose content is not here."""
        return tuple(file for file in self.files if file.digest not in self.contents)

    @property
    def changed(self) -> tuple[str, ...]:
        """Files that are at their old places on this machine, with another content."""
        return tuple(
            file.origin
            for file in self.files
            if is_file(Path(file.origin)) and not _is_same(Path(file.origin), file)
        )

    def without_meshes(self) -> RobotFiles:
        """The same, where the list alone speaks of meshes."""
        meshes = {file.digest for file in self.files if file.is_mesh}
        return RobotFiles(self.listed, {d: c for d, c in self.contents.items() if d not in meshes})

    def with_spec(self, spec: Mapping[str, Any]) -> RobotFiles:
        """The same files for a robot that is loaded with other options."""
        return RobotFiles({**self.listed, "spec": dict(spec)}, self.contents)

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in vars(self).items() if key != "folder"}

    @cached_property
    def folder(self) -> Path:
        """Temporary folder with the files in it; it is removed when nobody holds these files any more.

        Raises
        ------
        RobotFileError
            If it cannot be made, or a content is damaged.
        """
        try:
            root = Path(tempfile.mkdtemp(prefix=PREFIX))
            weakref.finalize(self, _remove, root, os.getpid())
            for file in self.files:
                content = self._content(file)
                if content is not None:
                    (root / file.path).parent.mkdir(parents=True, exist_ok=True)
                    (root / file.path).write_bytes(content)
            (root / LIST).write_text(json.dumps(dict(self.listed)), encoding="utf-8")
        except OSError as error:
            raise RobotFileError(
                tempfile.gettempdir(),
                f"the files of a stored robot cannot be put there: {error.strerror or error}",
            ) from error
        return root

    def _content(self, file: StoredFile) -> bytes | None:
        packed = self.contents.get(file.digest)
        if packed is None:  # it may still be where it was
            origin = Path(file.origin)
            return origin.read_bytes() if is_file(origin) and _is_same(origin, file) else None
        unpacking = zlib.decompressobj()
        try:
            content = unpacking.decompress(packed, file.size + 1)
        except zlib.error as error:
            raise RobotFileError(file.path, f"is damaged in the result: {error}") from error
        if len(content) != file.size or digest_of(content) != file.digest:
            raise RobotFileError(file.path, "is damaged in the result: its content is another one")
        return content


def _remove(folder: Path, owner: int) -> None:
    """Remove a folder, unless this is a copy of the process that made it."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


def pack(content: bytes) -> bytes:
    """Compress a content."""
    return zlib.compress(content, _LEVEL)


def digest_of(content: bytes) -> str:
    """SHA-256 of a content, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def _is_same(path: Path, file: StoredFile) -> bool:
    try:
        return path.stat().st_size == file.size and digest_of(path.read_bytes()) == file.digest
    except OSError:  # may not be read: then nothing is known of it
        return False

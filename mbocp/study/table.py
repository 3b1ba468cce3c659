"""The file of a study: one header line, then one line for each task that is done, both JSON.

    {"format": "mbocp study", "format_version": 1, "digest": ..., "tasks": 2028, ...}
    {"index": 0, "values": {...}, "status": "converged", ...}

Lines are added as tasks end, in any order, and never changed. A write that is cut off leaves a line without
its end, which counts as not written.
"""

from __future__ import annotations

import fcntl
import json
import os
import time
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbocp._files import read_bytes
from mbocp.exceptions import ResultFileError, StudyError
from mbocp.study.study_schema import is_header, is_row

FORMAT = "mbocp study"
FORMAT_VERSION = 1

_SYNC_EVERY = 0.5  # [s] rows are on the disk after this time; a killed process alone loses none
_MAX_BYTES = 2**30  # about a million rows
_SHOWN_DIGEST = 12  # letters of it that are shown


def read_table(path: str | Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Header and rows of a study's file, in the order of their tasks; also while it is being written.

    Raises
    ------
    ResultFileError
        If there is no such file, it is no study's, it is damaged, or a newer mbocp wrote it.
    """
    path = Path(path)
    with ResultFileError.where_unreadable(path):
        content = read_bytes(path, expected="a study's file", limit=_MAX_BYTES)
    header, rows, _ = _parse(content, path)
    return header, sorted(rows, key=lambda row: int(row["index"]))


class RowFile:
    """A study's file, open for more rows, and locked against other processes.

    Parameters
    ----------
    path : Path
    header : mapping
        First line; `digest` and `tables` decide whether a file belongs to the same study.
    resume : bool
        Go on with the file, if there is one.
    overwrite : bool
        Begin anew, even if there is one.

    Raises
    ------
    ResultFileError
        If the file cannot be written, exists without `resume` or `overwrite`, is damaged, or another process
        is writing it.
    StudyError
        If it belongs to another study.
    """

    def __init__(
        self, path: Path, header: Mapping[str, Any], *, resume: bool = False, overwrite: bool = False
    ) -> None:
        self.path = path
        self.header: Mapping[str, Any] = header  # as it stands in the file
        self.rows: list[dict[str, Any]] = []
        self._unsynced_since: float | None = None
        self._handle = _open(path, may_exist=resume or overwrite)
        _open_files.add(self)
        try:
            self._lock()
            if overwrite:
                os.ftruncate(self._handle, 0)
            self._begin(header)
        except BaseException:
            self.close()
            raise

    def append(self, row: Mapping[str, Any]) -> None:
        """Write a row; it outlives this process at once, and the machine after a `tick`."""
        self._write(_line(row))

    def tick(self) -> None:
        """Bring rows to the disk whose time has come; to be called about every half second."""
        if self._unsynced_since is not None and time.monotonic() - self._unsynced_since >= _SYNC_EVERY:
            self._sync()

    def close(self) -> None:
        """Bring all rows to the disk and release the file; a second call does nothing."""
        if self._handle < 0:
            return
        try:
            self._sync()
        finally:
            self._release()

    def _release(self) -> None:
        handle, self._handle = self._handle, -1
        if handle >= 0:
            os.close(handle)

    def _lock(self) -> None:
        try:
            fcntl.flock(self._handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            reason = "another process is writing it; wait for it to end, or give another name"
            raise ResultFileError(self.path, reason) from error
        except OSError as error:
            raise ResultFileError(self.path, f"cannot be locked: {error.strerror}") from error

    def _begin(self, header: Mapping[str, Any]) -> None:
        """Look at what is there: nothing, the beginning of our header, or a table to go on with."""
        content, first = self._content(), _line(header)
        if first.startswith(content):
            os.ftruncate(self._handle, 0)
            self._write(first)
            return
        self.header, self.rows, length = _parse(content, self.path)
        _check_same(self.header, header, self.path)
        os.ftruncate(self._handle, length)

    def _content(self) -> bytes:
        with os.fdopen(os.dup(self._handle), "rb") as file:
            file.seek(0)
            return file.read()

    def _write(self, line: bytes) -> None:
        try:
            while line:
                line = line[os.write(self._handle, line) :]
        except OSError as error:
            raise ResultFileError(self.path, f"cannot be written: {error.strerror}") from error
        if self._unsynced_since is None:
            self._unsynced_since = time.monotonic()

    def _sync(self) -> None:
        if self._unsynced_since is None:
            return
        self._unsynced_since = None
        try:
            os.fsync(self._handle)
        except OSError as error:
            raise ResultFileError(self.path, f"cannot be written: {error.strerror}") from error


# A lock on an open file is shared with forked children, and would outlive this process in them.
_open_files: weakref.WeakSet[RowFile] = weakref.WeakSet()


def _forget_files() -> None:
    for file in list(_open_files):
        file._release()


os.register_at_fork(after_in_child=_forget_files)


def _open(path: Path, *, may_exist: bool) -> int:
    try:
        return os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT | (0 if may_exist else os.O_EXCL), 0o666)
    except FileExistsError as error:
        reason = "exists already; go on with it (--resume, resume=True) or replace it (--overwrite)"
        raise ResultFileError(path, reason) from error
    except IsADirectoryError as error:
        raise ResultFileError(path, "is a folder, expected the name of a file") from error
    except FileNotFoundError as error:
        raise ResultFileError(path, f"there is no folder {str(path.parent)!r}; make it first") from error
    except OSError as error:
        raise ResultFileError(path, f"cannot be written: {error.strerror}") from error


def _line(content: Mapping[str, Any]) -> bytes:
    return json.dumps(content, separators=(",", ":"), default=str, allow_nan=False).encode() + b"\n"


def _parse(content: bytes, path: Path) -> tuple[dict[str, Any], list[dict[str, Any]], int]:
    """Header, rows, and how many bytes of the file they are; a line that is cut off counts as not there."""
    lines = content.split(b"\n")
    header = _header_of(lines, path)
    tasks = header.get("tasks", 0)
    rows: list[dict[str, Any]] = []
    seen: set[int] = set()
    length = len(lines[0]) + 1
    whole = lines[1:-1]  # what stands behind the last end of a line has none
    for number, line in enumerate(whole, start=2):
        row = _object(line)
        if row is None and number == len(whole) + 1:
            break  # blocks that never reached the disk before the power went
        if row is None or not is_row(row) or row["index"] >= tasks or row["index"] in seen:
            raise ResultFileError(path, f"is damaged: line {number} is no row of this study, or a second one")
        seen.add(row["index"])
        rows.append(row)
        length += len(line) + 1
    return header, rows, length


def _header_of(lines: Sequence[bytes], path: Path) -> dict[str, Any]:
    header = _object(lines[0]) if len(lines) > 1 else None
    if header is None or header.get("format") != FORMAT:
        raise ResultFileError(path, "is not the table of a study")
    if header.get("format_version") != FORMAT_VERSION:
        reason = f"has format version {header.get('format_version')}, this mbocp reads {FORMAT_VERSION}"
        raise ResultFileError(path, f"{reason}; use the mbocp that wrote it ({header.get('mbocp')})")
    if not is_header(header):
        raise ResultFileError(path, "is damaged: its first line does not say what the study is")
    return header


def _object(line: bytes) -> dict[str, Any] | None:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _check_same(found: Mapping[str, Any], wanted: Mapping[str, Any], path: Path) -> None:
    digest = found.get("digest", "")
    if digest == wanted["digest"]:
        return
    theirs, ours = found.get("tables", {}), wanted.get("tables", {})
    plain_ours = json.loads(_line(ours))
    other = [key for key in {**theirs, **plain_ours} if theirs.get(key) != plain_ours.get(key)]
    raise StudyError(
        f"{path}: belongs to another study ({found.get('name')!r}, digest "
        f"{digest[:_SHOWN_DIGEST]}..., this one is {wanted['digest'][:_SHOWN_DIGEST]}...; "
        f"they differ in {', '.join(other) or 'nothing that is written'}); give another file"
    )

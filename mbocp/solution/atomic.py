"""Files that are either the old one or the new one, never half of each."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from mbocp.exceptions import ResultFileError

__all__ = ["atomic_path"]


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary file in the folder of `path` that replaces `path` when the block ends well.

    The temporary file is flushed to the disk before it takes the name. If the block raises (Ctrl-C included)
    it is removed, and what was at `path` before is still there.

    Raises
    ------
    ResultFileError
        If the folder does not exist, `path` is a folder, or the disk refuses; other errors pass through.
    """
    target = Path(path).expanduser()
    # Follow a symbolic link, so that the link survives and its target is replaced.
    target = target.resolve() if target.is_symlink() else target.absolute()
    if target.is_dir():
        raise ResultFileError(path, "is a folder: give the name of a file")
    if not target.parent.is_dir():
        raise ResultFileError(path, f"the folder {target.parent} does not exist: create it first")
    temporary = target.with_name(f".{target.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        # Not tempfile: its files are for the owner only, a result has the usual permissions.
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise ResultFileError(path, f"cannot be written: {error.strerror or error}") from error
    try:
        yield temporary
        _flush(temporary)
        temporary.replace(target)
    except OSError as error:
        reason = f"cannot be written: {error.strerror or error}; what was there before is unchanged"
        raise ResultFileError(path, reason) from error
    finally:
        temporary.unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # some file systems do not flush folders; the file itself is safe
        _flush(target.parent)  # so that the new name, too, survives a power cut


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

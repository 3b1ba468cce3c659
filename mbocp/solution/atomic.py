"""Files that are either the old one or the new one, never half of each.

A new file is written under the name `.mbocp-KERNEL-RANDOM.tmp` in the same folder, and locked until it gets
its own name. What a killed process leaves is not locked any more, and is swept up by the next writer in that
folder. Locks say nothing about processes of other machines on a shared disk, so those files, and the ones
from before a restart, are left alone for a day; `KERNEL` tells which is which.
"""

from __future__ import annotations

import contextlib
import csv
import fcntl
import io
import math
import os
import re
import secrets
import stat
from collections.abc import Iterable, Iterator
from functools import lru_cache
from pathlib import Path

from mbocp.exceptions import ResultFileError

_MIN_AGE = 86_400.0  # [s] a file stays whose writer may live where locks are not seen
_OURS = re.compile(r"\.mbocp-(?P<kernel>[0-9a-f]{8})-[0-9a-f]{8}\.tmp")
_EARLIER = re.compile(r"\..+\.(h5|hdf5|html?|png|pdf|svg|csv|json)\.[0-9]{1,7}-[0-9a-f]{8}\.tmp")


def replace_file(path: str | Path, content: bytes) -> Path:
    """Write a file at once: at `path` is what was there before, or all of `content`.

    Raises
    ------
    ResultFileError
        If the folder does not exist, `path` is no file, or the disk refuses.
    """
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)
    return Path(path)


def csv_of(header: Iterable[str], rows: Iterable[Iterable[object]]) -> bytes:
    """The content of a CSV file."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue().encode()


def replace_text(path: str | Path, text: str) -> Path:
    """Write a text as `replace_file` does; what is no text becomes question marks."""
    return replace_file(path, text.encode("utf-8", errors="replace"))


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Give a temporary file in the folder of `path` that replaces `path` when the block ends well.

    The temporary file is flushed to the disk before it takes the name. If the block raises (Ctrl-C included)
    it is removed, and what was at `path` before is still there.

    Raises
    ------
    ResultFileError
        If the folder does not exist, `path` is no file, or the disk refuses; other errors pass through.
    """
    target = _target(path)
    _sweep(target.parent, None)  # first, so that writers which are killed one after another leave one file
    try:
        temporary, handle = _temporary(target.parent)
    except OSError as error:
        raise ResultFileError(path, f"cannot be written: {error.strerror or error}") from error
    try:
        _sweep(target.parent, temporary)
        yield temporary
        _flush(temporary)
        temporary.replace(target)
    except OSError as error:
        reason = f"cannot be written: {error.strerror or error}; what was there before is unchanged"
        raise ResultFileError(path, reason) from error
    finally:
        temporary.unlink(missing_ok=True)
        os.close(handle)  # the lock ends here
    with contextlib.suppress(OSError):  # some file systems do not flush folders; the file itself is safe
        _flush(target.parent)  # so that the new name, too, survives a power cut


def _target(path: str | Path) -> Path:
    kind = stat.S_IFREG  # if there is nothing yet
    try:
        target = Path(path).expanduser()
        # Follow a symbolic link, so that the link survives and its target is replaced.
        target = target.resolve() if target.is_symlink() else target.absolute()
        has_folder = target.parent.is_dir()
        with contextlib.suppress(FileNotFoundError):
            kind = target.stat().st_mode
    except (OSError, ValueError, RuntimeError) as error:
        raise ResultFileError(
            path, f"cannot be written: {getattr(error, 'strerror', '') or error}"
        ) from error
    if stat.S_ISDIR(kind):
        raise ResultFileError(path, "is a folder: give the name of a file")
    if not stat.S_ISREG(kind):
        raise ResultFileError(path, "is a device or a pipe: give the name of a file")
    if not has_folder:
        raise ResultFileError(path, f"the folder {target.parent} does not exist: create it first")
    return target


def _temporary(folder: Path) -> tuple[Path, int]:
    """A new file, locked if the file system has locks."""
    while True:
        temporary = folder / f".mbocp-{_kernel()}-{secrets.token_hex(4)}.tmp"
        # Not tempfile: its files are for the owner only, a result has the usual permissions.
        handle = os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, 0o666)
        try:
            with contextlib.suppress(OSError):
                fcntl.flock(handle, fcntl.LOCK_EX)
            if os.fstat(handle).st_nlink:
                return temporary, handle
        except BaseException:
            os.close(handle)
            temporary.unlink(missing_ok=True)
            raise
        os.close(handle)  # somebody swept it up before it was locked: once more


def _sweep(folder: Path, newest: Path | None) -> None:
    """Remove what killed writers left in a folder.

    `newest` tells the time, by the clock of the disk; without it, only files go of which locks tell.
    """
    with contextlib.suppress(OSError):
        now, own = (newest.stat().st_mtime, newest.name) if newest else (-math.inf, "")
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.name != own and (_OURS.fullmatch(entry.name) or _EARLIER.fullmatch(entry.name)):
                    with contextlib.suppress(OSError):  # swept up by another process
                        _remove_if_left(Path(entry.path), now)


def _remove_if_left(path: Path, now: float) -> None:
    """Remove a temporary file that nobody writes any more."""
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        facts = os.fstat(handle)
        if facts.st_uid != os.geteuid() or not stat.S_ISREG(facts.st_mode):
            return
        ours = _OURS.fullmatch(path.name)
        tells = ours is not None and ours["kernel"] == _kernel()  # whether a lock does
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return
        except OSError:  # a file system without locks
            tells = False
        if tells or now - facts.st_mtime > _MIN_AGE:
            path.unlink()
    finally:
        os.close(handle)


@lru_cache(maxsize=1)
def _kernel() -> str:
    """Eight digits of the running kernel: locks are seen by all of its processes, in containers, too."""
    try:
        name = Path("/proc/sys/kernel/random/boot_id").read_text()[:8]
    except OSError:
        name = ""
    return name if re.fullmatch(r"[0-9a-f]{8}", name) else secrets.token_hex(4)


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)

"""The folder of compiled functions: which one is used, what is in it, what is removed from it.

Its content is loaded as code. So a folder counts only if nobody else may write to it, and an entry only if it
is a regular file of the user's with the right checksum behind it.

Work in progress is in folders of its own, each with a lock file that its process keeps locked. The system
releases the lock when the process ends, however it ends: what can be locked belongs to nobody any more and is
removed by the next process. Process numbers, host names and clocks play no part in that.
"""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import hashlib
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from functools import cache, lru_cache
from pathlib import Path

from mbocp._environment import number_from
from mbocp._text import warn_caller
from mbocp.exceptions import CompilationError

_MAGIC = b"mbocp-stage-1:"  # then the SHA-256 of all that stands before it
_TRAILER = len(_MAGIC) + 64
_SUFFIXES = (".so", ".tape", ".fit")
_BUILD, _PRIVATE, _LOCK = "build-", "mbocp-stages-", "lock"
_TRIES = 100  # to make a folder that no other process sweeps away before it is locked
_LIMIT = 2000  # [MB]
_VARIABLES = ("MBOCP_CACHE_DIR", "XDG_CACHE_HOME", "HOME", "CC", "PATH", "MBOCP_FUNCTIONS")
_IN_USE = 3600 * 10**9  # [ns] after its last use in which an entry is not removed


def cache_folder() -> Path:
    """Folder of compiled stage functions: $MBOCP_CACHE_DIR, else $XDG_CACHE_HOME/mbocp, else ~/.cache/mbocp.

    The folder is created for the user alone; one that somebody else owns or may write to is not used, since
    its content is loaded as code: a private temporary folder takes its place for this process. The same
    holds for a folder from which nothing can be executed.
    """
    try:
        folder = _find_named_folder()
    except RuntimeError as error:  # the system knows no home of this user
        return private_folder(Path("~/.cache/mbocp/stages"), str(error))
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        trusted = is_trusted(folder)
        reason = "somebody else may write to it"
        if trusted and os.statvfs(folder).f_flag & getattr(os, "ST_NOEXEC", 0):
            trusted, reason = False, "it is on a disk that forbids to execute files (noexec)"
    except OSError as error:
        trusted, reason = False, str(error)
    return folder if trusted else private_folder(folder, reason)


def is_trusted(folder: Path) -> bool:
    """Whether a folder is the user's, and nobody else may write to it."""
    state = folder.stat()
    return state.st_uid == os.getuid() and not state.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def environment() -> tuple[str | None, ...]:
    """Variables that say where functions are kept, whether they are compiled, and by which compiler."""
    return tuple(map(os.environ.get, _VARIABLES))


def private_folder(instead_of: Path, reason: str) -> Path:
    """Temporary folder of this process that takes the place of another one; told once, with the reason.

    Raises
    ------
    CompilationError
        If there is none either.
    """
    _tell(str(instead_of), reason)
    try:
        return _make_private_folder()
    except OSError as error:
        raise CompilationError(
            f"compiled functions can be kept neither in {instead_of} ({reason}) nor in a temporary folder "
            f"({error}); set MBOCP_CACHE_DIR to a folder that can be written to"
        ) from error


def is_private(folder: Path) -> bool:
    """Whether a folder is the temporary one of this process."""
    return bool(_make_private_folder.cache_info().currsize) and folder == _make_private_folder()


def folders() -> list[Path]:
    """The folder that is used, and the temporary one of this process, if there is one."""
    private = [_make_private_folder()] if _make_private_folder.cache_info().currsize else []
    return [cache_folder(), *private]


def find_entry(name: str) -> Path | None:
    """Sound entry of that name in the folders."""
    return next((folder / name for folder in folders() if is_sound(folder / name)), None)


def own_content(path: Path) -> bytes | None:
    """Content of a regular file of the user's; None for anything else."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
        with os.fdopen(handle, "rb") as file:
            return file.read() if _is_own_file(os.fstat(handle)) else None
    except OSError:
        return None


def seal(body: bytes) -> bytes:
    """Content of an entry: the library and its checksum."""
    return body + _MAGIC + hashlib.sha256(body).hexdigest().encode()


def unseal(path: Path) -> bytes | None:
    """Content of an entry without its checksum; None where it is not the user's, or damaged."""
    content = own_content(path)
    return content[:-_TRAILER] if content is not None and seal(content[:-_TRAILER]) == content else None


def write_entry(name: str, body: bytes) -> Path | None:
    """Write an entry into the folder as a whole; None where that fails."""
    with contextlib.suppress(OSError):
        file = cache_folder() / name
        with scratch_folder(file.parent) as scratch:
            built = scratch / "entry"
            built.write_bytes(seal(body))
            built.replace(file)
        trim_after(file.parent, len(body))
        return file
    return None


@contextlib.contextmanager
def scratch_folder(folder: Path) -> Iterator[Path]:
    """Folder for work in progress below another one, removed at the end; what dead processes left goes first.

    Raises
    ------
    OSError
        If nothing can be written there.
    """
    _sweep(folder, _BUILD)
    path, lock = _lock_folder(folder, _BUILD)
    try:
        yield path
    finally:
        shutil.rmtree(path, ignore_errors=True)
        os.close(lock)


def entries(folder: Path) -> list[tuple[Path, os.stat_result]]:
    """Entries of a folder: regular files of the user's, those used longest ago first."""
    found = []
    for path in (path for suffix in _SUFFIXES for path in folder.glob(f"*{suffix}")):
        with contextlib.suppress(OSError):  # removed by another process meanwhile
            state = path.lstat()
            if _is_own_file(state):
                found.append((path, state))
    return sorted(found, key=lambda entry: entry[1].st_atime_ns)


def counter_of(tape: Path) -> Path:
    """Return the file beside a tape that says how many of its instructions were executed."""
    return tape.with_suffix(".executed")


def cache_limit() -> int:
    """How large the entries may become together [bytes]: $MBOCP_CACHE_LIMIT in MB, else 2000 MB."""
    megabytes = number_from("MBOCP_CACHE_LIMIT", "a number of megabytes", may_be_zero=True, below=1e12)
    return int(1e6 * (_LIMIT if megabytes is None else megabytes))


def trim_after(folder: Path, written: int) -> None:
    """Trim a folder when this process writes into it first [bytes], and after each twentieth of the limit.

    To look at thousands of entries takes longer than to write one.
    """
    limit = cache_limit()
    room = _room_in(folder, limit)
    room.left -= written
    if room.left < 0:
        room.left = limit // 20
        trim(folder)


def trim(folder: Path) -> None:
    """Remove the entries used longest ago until the rest is within the limit.

    Those used within an hour of the latest use stay: another process may be about to load them. One that has
    loaded an entry keeps it, whatever happens to the file.
    """
    found, limit = entries(folder), cache_limit()
    total = sum(state.st_size for _, state in found)
    latest = found[-1][1].st_atime_ns if found else 0
    for path, state in found:
        if total <= limit or latest - state.st_atime_ns < _IN_USE:
            return
        with contextlib.suppress(OSError):  # removed by another process, or not ours to remove
            path.unlink()
            counter_of(path).unlink(missing_ok=True)
        total -= state.st_size


class _Room:
    """How much this process writes into a folder before it looks at what is there [bytes]."""

    left = 0


@cache
def _room_in(folder: Path, limit: int) -> _Room:
    return _Room()


def _find_named_folder() -> Path:
    named = os.environ.get("MBOCP_CACHE_DIR")
    if named:
        return Path(named) / "stages"
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "mbocp" / "stages"


@cache
def _tell(folder: str, reason: str) -> None:
    warn_caller(
        f"the cache of compiled functions {folder} is not used: {reason}; mend it (chmod 700, owner, "
        "space) or set MBOCP_CACHE_DIR to another folder. Compiling into a temporary folder.",
        RuntimeWarning,
    )


@cache
def _make_private_folder() -> Path:
    parent = Path(tempfile.gettempdir())
    _sweep(parent, _PRIVATE)
    path, lock = _lock_folder(parent, _PRIVATE)
    atexit.register(_remove, path, lock, os.getpid())
    return path


def _remove(path: Path, lock: int, owner: int) -> None:
    if os.getpid() == owner:  # a process that was forked off leaves it alone
        shutil.rmtree(path, ignore_errors=True)
        os.close(lock)


def _is_own_file(state: os.stat_result) -> bool:
    return stat.S_ISREG(state.st_mode) and state.st_uid == os.getuid()


def is_sound(library: Path) -> bool:
    """Whether an entry is the user's, with the right checksum behind it."""
    try:
        state = library.lstat()
    except OSError:
        return False
    return _is_own_file(state) and _has_checksum(library, state.st_ino, state.st_mtime_ns, state.st_size)


@lru_cache(maxsize=1024)
def _has_checksum(library: Path, inode: int, changed_ns: int, size: int) -> bool:
    """Whether the file ends with the checksum of the rest; looked at once for each state of the file."""
    if unseal(library) is None:
        return False
    with contextlib.suppress(OSError):  # in a read-only folder nothing is removed either
        os.utime(library, ns=(time.time_ns(), changed_ns))  # used now: it is the last to be removed
    return True


def _lock_folder(parent: Path, prefix: str) -> tuple[Path, int]:
    """Return a new folder, and the open lock file in it that says that its process is alive."""
    for _ in range(_TRIES):
        path = Path(tempfile.mkdtemp(dir=parent, prefix=prefix))
        try:
            lock = _lock(path)
        except OSError:
            shutil.rmtree(path, ignore_errors=True)
            raise
        if lock is not None:
            return path, lock
    raise OSError(f"{parent}: every new folder is removed at once")


def _lock(path: Path) -> int | None:
    """Lock a new folder; None if another process swept it away just now."""
    try:
        lock = os.open(path / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    except FileNotFoundError:
        return None
    try:
        os.write(lock, b"locked by the process that works here\n")  # a full disk shows here
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            return None
        except OSError:
            return lock  # a file system without locks: nobody can sweep this folder away
        if (path / _LOCK).exists():
            return lock
        os.close(lock)
        return None
    except BaseException:
        os.close(lock)
        raise


@cache
def _sweep(parent: Path, prefix: str) -> None:
    """Remove the user's folders whose processes have ended; once in a process."""
    for path in parent.glob(f"{prefix}*"):
        with contextlib.suppress(OSError):  # locked by a living process, or removed by another one
            state = path.lstat()
            if stat.S_ISDIR(state.st_mode) and state.st_uid == os.getuid():
                _sweep_away(path)


def _sweep_away(path: Path) -> None:
    try:
        lock = os.open(path / _LOCK, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        path.rmdir()  # its process ended before it made the lock; fails unless the folder is empty
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(path, ignore_errors=True)
    finally:
        os.close(lock)

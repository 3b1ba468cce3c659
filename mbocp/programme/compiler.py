"""The C compiler as a process that never outlives the one that started it.

A compiler driver starts others (cc1, as, ld). All of them run in a process group of their own, led by a
shell that also waits for the end of a pipe. The parent alone holds the other end of that pipe: when it ends,
however it ends, the system closes the pipe and the shell kills the group. A signal at the parent's death
(PR_SET_PDEATHSIG) would reach the driver but not what it has started, and is known to Linux alone.
"""

from __future__ import annotations

import errno
import math
import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path

from mbocp.exceptions import CompilationError, CompilationTimeout, InvalidValue

_SHELL = "/bin/sh"
_WATCHED = """\
exec 3<&0 </dev/null
(read -r _ <&3; kill -KILL 0) &
watch=$!
"$@" 3<&- &
wait $!
code=$?
{ kill $watch; wait $watch; } 2>/dev/null
exit $code
"""
_MAX_OUTPUT = 2000  # characters of what a compiler said
_FULL = ("No space left on device", "Disk quota exceeded", "Bus error")  # ld maps its output into memory
_FROM_SIGNAL = 128  # a shell adds it to the number of the signal that killed a command


def compiler() -> tuple[str, ...] | None:
    """The C compiler that is used, as the first words of a command; None when there is none.

    It is $CC, which may have options ("gcc -m64") or a wrapper ("ccache gcc"), quoted as in a shell; where
    that is not set or names no program, it is cc, gcc or clang, and where there are none of these the one of
    the package `ziglang` (``pip install mbocp[compiler]``).

    Returns
    -------
    command : tuple of str, or None
        Path of the program, and the options that $CC gives it.

    Raises
    ------
    InvalidValue
        If $CC has a quote that does not end.
    """
    for words in (_read_named_compiler(), ["cc"], ["gcc"], ["clang"]):
        found = shutil.which(words[0]) if words else None
        if found:
            return (found, *words[1:])
    return _find_packaged_compiler()


def _find_packaged_compiler() -> tuple[str, ...] | None:
    """Clang with headers and libraries as a Python package, for the oldest glibc that it knows."""
    if find_spec("ziglang") is None:
        return None
    target = (
        f"{platform.machine()}-linux-gnu.2.17"  # without it: the instructions of this processor, in any cache
    )
    return (sys.executable, "-m", "ziglang", "cc", "-target", target, "-fno-sanitize=undefined")


def _read_named_compiler() -> list[str]:
    """Words of $CC; one that is as it stands the path of a program is not taken apart."""
    named = os.environ.get("CC", "")
    if shutil.which(named):
        return [named]
    try:
        return shlex.split(named)
    except ValueError:
        raise InvalidValue("CC", repr(named), "a compiler and its options, quoted as in a shell") from None


def check_deadline(deadline: float, doing: str) -> None:
    """Raise `CompilationTimeout` if the time of `time.perf_counter` is beyond the deadline."""
    if time.perf_counter() > deadline:
        raise CompilationTimeout(doing)


def run_compiler(
    command: Sequence[str], scratch: Path, deadline: float = math.inf, *, before: Sequence[Sequence[str]] = ()
) -> None:
    """Run a compiler to its end.

    Parameters
    ----------
    command : sequence of str
        Path of the compiler, and its arguments.
    scratch : Path
        Folder for its temporary files.
    deadline : float
        Time of `time.perf_counter` at which it is killed.
    before : sequence of sequence of str
        Commands of the same compiler that run first, side by side.

    Raises
    ------
    CompilationError
        If it cannot be run, or fails.
    CompilationTimeout
        If it was killed at the deadline.
    OSError
        If the disk is full.
    """
    whole = [_SHELL, "-c", _side_by_side(before, command)] if before else command
    code, messages = _outcome(whole, scratch, deadline)
    if code == 0:
        return
    said = messages[-_MAX_OUTPUT:].decode(errors="replace").strip()
    if any(words in said for words in _FULL) and shutil.disk_usage(scratch).free < _room(scratch):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(scratch))
    how = f"exit {code}"
    if code > _FROM_SIGNAL:
        how = f"killed by signal {code - _FROM_SIGNAL}"
    raise CompilationError(
        f"the C compiler {command[0]} failed on generated functions ({how}). `mbocp doctor` says whether it "
        f"works on this machine; if it does, this is a defect of mbocp: please report it. It said:\n{said}"
    )


def _side_by_side(commands: Sequence[Sequence[str]], last: Sequence[str]) -> str:
    """Lines of a shell that runs commands at once, and a last one where all of them end well."""
    begun = [f"{shlex.join(command)} & p{i}=$!" for i, command in enumerate(commands)]
    waits = [f"wait $p{i} || failed=$?" for i in range(len(commands))]
    return "\n".join(
        [*begun, "failed=0", *waits, "[ $failed = 0 ] || exit $failed", f"exec {shlex.join(last)}"]
    )


def _room(scratch: Path) -> int:
    """Twice what the compiler has read and written so far, and at least 1 MB [bytes]."""
    return max(2 * sum(path.stat().st_size for path in scratch.iterdir()), 10**6)


def _outcome(command: Sequence[str], scratch: Path, deadline: float) -> tuple[int, bytes]:
    """Exit code, and what was said; nothing that was started is left."""
    folders = {"ZIG_GLOBAL_CACHE_DIR": str(scratch.parent / "zig"), "ZIG_LOCAL_CACHE_DIR": str(scratch)}
    environment = {**folders, **os.environ, "TMPDIR": str(scratch), "LC_ALL": "C"}
    left = None if math.isinf(deadline) else max(0.0, deadline - time.perf_counter())
    try:
        return run_and_watch(command, environment, timeout=left)
    except subprocess.TimeoutExpired as error:
        raise CompilationTimeout("the C compiler ran") from error
    except FileNotFoundError as error:
        raise CompilationError(f"cannot run the C compiler: there is no {_SHELL}") from error


def run_and_watch(
    command: Sequence[str],
    environment: Mapping[str, str],
    *,
    timeout: float | None = None,
    begun: Callable[[int], None] = lambda group: None,
) -> tuple[int, bytes]:
    """Run a command in a process group of its own, which ends with this process at the latest.

    Parameters
    ----------
    command : sequence of str
    environment : mapping of str to str
    timeout : float, optional
        Seconds after which it is killed.
    begun : callable
        Called with the number of the process group.

    Returns
    -------
    code : int
        Exit code.
    said : bytes
        What it wrote to standard output and standard error.

    Raises
    ------
    subprocess.TimeoutExpired
        If it was killed.
    OSError
        If it cannot be started.
    """
    watched, held = os.pipe()  # neither is inherited, but for what is passed on as standard input
    try:
        with subprocess.Popen(
            [_SHELL, "-c", _WATCHED, _SHELL, *command],
            stdin=watched,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
        ) as process:
            try:
                begun(process.pid)
                said, _ = process.communicate(timeout=timeout)
            finally:
                if process.poll() is None:
                    os.killpg(process.pid, signal.SIGKILL)
            return process.returncode, said
    finally:
        os.close(watched)
        os.close(held)

"""How much memory there is, what a horizon takes, and the one place that refuses what needs more.

The limit is a share of what the machine, its container (cgroup) or the process (RLIMIT_AS) has left,
whichever is least; the environment variable MBOCP_MEMORY_LIMIT, in MB, takes its place.
"""

from __future__ import annotations

import os
import resource
from collections.abc import Iterator
from pathlib import Path

from mbocp._environment import number_from
from mbocp.exceptions import MemoryLimitExceeded

_SHARE = 0.8  # of the memory that is left
_NAME = "MBOCP_MEMORY_LIMIT"
_CGROUPS = Path("/sys/fs/cgroup")


def is_given() -> bool:
    """Whether the user has set a limit."""
    return _NAME in os.environ


def memory_limit() -> tuple[float, str]:
    """Bytes that one problem may take, and where that number comes from, in words.

    Raises
    ------
    InvalidValue
        If MBOCP_MEMORY_LIMIT is no positive number.
    """
    megabytes = number_from(_NAME, "a number of megabytes > 0")
    if megabytes is not None:
        return 1e6 * megabytes, _NAME
    left = min([*_of_machine(), *_of_cgroup(), *_of_process()], default=float("inf"))
    return _SHARE * left, f"{100 * _SHARE:.0f} % of the memory that is left"


def check_memory(needed: float, what: str, remedy: str) -> None:
    """Refuse what needs more memory than the limit, before anything is allocated.

    Parameters
    ----------
    needed : float
        Estimate [bytes].
    what, remedy : str
        What needs it, and what to change; for the message.

    Raises
    ------
    MemoryLimitExceeded
    """
    limit, source = memory_limit()
    if needed > limit:
        raise MemoryLimitExceeded(what, needed, limit, source, remedy)


def _of_machine() -> Iterator[float]:
    fields = _fields(Path("/proc/meminfo"), ":")
    if "MemAvailable" in fields:
        yield 1024.0 * fields["MemAvailable"]  # "kB" there are 1024 bytes
    else:
        yield float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")


def _of_process() -> Iterator[float]:
    soft, _ = resource.getrlimit(resource.RLIMIT_AS)
    if soft != resource.RLIM_INFINITY:
        held = 1024.0 * _fields(Path("/proc/self/status"), ":").get("VmSize", 0.0)
        yield max(0.0, soft - held)


def _of_cgroup() -> Iterator[float]:
    """What each group that the process belongs to has left: version 2, and version 1."""
    for line in _text(Path("/proc/self/cgroup")).splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            root, names = _CGROUPS, ("memory.max", "memory.current")
        elif "memory" in controllers.split(","):
            root, names = _CGROUPS / "memory", ("memory.limit_in_bytes", "memory.usage_in_bytes")
        else:
            continue
        inner = root / path.lstrip("/")
        for folder in (inner, *inner.parents):
            if folder.is_relative_to(root):
                yield from _of_group(folder, *names)


def _of_group(folder: Path, most: str, used: str) -> Iterator[float]:
    limit, usage = _number(_text(folder / most)), _number(_text(folder / used))
    if limit is not None and usage is not None:
        cache = _fields(folder / "memory.stat", " ").get("inactive_file", 0.0)  # given back when needed
        yield max(0.0, limit - max(0.0, usage - cache))


def _fields(path: Path, separator: str) -> dict[str, float]:
    found = {}
    for line in _text(path).splitlines():
        name, _, rest = line.partition(separator)
        value = _number(rest.strip().partition(" ")[0])
        if value is not None:
            found[name.strip()] = value
    return found


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:  # "max": no limit
        return None


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace")
    except OSError:  # not on this system
        return ""


# Fitted to the largest resident memory of solves of 10,000 to 40,000 steps; 10 to 30 % more than measured.
_MATRICES, _VECTORS, _REST = 2.5, 16.0, 3000.0
_INTERIOR = 4.5  # solvers of others keep their own Jacobians, Hessians and factors; IPOPT: 3.7 measured
_SMALL = 16e6  # [bytes]: less than a tenth of what the process has taken by then; nobody asks the system
_MAX_FLOAT = 10**300  # beyond, floats end


def check_horizon(steps: int, unknowns: int, *, by_others: bool = False) -> None:
    """Refuse more steps than there is memory for.

    Parameters
    ----------
    steps : int
        N.
    unknowns : int
        States at both ends of a step, impulses and controls.
    by_others : bool
        Whether IPOPT or fatrop solves the problem.

    Raises
    ------
    MemoryLimitExceeded
    """
    each = bytes_per_step(unknowns, by_others=by_others)
    if steps <= _SMALL / each and not is_given():  # an integer may be beyond all floats
        return
    check_memory(
        min(steps * round(each), _MAX_FLOAT),
        f"horizon.steps: {min(steps, _MAX_FLOAT):.4g} steps of {unknowns} unknowns "
        f"({each / 1e3:.3g} kB each)",
        "Take fewer steps",
    )


def bytes_per_step(unknowns: int, *, by_others: bool = False) -> float:
    """Memory of one step in a solve: a few matrices and vectors of its unknowns, and records [bytes]."""
    ours = 8.0 * (_MATRICES * unknowns**2 + _VECTORS * unknowns) + _REST
    return _INTERIOR * ours if by_others else ours

"""What the numbers were measured on."""

from __future__ import annotations

import os
import platform
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

from mbocp_papers.machine import processor

from benchmarks.tables import Table
from mbocp.programme.native_modules import kernel

__all__ = ["header", "memory", "one_core"]


@dataclass(frozen=True)
class _Machine(Table):
    """A table in a terminal, and a line on a page."""

    def markdown(self) -> str:
        return f"Machine: {'; '.join(' '.join(row) for row in self.rows)}."


def one_core() -> None:
    """Keep this process on one core, where the system allows it."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})


def header() -> Table:
    """Machine, versions, and how busy the machine is."""
    packages = ("mbocp", "pin", "casadi", "numpy")
    rows = [
        ("processor", f"{processor()}, {os.cpu_count()} cores, one used"),
        ("system", f"{platform.system()} {platform.machine()}, Python {platform.python_version()}"),
        ("packages", ", ".join(f"{name} {version(name)}" for name in packages)),
        ("kernel", kernel().__name__.rpartition(".")[2]),
        ("load", f"{os.getloadavg()[0]:.2f} (one-minute average at the start)"),
    ]
    return _Machine("Machine", ("", "found"), rows)


def memory(name: str) -> int:
    """Memory of this process [bytes]: "VmRSS", resident, or "VmHWM", the largest resident one.

    0 where the system does not say. `getrusage` would count the parent's, too.
    """
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0
    return 1024 * next((int(line.split()[1]) for line in lines if line.startswith(f"{name}:")), 0)

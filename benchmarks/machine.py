"""What the numbers were measured on."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version

from benchmarks.tables import Table
from mbocp.papers.machine import processor
from mbocp.programme.kernel import kernel

__all__ = ["header", "one_core"]


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
    return Table("Machine", ("", "found"), rows)

"""What numbers were measured on, in one line."""

from __future__ import annotations

import os
import platform
import re
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import mbocp


def machine_line() -> str:
    """Versions, processor and how busy it is."""
    packages = ", ".join(f"{name} {_version(name)}" for name in ("pin", "casadi", "numpy"))
    load = f", load {os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else ""
    return (
        f"mbocp {mbocp.__version__} ({packages}, Python {platform.python_version()}) on {processor()}, "
        f"{os.cpu_count()} cores{load}"
    )


def processor() -> str:
    """Name of the processor."""
    try:
        found = re.search(r"model name\s*:\s*(.+)", Path("/proc/cpuinfo").read_text(encoding="utf-8"))
    except OSError:
        found = None
    return found.group(1).strip() if found else platform.processor() or "unknown processor"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # a Pinocchio from elsewhere than the registry has no such record
        return "unknown"

"""Print where the packages that the native part is built against are, one line each, for CMakeLists.txt."""

from __future__ import annotations

import sys
from importlib.metadata import PackageNotFoundError, distribution, version
from importlib.util import find_spec
from pathlib import Path


def main() -> None:
    """Print nanobind's CMake folder, Pinocchio's prefix, casadi's folder, the versions of these two."""
    import nanobind

    casadi = find_spec("casadi")
    if casadi is None or casadi.origin is None:
        raise SystemExit("casadi is not installed")
    prefix, pinocchio = _pinocchio()
    print(nanobind.cmake_dir())
    print(prefix)
    print(Path(casadi.origin).resolve().parent)
    print(pinocchio)
    print(version("casadi"))


def _pinocchio() -> tuple[Path, str]:
    """Return the folder of its `include` and `lib`, Python's own in conda's environments, and its version."""
    try:
        wheel = distribution("libpinocchio")
    except PackageNotFoundError:
        return Path(sys.prefix), version("pin")
    return Path(str(wheel.locate_file("cmeel.prefix"))).resolve(), wheel.version


if __name__ == "__main__":
    main()

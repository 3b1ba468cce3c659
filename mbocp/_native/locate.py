"""Print where the wheels that the native part is built against are, one line each, for CMakeLists.txt."""

from __future__ import annotations

from importlib.metadata import distribution
from importlib.util import find_spec
from pathlib import Path


def main() -> None:
    """Print nanobind's CMake folder, the cmeel prefix, casadi's folder, and the versions of the last two."""
    import nanobind

    casadi = find_spec("casadi")
    if casadi is None or casadi.origin is None:
        raise SystemExit("casadi is not installed")
    libpinocchio = distribution("libpinocchio")
    print(nanobind.cmake_dir())
    print(Path(str(libpinocchio.locate_file("cmeel.prefix"))).resolve())
    print(Path(casadi.origin).resolve().parent)
    print(libpinocchio.version)
    print(distribution("casadi").version)


if __name__ == "__main__":
    main()

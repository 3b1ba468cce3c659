"""Check that the native part fits the Pinocchio and CasADi that are installed.

Minor releases of libpinocchio break the ABI without a sign: a mismatched pair computes, and computes
nonsense. So the versions must be the very ones that the native part was compiled against.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import PackageNotFoundError, version

from mbocp.exceptions import NativeMismatch


def check_versions() -> None:
    """Compare what the native part was compiled against with what is installed.

    Raises
    ------
    NativeMismatch
        If pin, libpinocchio or casadi have another version, or if the native part was never built.
    """
    compiled = _compiled_versions()
    for name, expected in compiled.items():
        installed = _installed_version(name)
        if installed != expected:
            found = f"{name} {installed} is installed" if installed else f"{name} is not installed"
            wanted = " ".join(f"{package}=={number}" for package, number in compiled.items())
            raise NativeMismatch(
                f"mbocp's native part was compiled against {name} {expected}, but {found}; together they may "
                f"compute wrong numbers without an error. Run `python -m pip install {wanted}`, or reinstall "
                "mbocp to compile it again"
            )


def _compiled_versions() -> dict[str, str]:
    try:
        versions = import_module("mbocp._native._versions")
    except ImportError as error:
        raise NativeMismatch(
            "mbocp's native part is not built; run `python -m pip install .` (or `make setup`) in mbocp's "
            "source folder"
        ) from error
    return {"pin": versions.PINOCCHIO, "libpinocchio": versions.PINOCCHIO, "casadi": versions.CASADI}


def _installed_version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None

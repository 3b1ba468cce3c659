"""The native part, imported once it is known to fit the Pinocchio and CasADi that are installed.

Minor releases of libpinocchio break the ABI without a sign: a mismatched pair computes, and computes
nonsense. So its version must be the very one that the native part was compiled against. CasADi is touched
through its handles alone, which stay as they are within a minor release.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

import pinocchio as pin

from mbocp._processes import signals_wait
from mbocp.exceptions import InvalidValue, NativeMismatch, UnknownJoint

if TYPE_CHECKING:
    from mbocp._native import _bridge


def check_versions() -> None:
    """Compare what the native part was compiled against with what is installed.

    Raises
    ------
    NativeMismatch
        If pin or libpinocchio have another version, or casadi another minor release, or if the native part
        was never built.
    """
    compiled = _read_compiled_versions()
    for name, expected in compiled.items():
        installed = _read_installed_version(name)
        if not _fits(name, installed, expected):
            found = f"{name} {installed} is installed" if installed else f"{name} is not installed"
            wanted = " ".join(f"{package}=={number}" for package, number in compiled.items())
            raise NativeMismatch(
                f"mbocp's native part was compiled against {name} {expected}, but {found}; together they may "
                f"compute wrong numbers without an error. Run `python -m pip install {wanted}`, or reinstall "
                "mbocp to compile it again"
            )


def _read_compiled_versions() -> dict[str, str]:
    try:
        versions = import_module("mbocp._native._versions")
    except ImportError as error:
        raise NativeMismatch(
            "mbocp's native part is not built; run `python -m pip install .` (or `make setup`) in mbocp's "
            "source folder"
        ) from error
    return {"pin": versions.PINOCCHIO, "libpinocchio": versions.PINOCCHIO, "casadi": versions.CASADI}


def _fits(name: str, installed: str | None, compiled: str) -> bool:
    if installed is None:  # conda's packages of the two libraries say no version to Python
        return name != "pin"
    if name == "casadi":
        return installed.split(".")[:2] == compiled.split(".")[:2]
    return installed == compiled


def _read_installed_version(name: str) -> str | None:
    from importlib.metadata import PackageNotFoundError, version  # slow to import

    try:
        return version(name)
    except PackageNotFoundError:
        return None


@cache
def bridge() -> ModuleType:
    """Return the extension module, after `check_versions`."""
    check_versions()
    with signals_wait():
        return import_module("mbocp._native._bridge")


def native_constraint(
    constraint: pin.RigidConstraintModel, joints: tuple[str, ...], model_name: str
) -> _bridge.RigidConstraint:
    """Translate Pinocchio's constraint; the errors are those of `ModelFunctions.constraint_jacobian`."""
    sizes = {pin.ContactType.CONTACT_3D: 3, pin.ContactType.CONTACT_6D: 6}
    if constraint.type not in sizes:
        raise InvalidValue("constraint type", constraint.type, "CONTACT_3D or CONTACT_6D")
    if constraint.reference_frame == pin.ReferenceFrame.WORLD:
        raise InvalidValue("constraint reference frame", "WORLD", "LOCAL or LOCAL_WORLD_ALIGNED")
    for joint in (constraint.joint1_id, constraint.joint2_id):
        if not 0 <= joint < len(joints):
            raise UnknownJoint(f"#{joint}", model_name, joints)
    return bridge().RigidConstraint(
        sizes[constraint.type],
        _attachment(constraint.joint1_id, constraint.joint1_placement),
        _attachment(constraint.joint2_id, constraint.joint2_placement),
        constraint.reference_frame == pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
    )


def _attachment(joint: int, placement: pin.SE3) -> _bridge.Attachment:
    rotation = placement.rotation.ravel(order="F").tolist()
    return bridge().Attachment(joint, rotation, placement.translation.tolist())

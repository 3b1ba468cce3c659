"""The native part, imported once its versions are known to fit."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

import pinocchio as pin

from mbocp.exceptions import InvalidValue, UnknownJoint
from mbocp.symbolic.versions import check_versions

if TYPE_CHECKING:
    from mbocp._native import _bridge


@cache
def bridge() -> ModuleType:
    """Return the extension module, after `check_versions`."""
    check_versions()
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
    native: _bridge.RigidConstraint = bridge().RigidConstraint(
        sizes[constraint.type],
        _attachment(constraint.joint1_id, constraint.joint1_placement),
        _attachment(constraint.joint2_id, constraint.joint2_placement),
        constraint.reference_frame == pin.ReferenceFrame.LOCAL_WORLD_ALIGNED,
    )
    return native


def _attachment(joint: int, placement: pin.SE3) -> _bridge.Attachment:
    rotation = placement.rotation.ravel(order="F").tolist()
    native: _bridge.Attachment = bridge().Attachment(joint, rotation, placement.translation.tolist())
    return native

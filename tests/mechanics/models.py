"""Small robots put together by hand, one for each kind of joint and force."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.robot import Actuation, FrameActuator, Label, Limits, QuarticSpring, Robot, Rod

ORIGIN = pin.SE3.Identity()
BODY = pin.Inertia(1.3, np.array([0.1, 0.2, -0.3]), np.diag([1.0, 2.0, 2.5]))  # [kg, m, kg m^2]
POINT = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))  # [kg]


def robot(
    model: Any,
    *,
    B: Array | None = None,
    actuators: tuple[FrameActuator, ...] = (),
    constraints: tuple[Any, ...] = (),
    forces: tuple[Any, ...] = (),
) -> Robot:
    selection = np.eye(model.nv) if B is None else B
    nu = selection.shape[1] + len(actuators)
    labels = tuple(Label(f"u{i}", "N") for i in range(nu))
    infinite = np.full(model.nq, np.inf)
    return Robot(
        name="by hand",
        model=model,
        visual_model=pin.GeometryModel(),
        actuation=Actuation(selection, labels, actuators),
        constraints=constraints,
        forces=forces,
        q0=pin.neutral(model),
        limits=Limits(np.full(nu, np.inf), np.full(model.nv, np.inf), -infinite, infinite),
    )


def chain(kinds: str, inertia: Any = BODY, *, model: Any = None, prefix: str = "") -> tuple[Any, int]:
    """Append a chain of joints ("PX RZ FreeFlyer") with a body at the end, and return its frame."""
    model = pin.Model() if model is None else model
    joint = 0
    for i, kind in enumerate(kinds.split()):
        joint = model.addJoint(joint, getattr(pin, f"JointModel{kind}")(), ORIGIN, f"{prefix}{i}_{kind}")
    model.appendBodyToJoint(joint, inertia, ORIGIN)
    return model, model.addFrame(pin.Frame(f"{prefix}body", joint, 0, ORIGIN, pin.FrameType.BODY))


def weightless(model: Any) -> Any:
    copy = model.copy()
    copy.gravity.linear = np.zeros(3)
    return copy


def point_mass(**others: Any) -> Robot:
    return robot(chain("PX PY PZ", POINT)[0], **others)


def spherical_pendulum(
    *, gravity: bool = True, pivot: tuple[float, float, float] | None = None, **others: Any
) -> Robot:
    """Point mass on a rod, as in section 6.2."""
    model, bob = chain("PX PY PZ", POINT)
    fixed = 0
    if pivot is not None:
        fixed = model.addFrame(
            pin.Frame("pivot", 0, 0, pin.SE3(np.eye(3), np.array(pivot)), pin.FrameType.OP_FRAME)
        )
    rod = Rod("rod", bob, fixed, 5.0)  # [m]
    return robot(model if gravity else weightless(model), constraints=(rod,), **others)


def elastic_pendulum() -> Robot:
    """Point mass on a quartic spring, as in section 6.1."""
    model, bob = chain("PX PY PZ", POINT)
    return robot(model, forces=(QuarticSpring("spring", bob, 0, 0.6 / (2 * 5.0**2), 5.0),))


def cart_pendulum() -> Robot:
    """Cart and bob in the x-z plane, as in section 6.3."""
    model, cart = chain("PX", pin.Inertia(2.0, np.zeros(3), np.zeros((3, 3))), prefix="cart_")
    model, bob = chain("PX PZ", pin.Inertia(0.2, np.zeros(3), np.zeros((3, 3))), model=model, prefix="bob_")
    return robot(model, B=np.eye(3)[:, :1], constraints=(Rod("rod", bob, cart, np.sqrt(1.25)),))

"""Values of frames and their derivatives in (q, v), by Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from tests.checker.system import Array, System
from tests.checker.task import FramePose, PathBound

__all__ = ["bound_values", "pose_left", "pose_values"]


def bound_values(system: System, bound: PathBound, q: Array, v: Array) -> tuple[Array, Array]:
    """Values of a bound's function, and their derivatives in (q, v)."""
    model, data, nv = system.model, system.data, system.nv
    frame = model.getFrameId(bound.frame)
    zero, world = np.zeros(nv), pin.LOCAL_WORLD_ALIGNED
    pin.computeForwardKinematicsDerivatives(model, data, q, v, zero)
    pin.updateFramePlacements(model, data)
    p = np.array(data.oMf[frame].translation)
    J = np.array(pin.computeFrameJacobian(model, data, q, frame, world)[:3])
    if bound.kind == "position":
        chosen = list(bound.axes)
        return p[chosen], np.hstack([J[chosen], np.zeros((len(chosen), nv))])
    if bound.kind == "distance":
        d = p - bound.point
        length = float(np.linalg.norm(d))
        return np.array([length]), np.concatenate([d @ J / length, zero])[None]
    if bound.kind in ("line", "kept", "orientation"):
        values, slopes = _turned_or_beside(system, bound, frame, J)
        return values, np.hstack([slopes, np.zeros_like(slopes)])
    pin.computeForwardKinematicsDerivatives(model, data, q, v, zero)
    d_q, d_v = pin.getFrameVelocityDerivatives(model, data, frame, world)
    at = slice(3, 6) if bound.kind == "angular_speed" else slice(0, 3)
    speed = np.array(d_v[at]) @ v
    length = float(np.linalg.norm(speed))
    if length < 1e-12:
        return np.array([length]), np.zeros((1, 2 * nv))
    return np.array([length]), (speed @ np.hstack([np.array(d_q[at]), np.array(d_v[at])]) / length)[None]


def _turned_or_beside(system: System, bound: PathBound, frame: int, J: Array) -> tuple[Array, Array]:
    """Values of bounds on lines and axes, and their derivatives in q; frames are placed already."""
    at = system.data.oMf[frame]
    world = np.array(pin.getFrameJacobian(system.model, system.data, frame, pin.LOCAL_WORLD_ALIGNED))
    if bound.kind == "line":
        normals = np.linalg.svd(bound.direction[None])[2][1:]
        values, slopes = normals @ (at.translation - bound.point), normals @ J
    elif bound.kind == "kept":
        turn = bound.rotation.T @ at.rotation  # type: ignore[union-attr]
        values = np.array(pin.log3(turn))
        slopes = pin.Jlog3(turn) @ at.rotation.T @ world[3:]
    else:
        axis = at.rotation @ bound.axis
        normal = np.cross(bound.direction, axis)
        sine, cosine = float(np.linalg.norm(normal)), float(bound.direction @ axis)
        slope = (normal / sine) @ world[3:] if sine > 1e-12 else np.zeros(system.nv)
        return np.array([np.arctan2(sine, cosine)]), slope[None]
    if bound.lower.size == values.size:
        return values, slopes
    length = float(np.linalg.norm(values))
    return np.array([length]), (values @ slopes / max(length, 1e-300))[None]


def pose_left(system: System, pose: FramePose, q: Array) -> tuple[Array, Array, Array, Array]:
    """What is left to a pose: coordinates that are asked for, rotation vector; each with its Jacobian."""
    model, data = system.model, system.data
    frame = model.getFrameId(pose.frame)
    system.place(q)
    at = data.oMf[frame]
    chosen = np.flatnonzero(np.isfinite(pose.position))
    moved = system.frame_jacobian(frame, pin.LOCAL_WORLD_ALIGNED)[:3][chosen]
    if pose.rotation is None:
        return (at.translation - pose.position)[chosen], moved, np.zeros(0), np.zeros((0, system.nv))
    turn = pose.rotation.T @ at.rotation
    turned = pin.Jlog3(turn) @ system.frame_jacobian(frame, pin.LOCAL)[3:]
    return (at.translation - pose.position)[chosen], moved, np.array(pin.log3(turn)), turned


def pose_values(system: System, pose: FramePose, q: Array) -> tuple[Array, Array]:
    """Equations of a pose, those that have no tolerance, and their Jacobian in q."""
    away, moved, angle, turned = pose_left(system, pose, q)
    values, rows = np.zeros(0), np.zeros((0, system.nv))
    if not pose.box:
        values, rows = away, moved
    if not pose.cone:
        values, rows = np.concatenate([values, angle]), np.vstack([rows, turned])
    return values, rows

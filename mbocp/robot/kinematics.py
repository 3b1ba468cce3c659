"""Numeric kinematics and forces of a `pin.Model`: `Robot` offers them, and tests compare with them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, IntArray
from mbocp.exceptions import UnknownFrame
from mbocp.robot import joints
from mbocp.robot.large import composite_mass_matrix, is_large, make_working_data
from mbocp.robot.parts import Connector, QuarticSpring, SpringDamper

WORLD = "world"
_MIN_EIGENVALUE = 1e-12  # smallest eigenvalue of the mass matrix scaled to a unit diagonal
_ON_CIRCLES = ("continuous", "planar")
_circles = WeakKeyDictionary[pin.Model, list[tuple[int, int, str]]]()  # where such joints are in q and in v
_TURNING = ("revolute", "continuous", "spherical")


def frame_id(model: pin.Model, name: str, robot: str) -> int:
    """Index of a frame by name; "world" is the universe; a body wins over a joint of the same name."""
    if name == WORLD:
        return 0
    found = [i for i, frame in enumerate(model.frames) if frame.name == name]
    if not found:
        raise UnknownFrame(name, robot, dict.fromkeys([WORLD, *(frame.name for frame in model.frames)]))
    bodies = [i for i in found if model.frames[i].type == pin.FrameType.BODY]
    return (bodies or found)[0]


def difference(model: pin.Model, q0: Array, q1: Array) -> Array:
    """Tangent vector at q0 that leads to q1, as `mbocp.lie` has it in symbols.

    Pinocchio takes arccosines for the angles of continuous and planar joints, which have half the digits
    near zero.
    """
    found: Array = pin.difference(model, q0, q1)
    if model.nq == model.nv:
        return found
    if model not in _circles:  # Pinocchio's lists are slow to read
        of_all = zip(model.idx_qs.tolist(), model.idx_vs.tolist(), range(model.njoints), strict=True)
        kinds = {j: joints.joint_kind(model, j).word for j in range(1, model.njoints)}
        _circles[model] = [(at, v, kinds[j]) for at, v, j in of_all if kinds.get(j) in _ON_CIRCLES]
    a, b = q0.tolist(), q1.tolist()
    for at, v, kind in _circles[model]:
        if kind == "continuous":
            found[v] = _angle(*a[at : at + 2], *b[at : at + 2])
        else:
            c, s = a[at + 2 : at + 4]
            x, y, angle = b[at] - a[at], b[at + 1] - a[at + 1], _angle(c, s, *b[at + 2 : at + 4])
            forward, aside, half = c * x + s * y, c * y - s * x, angle / 2.0
            share = half / math.tan(half) if half else 1.0
            found[v : v + 3] = share * forward + half * aside, share * aside - half * forward, angle
    return found


def _angle(c0: float, s0: float, c1: float, s1: float) -> float:
    """Angle from one direction to another, in (-pi, pi]."""
    return math.atan2(c0 * s1 - s0 * c1, c0 * c1 + s0 * s1)


def mass_matrix(model: pin.Model, q: Array) -> Array:
    """Full symmetric joint-space mass matrix."""
    return mass_matrices(model, q[None])[0]


def mass_matrices(model: pin.Model, qs: Array) -> Array:
    """Mass matrices at many configurations, shape (nodes, nv, nv)."""
    if len(model.mimicking_joints):
        return np.array([_mass_columns(model, q) for q in qs])
    if is_large(model):
        return np.array([composite_mass_matrix(model, q) for q in qs])
    data, found = make_working_data(model), np.empty((len(qs), model.nv, model.nv))
    for node, q in enumerate(qs):
        found[node] = pin.crba(model, data, q)
    rows, columns = _places_below_diagonal(model.nv)
    found[:, rows, columns] = found[:, columns, rows]
    return found


@lru_cache(maxsize=32)
def _places_below_diagonal(size: int) -> tuple[IntArray, IntArray]:
    return np.tril_indices(size, -1)


def momenta_of(model: pin.Model, qs: Array, vs: Array) -> Array:
    """Momenta M(q) v at many configurations, shape (nodes, nv)."""
    return np.einsum("nij,nj->ni", mass_matrices(model, qs), vs)


def _mass_columns(model: pin.Model, q: Array) -> Array:
    """Mass matrix by inverse dynamics, a column at a time.

    Pinocchio's own algorithm (3.x) misses entries where a joint with several velocities is between a mimic
    joint and its leader.
    """
    data, rest = make_working_data(model), np.zeros(model.nv)
    still = pin.rnea(model, data, q, rest, rest).copy()
    columns = [pin.rnea(model, data, q, rest, unit) - still for unit in np.eye(model.nv)]
    rows = np.array(columns)
    return 0.5 * (rows + rows.T)


def compute_scaled_spectrum(mass: Array) -> tuple[Array, Array]:
    """Eigenvalues and vectors of the mass matrix scaled to a unit diagonal: free of units."""
    values, vectors = np.linalg.eigh(_scale(mass[None])[0])
    return values, vectors


def _scale(masses: Array) -> Array:
    """Mass matrices, shape (nodes, nv, nv), with rows and columns scaled to a unit diagonal."""
    diagonals = np.diagonal(masses, axis1=1, axis2=2)
    scales = 1.0 / np.sqrt(np.where(diagonals > 0, diagonals, 1.0))
    return masses * (scales[:, :, None] * scales[:, None, :])


def is_singular(mass: Array) -> bool:
    """Whether the mass matrix is singular or indefinite, whatever the units."""
    return bool(mass.size and compute_scaled_spectrum(mass)[0][0] < _MIN_EIGENVALUE)


def any_singular(masses: Array) -> bool:
    """Whether any of many mass matrices, shape (nodes, nv, nv), is singular, indefinite or not finite."""
    if not masses.size:
        return False
    if not np.isfinite(masses).all():
        return True
    return bool(np.linalg.eigvalsh(_scale(masses))[:, 0].min() < _MIN_EIGENVALUE)


def velocity_from_momentum(mass: Array, jacobian: Array, p: Array) -> Array:
    """Solve M v = p; with a singular M, the least-squares solution with G v = 0."""
    if not is_singular(mass):
        return np.asarray(np.linalg.solve(mass, p), dtype=np.float64)
    nc, nv = jacobian.shape
    kkt = np.block([[mass, jacobian.T], [jacobian, np.zeros((nc, nc))]])
    return np.linalg.lstsq(kkt, np.concatenate([p, np.zeros(nc)]), rcond=None)[0][:nv]


def frame_jacobian(model: pin.Model, q: Array, frame: int, reference: pin.ReferenceFrame) -> Array:
    """Jacobian of one frame, shape (6, nv), linear before angular."""
    return frame_jacobians(model, q[None], frame, reference)[0]


def frame_jacobians(model: pin.Model, qs: Array, frame: int, reference: pin.ReferenceFrame) -> Array:
    """Jacobian of one frame at many configurations, shape (nodes, 6, nv)."""
    data, found = make_working_data(model), np.empty((len(qs), 6, model.nv))
    for node, q in enumerate(qs):
        jacobian = pin.computeFrameJacobian(model, data, q, frame, reference)
        found[node] = jacobian.reshape(6, model.nv)  # Pinocchio hands out a single column as a vector
    return found


def frame_poses(model: pin.Model, qs: Array, frames: Sequence[int]) -> Array:
    """Poses of frames in the world along a motion, shape (frames, n, 7): position [m], quaternion xyzw."""
    data, found = make_working_data(model), np.empty((len(frames), len(qs), 7))
    for node, q in enumerate(qs):
        pin.framesForwardKinematics(model, data, q)
        for k, frame in enumerate(frames):
            found[k, node] = pin.SE3ToXYZQUAT(data.oMf[frame])
    return found


def turns(model: pin.Model) -> Array:
    """Angle [rad] by unit of each joint velocity, shape (nv,)."""
    data, found = model.createData(), np.zeros(model.nv)
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for index, joint in list(enumerate(model.joints))[1:]:
        if joint.nv and joint.shortname() != "JointModelMimic":
            at = slice(joint.idx_v, joint.idx_v + joint.nv)
            jacobian = pin.getJointJacobian(model, data, index, pin.ReferenceFrame.LOCAL)
            found[at] = np.linalg.norm(jacobian.reshape(6, model.nv)[3:, at], axis=0)  # (6,) where nv is 1
    return found


def distances(model: pin.Model, q: Array, pairs: Sequence[Connector | QuarticSpring | SpringDamper]) -> Array:
    """p_a - p_b of each pair in world axes, shape (n, 3) [m]."""
    if not pairs:  # no working data, which take 50 ms of a robot of 100 joints
        return np.zeros((0, 3))
    data = make_working_data(model)
    pin.framesForwardKinematics(model, data, q)
    out = np.zeros((len(pairs), 3))
    for row, pair in enumerate(pairs):
        out[row] = data.oMf[pair.frame_a].translation - data.oMf[pair.frame_b].translation
    return out


def gravity_potential(model: pin.Model, q: Array) -> float:
    """Potential energy of gravity, zero at the origin of the world [J].

    By hand, because Pinocchio's own function refuses mimic joints.
    """
    data = make_working_data(model)
    pin.forwardKinematics(model, data, q)
    bodies = zip(list(model.inertias)[1:], list(data.oMi)[1:], strict=True)
    moment = sum((body.mass * placement.act(body.lever) for body, placement in bodies), start=np.zeros(3))
    return -float(model.gravity.linear @ moment)


def force_potential(model: pin.Model, q: Array, forces: Sequence[QuarticSpring | SpringDamper]) -> float:
    """Potential energy of the springs [J]."""
    return sum(
        (_potential(force, d) for force, d in zip(forces, distances(model, q, forces), strict=True)),
        start=0.0,
    )


def force_elements(
    model: pin.Model, q: Array, v: Array, forces: Sequence[QuarticSpring | SpringDamper]
) -> Array:
    """Generalised force of springs and dampers, shape (nv,)."""
    total = np.zeros(model.nv)
    for force, d in zip(forces, distances(model, q, forces), strict=True):
        a, b = (frame_jacobian(model, q, k, pin.LOCAL_WORLD_ALIGNED) for k in (force.frame_a, force.frame_b))
        dd_dq = a[:3] - b[:3]
        total += dd_dq.T @ _force_on_a(force, d, dd_dq @ v)
    return total


def _potential(force: QuarticSpring | SpringDamper, d: Array) -> float:
    square = float(d @ d)
    if isinstance(force, QuarticSpring):
        return 0.25 * force.coefficient * (square - force.length**2) ** 2
    return 0.5 * force.stiffness * (math.sqrt(square) - force.length) ** 2


def _force_on_a(force: QuarticSpring | SpringDamper, d: Array, d_rate: Array) -> Array:
    """Force on frame a in world axes; frame b gets the opposite."""
    out: Array
    if isinstance(force, QuarticSpring):
        out = -force.coefficient * (d @ d - force.length**2) * d
    elif force.length == 0.0:
        out = -force.stiffness * d - force.damping * d_rate
    else:
        distance = np.linalg.norm(d)
        axis = d / distance if distance > 0.0 else d  # ends that meet: a force without direction
        out = -(force.stiffness * (distance - force.length) + force.damping * (axis @ d_rate)) * axis
    return out


def placement_from(position: Sequence[float], orientation: Sequence[float]) -> pin.SE3:
    """Placement from a position [m] and a quaternion xyzw of any length, or roll, pitch, yaw [rad]."""
    if len(orientation) == 3:
        rotation = pin.rpy.rpyToMatrix(np.array(orientation))
    else:
        rotation = pin.Quaternion(np.array(orientation)).normalized().matrix()
    return pin.SE3(rotation, np.array(position))


def reach(model: pin.Model, joint: int, point: Array, q_lower: Array, q_upper: Array) -> tuple[Array, float]:
    """Centre, shape (3,), and radius [m] of a ball that a point of a joint's body never leaves.

    Parameters
    ----------
    model : pin.Model
    joint : int
    point : ndarray, shape (3,)
        In the frame of the joint [m].
    q_lower, q_upper : ndarray, shape (nq,)
        Limits that are kept: how far prismatic joints slide. Infinite where there are none.

    Returns
    -------
    tuple of (ndarray, float)
        The radius is infinite where a joint floats, or slides without limits.
    """
    _, *chain = model.supports[joint]
    if not chain:
        return np.array(point), 0.0
    below = length_of(model, chain[1:], q_lower, q_upper)
    radius = float(np.linalg.norm(point)) + below + _travel(model, chain[0], q_lower, q_upper)
    return np.array(model.jointPlacements[chain[0]].translation), radius


def length_of(model: pin.Model, chain: Sequence[int], q_lower: Array, q_upper: Array) -> float:
    """How far the last of some joints can be from the body that carries the first, see `reach` [m]."""
    lengths = (float(np.linalg.norm(model.jointPlacements[k].translation)) for k in chain)
    return sum(lengths) + sum(_travel(model, k, q_lower, q_upper) for k in chain)


def _travel(model: pin.Model, joint: int, q_lower: Array, q_upper: Array) -> float:
    """How far a joint moves the origin of its frame [m]."""
    word = joints.joint_kind(model, joint).word
    if word in _TURNING:
        return 0.0
    if word != "prismatic" or joint in list(model.mimicking_joints):
        return float("inf")
    where = joints.configuration_slice(model, joint)
    return float(np.max(np.abs([q_lower[where], q_upper[where]])))

r"""Rigid motions of a robot that change nothing about its equations, and their momentum maps.

A spatial twist s (about the origin of the world, linear before angular) is a symmetry if there is a field
X(q) of joint velocities that moves every body by it,

.. math:: J_i(q)\,X(q) = s \quad \text{for all bodies } i,

and if gravity, the force elements, the holonomic constraints and the actuation are invariant; the control
may turn along, :math:`u \to e^{\varepsilon\Omega} u` with a skew :math:`\Omega`, which leaves :math:`|u|^2`
as it is (Proposition 3 of [Bijalwan2025]_). Noether's theorem then gives the control momentum, eq. (15).

Only fields that the discrete step :math:`q_n = q_{n-1} \circ \exp(\Delta t\,v_n)` respects are found, for it
is they whose momentum an integrator keeps to round-off: affine in the coordinates of prismatic and revolute
joints, and :math:`\mathrm{Ad}_q^{-1}\sigma` on joints that live on a Lie group. (A ball joint made of three
hinges is symmetric, too, but Euler angles and Euler steps do not commute with rotations.) So

.. math:: X(q) = c + A\,q + \mathrm{Ad}_q^{-1}\sigma, \qquad X_v(q, v) = A\,v

generate the motion of configurations and velocities, with constants c, A and sigma that linear algebra finds.
Robots in one world that do not act on each other move one by one: "all bodies" are then those of one of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from random import Random
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, null_space
from mbocp.mechanics.symmetries.fields import Ansatz, Symmetry
from mbocp.mechanics.symmetries.spins import independent_parts, part_name
from mbocp.robot import Robot, SpringDamper
from mbocp.robot.large import make_working_data

_RANK_TOLERANCE = 1e-8  # relative, of singular values that count as zero; they come out at 1e-15 or at 1e-2
# A body with less inertia by mass has no orientation: a radius of gyration of 10 um.
_MIN_INERTIA_RATIO = 1e-10  # [m^2]
# Central difference of order 8: exact to 1e-12 for trigonometric functions at this step.
_STENCIL = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
_STEP = 0.02


@lru_cache(maxsize=64)
def find_symmetries(robot: Robot) -> tuple[Symmetry, ...]:
    """Find the rigid motions that leave the robot's equations and the cost |u|^2 invariant.

    Limits are not looked at: a bound on a coordinate that the symmetry moves breaks it where it is active.
    Found once for a robot object, which never changes.

    Returns
    -------
    symmetries : tuple of Symmetry
        A basis for each part that nothing joins to others: first translations, then rotations, along the
        axes of the world where possible.
    """
    parts = independent_parts(robot)
    found = [(joints, symmetry) for joints in parts for symmetry in _symmetries_of(robot, joints)]
    if len(parts) == 1:
        return tuple(symmetry for _, symmetry in found)
    return tuple(replace(s, name=f"{s.name} of {part_name(robot, joints)}") for joints, s in found)


def _symmetries_of(robot: Robot, joints: frozenset[int]) -> tuple[Symmetry, ...]:
    """Symmetries of the bodies on some joints, which nothing joins to others."""
    ansatz = Ansatz(robot, _support(robot, joints), joints)
    if ansatz.size == 0:
        return ()
    rows = list(ansatz.static_rows())
    for q in _random_configurations(robot, ansatz.size + 8):
        rows += _motion_rows(robot, q, ansatz.features(q), joints)
    basis = _drop_idle_twists(null_space(np.vstack(rows), _RANK_TOLERANCE))
    basis, omegas = _with_actuation(robot, ansatz, basis)
    return tuple(
        ansatz.symmetry(name, basis @ weights, np.tensordot(weights, omegas, 1))
        for name, weights in _name_basis(basis[-6:])
    )


def momentum_map(symmetry: Symmetry, qs: Array, vs: Array, costates: Array) -> Array:
    r"""Control momentum of a symmetry, eq. (15), in the form that the discrete equations conserve.

    By Noether's theorem :math:`J_n = \partial_{x_n} S_{n+1} \cdot (X, X_v)(x_n)`, where :math:`S_{n+1}` is
    the part of the Lagrangian, eq. (22), that belongs to the step from n to n + 1: along the symmetry it does
    not change, so what it gains at its start it loses at its end, and there stationarity in x makes that the
    gain of the next step. No scheme enters but through its boundary duals. For a constant mass matrix and
    prismatic joints J is :math:`n \cdot (q \times \mu^q + p \times \mu^p)`.

    Parameters
    ----------
    qs : ndarray, shape (N + 1, nq)
        Configurations [m, rad, quaternion xyzw].
    vs : ndarray, shape (N + 1, nv)
        Velocities [m/s, rad/s].
    costates : ndarray, shape (N + 1, 2 nv)
        Derivatives of the Lagrangian of what follows each node (for the last one: of terminal cost and end
        condition) in the tangent space of (q_n, v_n).

    Returns
    -------
    momentum : ndarray, shape (N + 1,)
    """
    fields = np.hstack([symmetry.generator(qs), symmetry.velocity_generator(vs)])
    return np.einsum("ni,ni->n", costates, fields)


def _random_configurations(robot: Robot, count: int) -> Iterator[Array]:
    rng = Random(20250521)  # any seed: what holds at random configurations holds everywhere
    for _ in range(count):
        step = np.array([rng.uniform(-1.2, 1.2) for _ in range(robot.nv)])
        yield pin.integrate(robot.model, pin.neutral(robot.model), step)


def _body_rows(robot: Robot, q: Array, features: Array, joints: frozenset[int]) -> Iterator[Array]:
    """Rows of J_i X - s = 0 in the coordinates of each body with mass or inertia; X = features @ theta."""
    model = robot.model
    data = make_working_data(model)
    pin.computeJointJacobians(model, data, q)
    for joint in sorted(joints):
        inertia = model.inertias[joint]
        values, axes = np.linalg.eigh(inertia.inertia)
        turning = axes[:, np.abs(values) > _MIN_INERTIA_RATIO * inertia.mass]  # none of a point mass
        if inertia.mass <= 0.0 and turning.shape[1] == 0:
            continue
        jacobian = pin.getJointJacobian(model, data, joint, pin.LOCAL).reshape(6, model.nv)
        excess = np.hstack([jacobian @ features, -data.oMi[joint].toActionMatrixInverse()])
        if inertia.mass > 0.0:  # of a rotor without mass it does not matter where it is
            yield excess[:3] - pin.skew(inertia.lever) @ excess[3:]  # the centre of mass
        yield turning.T @ excess[3:]


def _motion_rows(robot: Robot, q: Array, features: Array, joints: frozenset[int]) -> list[Array]:
    """Conditions on (theta, s) at q: bodies move rigidly, force elements and constraints do not notice."""
    rows = list(_body_rows(robot, q, features, joints))
    model, data = robot.model, make_working_data(robot.model)
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    rows.append(np.hstack([robot.closure_jacobian(q) @ features, np.zeros((len(robot.closure_labels), 6))]))
    for element in robot.forces:
        a, b = element.frame_a, element.frame_b
        if not joints & {model.frames[frame].parentJoint for frame in (a, b)}:
            continue
        d = data.oMf[a].translation - data.oMf[b].translation
        rate = (_point_jacobian(robot, data, a) - _point_jacobian(robot, data, b)) @ features
        # How d moves beyond turning with the whole: s_ang x d = -skew(d) s_ang.
        excess = np.hstack([rate, np.zeros((3, 3)), pin.skew(d)])
        # Only a damper feels more than the distance.
        rows.append(excess if isinstance(element, SpringDamper) else d[None] @ excess)
    for joint in robot.elastic:  # a joint and its motor move alike
        link, motor = joint.at_v
        rows.append(np.append(features[motor] - features[link], np.zeros(6))[None])
    return rows


def _point_jacobian(robot: Robot, data: Any, frame: int) -> Array:
    if robot.model.frames[frame].parentJoint == 0:
        return np.zeros((3, robot.nv))
    whole = pin.getFrameJacobian(robot.model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    return whole.reshape(6, robot.nv)[:3]


def _support(robot: Robot, joints: frozenset[int]) -> Any:
    """Velocity components that can take part in a rigid motion of all bodies, at some configuration."""
    eye, moving = np.eye(robot.nv), np.zeros(robot.nv, dtype=bool)
    for q in _random_configurations(robot, 3):
        rows = [np.zeros((0, robot.nv + 6)), *_body_rows(robot, q, eye, joints)]
        null = null_space(np.vstack(rows), _RANK_TOLERANCE)
        # Massless joints move nothing: only what goes along with a twist s counts.
        null = null @ np.linalg.pinv(null[-6:], rcond=_RANK_TOLERANCE)
        moving |= np.abs(null[:-6]).max(axis=1, initial=0.0) > _RANK_TOLERANCE
    for elastic in robot.elastic:  # its motor has no body, and goes along
        link, motor = elastic.at_v
        moving[motor] |= moving[link]
    own = np.zeros(robot.nv, dtype=bool)
    for joint in joints:
        entry = robot.model.joints[joint]
        own[entry.idx_v : entry.idx_v + entry.nv] = True
    return moving & own


def _drop_idle_twists(basis: Array) -> Array:
    """Without the twists that move no coordinate: those of a rotor without mass go anywhere."""
    if basis.shape[1] == 0:
        return basis
    _, singular, combinations = np.linalg.svd(basis[:-6], full_matrices=True)
    count = int(np.sum(singular > _RANK_TOLERANCE))
    return basis if count == basis.shape[1] else basis @ combinations[:count].T


def _with_actuation(robot: Robot, ansatz: Ansatz, basis: Array) -> tuple[Array, Array]:
    r"""Keep the combinations for which an Omega exists: :math:`DB[X] + A^T B + B \Omega = 0` everywhere.

    Returns
    -------
    basis : ndarray, shape (size + 6, k)
    omegas : ndarray, shape (k, nu, nu)
    """
    change, matrix = _actuation_changes(robot, ansatz, basis)
    nu, count = robot.nu, basis.shape[1]
    # A control whose column does not change stays as it is (the columns of B are independent).
    turning = np.flatnonzero((np.abs(change) > _RANK_TOLERANCE).any(axis=(0, 1)))
    if not len(turning):
        return basis, np.zeros((count, nu, nu))
    pairs = [(i, j) for i in turning for j in turning if i < j]
    columns = [c.ravel() for c in change]
    for i, j in pairs:  # B Omega with Omega_ij = 1, Omega_ji = -1
        product = np.zeros_like(matrix)
        product[:, j], product[:, i] = matrix[:, i], -matrix[:, j]
        columns.append(product.ravel())
    null = null_space(np.array(columns).T, _RANK_TOLERANCE)
    # Combinations of the basis that are attainable, each with its smallest Omega.
    u, singular, _ = np.linalg.svd(null[:count], full_matrices=False)
    attainable = u[:, singular > _RANK_TOLERANCE]
    solutions = null @ np.linalg.pinv(null[:count], rcond=_RANK_TOLERANCE) @ attainable
    omegas = np.zeros((attainable.shape[1], nu, nu))
    for (i, j), values in zip(pairs, solutions[count:], strict=True):
        omegas[:, i, j], omegas[:, j, i] = values, -values
    return basis @ attainable, omegas


def _actuation_changes(robot: Robot, ansatz: Ansatz, basis: Array) -> tuple[Array, Array]:
    """Return DB[X] + A^T B for each field, and B, at several configurations one below the other.

    Returns
    -------
    changes : ndarray, shape (k, rows, nu)
    matrix : ndarray, shape (rows, nu)
        Both scaled such that the largest entry of the matrix is one.
    """
    changes, matrices = [], []
    for q in _random_configurations(robot, 4):
        directions, matrix = ansatz.features(q) @ basis[:-6], robot.actuation_matrix(q)
        rates = [
            _actuation_rate(robot, q, direction) + ansatz.linear(theta).T @ matrix
            for direction, theta in zip(directions.T, basis[:-6].T, strict=True)
        ]
        matrices.append(matrix)
        changes.append(np.array(rates).reshape(basis.shape[1], robot.nv, robot.nu))
    stacked = np.concatenate(matrices)
    scale = float(np.abs(stacked).max(initial=0.0)) or 1.0
    return np.concatenate(changes, axis=1) / scale, stacked / scale


def _actuation_rate(robot: Robot, q: Array, direction: Array) -> Array:
    """Derivative of B along a tangent direction, shape (nv, nu)."""
    out = np.zeros((robot.nv, robot.nu))
    if robot.actuation.is_constant:
        return out
    for k, weight in _STENCIL.items():
        ahead, behind = (pin.integrate(robot.model, q, sign * k * _STEP * direction) for sign in (1, -1))
        out += weight / _STEP * (robot.actuation_matrix(ahead) - robot.actuation_matrix(behind))
    return out


def _name_basis(twists: Array) -> Iterator[tuple[str, Array]]:
    """Combinations of the columns of `twists` (6, k) that a person would choose, with names."""
    pure = null_space(twists[3:], _RANK_TOLERANCE) if twists.shape[1] else twists[:0].T
    for axis in _axes(twists[:3] @ pure):
        yield (
            f"translation along {_direction(axis)}",
            pure @ np.linalg.pinv(twists[:3] @ pure, _RANK_TOLERANCE) @ axis,
        )
    for axis in _axes(twists[3:]):
        weights = np.linalg.pinv(twists[3:], _RANK_TOLERANCE) @ axis
        if pure.shape[1]:  # through the origin, or as near to it as the other symmetries allow
            weights -= pure @ np.linalg.pinv(twists[:3] @ pure, _RANK_TOLERANCE) @ (twists[:3] @ weights)
        linear = twists[:3] @ weights
        point, pitch = np.cross(axis, linear), axis @ linear
        name = "screw" if abs(pitch) > _RANK_TOLERANCE else "rotation"
        through = f" through {_direction(point, words=False)}" if np.linalg.norm(point) > 1e-6 else ""
        yield f"{name} about {_direction(axis)}{through}", weights


def _axes(vectors: Array) -> list[Array]:
    """Orthonormal basis of the span of 3-vectors (in columns): axes of the world first."""
    u, singular, _ = (
        np.linalg.svd(vectors, full_matrices=False) if vectors.size else (np.zeros((3, 0)), np.zeros(0), 0)
    )
    span = u[:, singular > _RANK_TOLERANCE]
    chosen = [e for e in np.eye(3) if np.linalg.norm(span @ (span.T @ e) - e) < 1e-7]
    rest = span
    for e in chosen:
        rest = rest - np.outer(e, e @ rest)
    u, singular, _ = np.linalg.svd(rest, full_matrices=False) if rest.size else (rest, np.zeros(0), 0)
    others = u[:, singular > 1e-6].T
    return chosen + [a * np.sign(a[np.argmax(np.abs(a))]) for a in others]


def _direction(vector: Array, *, words: bool = True) -> str:
    if words:
        for letter, e in zip("xyz", np.eye(3), strict=True):
            if np.allclose(vector, e, atol=1e-9):
                return letter
    return "(" + ", ".join(f"{x:.3g}" for x in np.where(np.abs(vector) < 1e-9, 0.0, vector)) + ")"

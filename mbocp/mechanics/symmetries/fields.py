r"""Fields of joint velocities that generate symmetries, and the linear space in which they are looked for.

.. math:: X(q) = c + A\,q + \mathrm{Ad}_q^{-1}\sigma, \qquad X_v(q, v) = A\,v

See `mbocp.mechanics.symmetries.finding` for why these and no others.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.robot import Robot

_LIE_JOINTS = {"JointModelFreeFlyer": 6, "JointModelSpherical": 3, "JointModelPlanar": 3}
_ROUND_OFF = 1e-12  # relative; coefficients come out at 1e-15 or are of order one


@dataclass(frozen=True, eq=False)
class LieBlock:
    """A joint on a Lie group that takes part: :math:`X_j = Ad_{q_j}^{-1} sigma`.

    Attributes
    ----------
    kind : str
        Pinocchio's name of the joint's type.
    idx_q, idx_v : int
        Where it starts in q and v.
    sigma : ndarray, shape (6,), (3,) or (3,)
        Spatial twist in the joint's fixed frame: free-flyer (linear, angular), spherical (angular), planar
        (x, y, w).
    """

    kind: str
    idx_q: int
    idx_v: int
    sigma: Array

    def generator(self, qs: Array) -> Array:
        """Ad_q^{-1} sigma in body coordinates, shape (n, 6 or 3)."""
        return _lie_map(self.kind, qs[:, self.idx_q : self.idx_q + 7]) @ self.sigma


@dataclass(frozen=True, eq=False)
class Symmetry:
    r"""One symmetry of a robot.

    Attributes
    ----------
    name : str
        For people: "rotation about z", "translation along x".
    twist : ndarray, shape (6,)
        Spatial twist s of all bodies about the origin of the world, linear before angular.
    constant : ndarray, shape (nv,)
        c of X(q).
    linear : ndarray, shape (nv, nv)
        A of X(q); its columns meet the coordinates of joints whose configuration is a plain vector.
    blocks : tuple of LieBlock
        Joints on a Lie group that take part.
    control : ndarray, shape (nu, nu)
        Omega, skew; zero where the control does not turn along.
    coordinates : ndarray of int, shape (nv,)
        Where in q the plain coordinate of each v is; -1 where there is none.
    joints : frozenset of int
        Those that move the bodies that it moves: all but in a world of several robots.
    """

    name: str
    twist: Array
    constant: Array
    linear: Array
    blocks: tuple[LieBlock, ...]
    control: Array
    coordinates: Any
    joints: frozenset[int]

    def generator(self, qs: Array) -> Array:
        """X(q) for each row of `qs`, in the robot's tangent coordinates, shape (n, nv)."""
        out = self.vector_generator(qs)
        for block in self.blocks:
            out[:, block.idx_v : block.idx_v + len(block.sigma)] = block.generator(qs)
        return out

    def vector_generator(self, qs: Array) -> Array:
        """The part c + A q of X(q), shape (n, nv)."""
        plain = np.flatnonzero(self.coordinates >= 0)
        return self.constant + qs[:, self.coordinates[plain]] @ self.linear[:, plain].T

    def velocity_generator(self, vs: Array) -> Array:
        """Generator X_v = A v of velocities, shape (n, nv); zero where they are body-fixed."""
        return vs @ self.linear.T

    def touches(self, tracked: Any) -> bool:
        """Whether it moves one of the `tracked` components of (q, p), a mask of shape (2 nv,).

        Both in tangent coordinates; momenta move by -A^T p.
        """
        nv = len(self.constant)
        moved = (self.constant != 0) | (self.linear != 0).any(axis=1)
        for block in self.blocks:
            moved[block.idx_v : block.idx_v + len(block.sigma)] = True
        mask = np.asarray(tracked, dtype=bool)
        return bool((moved & mask[:nv]).any() or ((self.linear != 0).any(axis=0) & mask[nv:]).any())


class Ansatz:
    """X(q) = features(q) @ theta: constants, a matrix on plain coordinates, a twist for each Lie joint."""

    def __init__(self, robot: Robot, support: Any, joints: frozenset[int]) -> None:
        self.robot, self.joints = robot, joints
        self.coordinates = np.full(robot.nv, -1)
        self.lie: list[tuple[str, int, int]] = []
        constants = []
        for joint in list(robot.model.joints)[1:]:
            taking_part = support[joint.idx_v : joint.idx_v + joint.nv].any() if joint.nv else False
            if joint.shortname() in _LIE_JOINTS:
                if taking_part:
                    self.lie.append((joint.shortname(), joint.idx_q, joint.idx_v))
                continue
            if joint.nq == joint.nv:
                self.coordinates[joint.idx_v : joint.idx_v + joint.nv] = joint.idx_q + np.arange(joint.nv)
            constants += [i for i in range(joint.idx_v, joint.idx_v + joint.nv) if support[i]]
        self.constants = np.array(constants, dtype=int)
        self.plain = self.constants[self.coordinates[self.constants] >= 0]
        self.num_linear = len(self.plain) ** 2
        self.size = len(self.constants) + self.num_linear + sum(_LIE_JOINTS[kind] for kind, *_ in self.lie)

    def features(self, q: Array) -> Array:
        """Shape (nv, size)."""
        nv = self.robot.nv
        affine = np.zeros((nv, len(self.constants) + self.num_linear))
        affine[self.constants, np.arange(len(self.constants))] = 1.0
        plain_q = q[self.coordinates[self.plain]]
        for k, i in enumerate(self.plain):
            start = len(self.constants) + k * len(self.plain)
            affine[i, start : start + len(self.plain)] = plain_q
        blocks = [affine]
        for kind, idx_q, idx_v in self.lie:
            block = np.zeros((nv, _LIE_JOINTS[kind]))
            block[idx_v : idx_v + len(block.T)] = _lie_map(kind, q[None, idx_q : idx_q + 7])[0]
            blocks.append(block)
        return np.hstack(blocks)

    def linear(self, theta: Array) -> Array:
        """Matrix A, shape (nv, nv)."""
        out = np.zeros((self.robot.nv, self.robot.nv))
        start, n = len(self.constants), len(self.plain)
        out[np.ix_(self.plain, self.plain)] = theta[start : start + n * n].reshape(n, n)
        return out

    def static_rows(self) -> Iterator[Array]:
        """Conditions that do not depend on q: rotations about gravity, rotors and losses that turn along."""
        gravity = np.asarray(self.robot.model.gravity.linear)
        size = np.linalg.norm(gravity)
        if size > 0.0:
            yield np.hstack([np.zeros((3, self.size + 3)), pin.skew(gravity / size)])
        damping, friction = self._losses()
        for diagonal in (np.asarray(self.robot.model.armature), damping):
            if self.num_linear and diagonal[self.plain].any():
                # d/de of v^T D v / 2 along A v: A^T D + D A = 0.
                scaled = np.diag(diagonal / diagonal.max())
                unit = np.eye(self.size)
                columns = [(self.linear(e).T @ scaled + scaled @ self.linear(e)).ravel() for e in unit]
                yield np.hstack([np.array(columns).T, np.zeros((self.robot.nv**2, 6))])
        if self.num_linear and friction[self.plain].any():  # tanh of one velocity, which none may mix with
            columns = [
                np.vstack([A[friction], A.T[friction]]).ravel() for A in map(self.linear, np.eye(self.size))
            ]
            yield np.hstack([np.array(columns).T, np.zeros((2 * int(friction.sum()) * self.robot.nv, 6))])

    def _losses(self) -> tuple[Array, Any]:
        """Damping of each velocity component, and whether friction acts on it, shape (nv,) each."""
        damping, friction = np.zeros(self.robot.nv), np.zeros(self.robot.nv, dtype=bool)
        for resistance in self.robot.resistances:
            damping[resistance.dof] += resistance.ratio**2 * resistance.damping
            friction[resistance.dof] |= resistance.friction > 0.0
        return damping, friction

    def symmetry(self, name: str, vector: Array, control: Array) -> Symmetry:
        """Take (theta, s) apart; what is round-off becomes zero."""
        vector = _without_round_off(vector)
        theta, constant = vector[:-6], np.zeros(self.robot.nv)
        constant[self.constants] = theta[: len(self.constants)]
        start, blocks = len(self.constants) + self.num_linear, []
        for kind, idx_q, idx_v in self.lie:
            sigma = theta[start : start + _LIE_JOINTS[kind]]
            start += _LIE_JOINTS[kind]
            if sigma.any():
                blocks.append(LieBlock(kind, idx_q, idx_v, frozen_array(sigma)))
        return Symmetry(
            name=name,
            twist=frozen_array(vector[-6:]),
            constant=frozen_array(constant),
            linear=frozen_array(self.linear(theta)),
            blocks=tuple(blocks),
            control=frozen_array(_without_round_off(control)),
            coordinates=self.coordinates,
            joints=self.joints,
        )


def _without_round_off(values: Array) -> Array:
    return np.where(np.abs(values) > _ROUND_OFF * np.abs(values).max(initial=0.0), values, 0.0)


def _lie_map(kind: str, qs: Array) -> Array:
    """Ad_q^{-1}, from a twist in the joint's fixed frame to the body's coordinates, shape (n, k, k)."""
    if kind == "JointModelPlanar":
        x, y, c, s = qs[:, :4].T
        zero, one = np.zeros_like(x), np.ones_like(x)
        # Linear part R^T (v + w e_z x p), with e_z x p = (-y, x).
        rows = [[c, s, s * x - c * y], [-s, c, c * x + s * y], [zero, zero, one]]
        return np.array(rows).transpose(2, 0, 1)
    attitudes = qs[:, :4] if kind == "JointModelSpherical" else qs[:, 3:7]
    rotations = np.array([pin.Quaternion(np.array(attitude)).matrix() for attitude in attitudes])
    inverse: Array = rotations.reshape(-1, 3, 3).transpose(0, 2, 1)
    if kind == "JointModelSpherical":
        return inverse
    out = np.zeros((len(qs), 6, 6))
    out[:, :3, :3] = out[:, 3:, 3:] = inverse
    out[:, :3, 3:] = inverse @ np.array([-pin.skew(p) for p in qs[:, :3]])  # w x p = -skew(p) w
    return out

"""Motions of obstacles that are known beforehand: pieces along which they move and turn at a steady rate.

Before the first piece and after the last one they stand still.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp._text import show
from mbocp.exceptions import InvalidValue

PIECE = 21  # numbers of a piece: begin, length, position, axes by columns, velocity, axis, rate
_FOR_EVER = 1e9  # [s]
_LARGEST = 1e6  # [m, m/s, rad/s]
_LEAST_RATE = 1e-12  # [rad/s] slower ones have no axis


@dataclass(frozen=True, kw_only=True, eq=False)
class ObstacleMotion:
    """Poses in the world, by the time, of a frame that carries shapes.

    Attributes
    ----------
    times : ndarray, shape (K,)
        At which pieces begin [s].
    lengths : ndarray, shape (K,)
        [s].
    positions : ndarray, shape (K, 3)
        At these times [m].
    orientations : ndarray, shape (K, 4)
        Quaternions xyzw, likewise.
    velocities, turning : ndarray, shapes (K, 3)
        Along the pieces, in the axes of the world [m/s, rad/s].
    table : dict
        Keys and values as in a problem file.
    """

    times: Array
    lengths: Array
    positions: Array
    orientations: Array
    velocities: Array
    turning: Array
    table: dict[str, Any] = field(default_factory=dict)

    @classmethod
    def steady(
        cls, origin: Array, velocity: Array, turning: Array, during: Sequence[float] | None = None
    ) -> ObstacleMotion:
        """At a steady rate from a point with the axes of the world, for ever or for some time [s]."""
        velocity, turning = _numbers("velocity", velocity, (3,)), _numbers("angular_velocity", turning, (3,))
        begin, end = (0.0, _FOR_EVER) if during is None else during
        if not -_FOR_EVER <= begin < end <= _FOR_EVER:
            raise InvalidValue("during", show(list(during or ())), "two times, the later one last [s]")
        table: dict[str, Any] = {"velocity": velocity.tolist()}
        if turning.any():
            table |= {"angular_velocity": turning.tolist(), "about": np.asarray(origin).tolist()}
        if during is not None:
            table["during"] = [begin, end]
        return cls(
            times=np.array([begin]),
            lengths=np.array([end - begin]),
            positions=_numbers("about", origin, (3,))[None],
            orientations=np.array([[0.0, 0.0, 0.0, 1.0]]),
            velocities=velocity[None],
            turning=turning[None],
            table=table,
        )

    @classmethod
    def through(cls, times: Array, positions: Array, orientations: Array) -> ObstacleMotion:
        """Through poses at some times, on lines and by the shorter rotation."""
        times = np.asarray(times, dtype=np.float64)
        if times.ndim != 1 or len(times) < 2 or not (np.diff(times) > 0.0).all():
            raise InvalidValue(
                "times", show(times.tolist()), "two or more, each later than the one before [s]"
            )
        _numbers("times", times, times.shape, _FOR_EVER)
        positions = _numbers("positions", positions, (len(times), 3))
        orientations = _numbers("orientations", orientations, (len(times), 4))
        norms = np.linalg.norm(orientations, axis=1)
        if not (norms > 1e-8).all():
            raise InvalidValue("orientations", show(orientations[norms.argmin()].tolist()), "a rotation")
        orientations = orientations / norms[:, None]
        lengths = np.diff(times)
        axes = [pin.Quaternion(q).matrix() for q in orientations]
        turns = [pin.log3(b @ a.T) for a, b in pairwise(axes)]
        return cls(
            times=times[:-1],
            lengths=lengths,
            positions=positions[:-1],
            orientations=orientations[:-1],
            velocities=np.diff(positions, axis=0) / lengths[:, None],
            turning=np.array(turns) / lengths[:, None],
            table={"times": times, "positions": positions, "orientations": orientations},
        )

    @property
    def is_steady(self) -> bool:
        """Whether shapes that it carries are placed in the world, where they are when it begins."""
        return "velocity" in self.table

    @property
    def key(self) -> bytes:
        """The same for motions that are the same."""
        steady = self.positions, self.orientations, self.velocities, self.turning
        return np.column_stack([self.times, self.lengths, *steady]).tobytes()

    def poses(self, ts: Array) -> Array:
        """Positions and quaternions xyzw at some times, shape (n, 7)."""
        ts = np.asarray(ts, dtype=np.float64)
        k = np.clip(np.searchsorted(self.times, ts, side="right") - 1, 0, len(self.times) - 1)
        passed = np.clip(ts - self.times[k], 0.0, self.lengths[k])[:, None]
        half = 0.5 * passed * self.turning[k]
        angle = np.linalg.norm(half, axis=1, keepdims=True)
        a, w = half * np.sinc(angle / np.pi), np.cos(angle)
        b, v = self.orientations[k, :3], self.orientations[k, 3:]
        turned = np.hstack([w * b + v * a + np.cross(a, b), w * v - (a * b).sum(axis=1, keepdims=True)])
        return np.hstack([self.positions[k] + passed * self.velocities[k], turned])

    def distance_from(self, point: Array) -> float:
        """How near the origin of its pose comes to a point [m]."""
        along = self.velocities * self.lengths[:, None]
        square = np.maximum((along**2).sum(axis=1), 1e-300)
        share = np.clip(((point - self.positions) * along).sum(axis=1) / square, 0.0, 1.0)
        return float(np.linalg.norm(self.positions + share[:, None] * along - point, axis=1).min())

    def numbers(self, pieces: int) -> Array:
        """Columns for `placement_of_piece`, shape (PIECE, pieces); those that are not needed never begin."""
        found = np.zeros((PIECE, pieces))
        found[0] = 2.0 * _FOR_EVER
        rates = np.linalg.norm(self.turning, axis=1)
        for n, (turning, rate) in enumerate(zip(self.turning, rates, strict=True)):
            axis = turning / rate if rate > _LEAST_RATE else np.array([0.0, 0.0, 1.0])
            rotation = pin.Quaternion(self.orientations[n]).matrix()
            axes = rotation.ravel(order="F")
            begin = [self.times[n], self.lengths[n]]
            found[:, n] = [*begin, *self.positions[n], *axes, *self.velocities[n], *axis, rate]
        return found


def placement_of_piece(t: ca.SX, piece: ca.SX) -> ca.SX:
    """Axes by columns and origin at a time, shape (12,), from the numbers of the piece at this time."""
    since, length, begin = t - piece[0], piece[1], piece[2:5]
    passed = (since > 0) * (since < length) * since + (since >= length) * length
    K, angle = ca.skew(piece[17:20]), piece[20] * passed
    turn = ca.SX.eye(3) + ca.sin(angle) * K + (1 - ca.cos(angle)) * (K @ K)
    return ca.vertcat(ca.vec(turn @ ca.reshape(piece[5:14], 3, 3)), begin + passed * piece[14:17])


def _numbers(name: str, given: Array, shape: tuple[int, ...], most: float = _LARGEST) -> Array:
    array = frozen_array(np.asarray(given, dtype=np.float64))
    if array.shape != shape or not np.all(np.abs(array) <= most):
        raise InvalidValue(name, show(array.tolist()), f"{'x'.join(map(str, shape))} numbers up to {most:g}")
    return array

"""How fast joints can be, at most, some time after a state that is known, within limits."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.bounds.intervals import Box
from mbocp.bounds.momenta import momenta_over
from mbocp.robot import Robot

_ROUNDS = 3  # each takes speeds of the round before for granted, which hold, and finds lower ones


@dataclass(frozen=True, eq=False)
class Forces:
    """What moves a tree of joints, and what holds it, by velocity component.

    Attributes
    ----------
    robot : Robot
        With momenta that are enclosed, see `mbocp.bounds.momenta`.
    lower, upper : ndarray, shape (n,)
        Limits of the controls' torques and forces, infinite where there are none [N m, N].
    damping, friction : ndarray, shape (n,)
        Of the joints [N m s/rad, N m].
    squares : ndarray, shape (n,)
        Upper bounds of the integrals of their squares, infinite where there are none [N^2 m^2 s, N^2 s].
    """

    robot: Robot
    lower: Array
    upper: Array
    damping: Array
    friction: Array
    squares: Array

    @property
    def sides(self) -> Array:
        """Both limits."""
        return np.concatenate([self.lower, self.upper])

    def impulses(self, edges: Array) -> tuple[Array, Array]:
        """Bound the integrals of the forces from the first of the edges to the others, shapes (K, n)."""
        times = edges[1:, None]
        most = np.sqrt(times * self.squares)
        low, high = (np.fmin(times * side, most) for side in (-self.lower, self.upper))
        return -low, high

    def losses(self, most: Array) -> Array:
        """Bound damping and friction at speeds that are bounded, shape (K, n)."""
        with np.errstate(invalid="ignore"):
            found: Array = np.where(self.damping == 0.0, 0.0, self.damping * most) + self.friction
        return found * (1.0 + 1e-14)


@dataclass(frozen=True, eq=False)
class Speeds:
    """Bounds of velocities after a known state, in windows of time one after the other.

    Attributes
    ----------
    edges : ndarray, shape (K + 1,)
        Begins of the windows, and the end of the last one, after the state [s].
    lower, upper : ndarray, shape (K, n)
        Of the velocities in each.
    """

    edges: Array
    lower: Array
    upper: Array

    def moves(self) -> tuple[Array, Array]:
        """How far joints get at least and at most by the end of each window, shapes (K, n)."""
        lengths = np.diff(self.edges)[:, None]
        return np.cumsum(lengths * self.lower, axis=0), np.cumsum(lengths * self.upper, axis=0)

    def tube(self, displacements: Array) -> tuple[Array, Array]:
        """Where joints are in each window at least and at most, shapes (K, n)."""
        down, up = self.moves()
        low = np.minimum.accumulate(np.vstack([np.zeros((1, len(displacements))), down]), axis=0)[1:]
        high = np.maximum.accumulate(np.vstack([np.zeros((1, len(displacements))), up]), axis=0)[1:]
        return displacements + low, displacements + high


def speeds_after(
    edges: Array,
    displacements: Array,
    v: Array,
    speeds: tuple[Array, Array],
    accelerations: tuple[Array, Array],
    forces: Forces | None,
) -> Speeds:
    """Bound velocities after a state.

    Parameters
    ----------
    edges : ndarray, shape (K + 1,)
        Of the windows of time, from 0 on [s].
    displacements, v : ndarray, shape (n,)
        The state; velocities that are not known are NaN.
    speeds, accelerations : tuple of ndarray, shape (n,)
        Lower and upper limits; infinite where there are none.
    forces : Forces or None
        With limits of torques; None: they are not looked at.
    """
    rise = edges[1:, None]
    with np.errstate(invalid="ignore"):
        low = np.fmax(speeds[0], v + rise * accelerations[0])
        high = np.fmin(speeds[1], v + rise * accelerations[1])
    found = Speeds(edges, low, high)
    if forces is None or np.isnan(v).any() or np.isnan(displacements).any():
        return found
    with np.errstate(invalid="ignore", over="ignore"):
        for _ in range(_ROUNDS):
            found = _within_forces(found, displacements, v, forces)
    return found


def _within_forces(known: Speeds, displacements: Array, v: Array, forces: Forces) -> Speeds:
    """Lower bounds of speeds by what forces can make of momenta: p' = tau - w, v = M^-1 p."""
    moment = momenta_over(forces.robot, Box.of(*known.tube(displacements)))
    velocities = Box.of(known.lower, known.upper)
    opposing, losses = moment.enclose_opposing(velocities), forces.losses(velocities.size)
    held = opposing.upper + losses, opposing.lower - losses
    lengths = np.diff(known.edges)[:, None]
    p0 = Box.of(v[None], v[None])
    if v.any():
        p0 = (momenta_over(forces.robot, Box.of(displacements[None], displacements[None])).M @ v[:, None])[
            ..., 0
        ]
    # What forces give, or what is held, so far is most or least at one of the ends of a window.
    given = [_over_windows(impulse) for impulse in forces.impulses(known.edges)]
    lost = [_over_windows(np.cumsum(lengths * rate, axis=0)) for rate in held]
    low = given[0][0] - lost[0][1] + p0.lower
    high = given[1][1] - lost[1][0] + p0.upper
    if not (np.isfinite(low) & np.isfinite(high)).any():
        return known
    M = moment.M
    own: Array = np.eye(len(v)) / np.diagonal(moment.typical, axis1=1, axis2=2)[:, :, None]
    if np.isnan(moment.typical).any():
        return known
    inverse = np.asarray(np.linalg.inv(moment.typical), dtype=np.float64)
    for C in (inverse, own):  # all joints help each other; or others only move
        known = Speeds(known.edges, *_velocities(C, M, known, low, high))
    return known


def _over_windows(ends: Array) -> tuple[Array, Array]:
    """The lesser and the larger of what is at both ends of each window; at the first it is zero."""
    begins = np.vstack([np.zeros_like(ends[:1]), ends[:-1]])
    return np.minimum(begins, ends), np.maximum(begins, ends)


def _velocities(C: Array, M: Box, known: Speeds, low: Array, high: Array) -> tuple[Array, Array]:
    """Velocities whose momenta are between bounds: v = C p - (C M - 1) v, for any matrices C."""
    rest = C @ M - np.eye(C.shape[1])
    most = _solve_fixed_point(rest.size, _product(np.abs(C), np.maximum(np.abs(low), np.abs(high))))
    known = Speeds(known.edges, np.fmax(known.lower, -most), np.fmin(known.upper, most))
    v = Box.of(known.lower, known.upper)
    with np.errstate(invalid="ignore"):
        up, down = np.where(C > 0.0, C, 0.0), np.where(C < 0.0, C, 0.0)
        least = _product(up, low) + _product(down, high)
        most = _product(up, high) + _product(down, low)
    missed = (rest @ Box(v.centre[..., None], v.radius[..., None]))[..., 0]
    slack = 1e-12 * (np.abs(C) @ np.fmin(np.fmax(np.abs(low), np.abs(high)), 1e300)[..., None])[..., 0]
    return (
        np.fmax(known.lower, least - missed.upper - slack),
        np.fmin(known.upper, most - missed.lower + slack),
    )


def _solve_fixed_point(rest: Array, given: Array) -> Array:
    """Solve x <= given + rest x for the largest x; infinite where rest is no contraction."""
    share = rest.sum(axis=2).max(axis=1)[:, None]
    with np.errstate(divide="ignore"):
        found: Array = given + _product(
            rest, np.broadcast_to(given.max(axis=1, keepdims=True), given.shape)
        ) / (np.where(share < 1.0, 1.0 - share, 0.0))
    return np.where(np.isnan(found), np.inf, found * (1.0 + 1e-12))


def _product(matrix: Array, vector: Array) -> Array:
    """Products with infinite numbers, of which zeros take nothing."""
    terms = np.where(matrix == 0.0, 0.0, matrix * vector[:, None, :])
    return terms.sum(axis=2)

"""Steps along the flow of an open chain, many at once, without compiling.

References
----------
Cox, Matthews, "Exponential time differencing for stiff systems", 2002, Eqs. (26) to (29).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.mechanics.motion_rates import accelerations
from mbocp.robot import Robot

_CHANGE = 1e-4  # [rad/s] of a speed, for the slope of accelerations
_TERMS = 15  # that have the exponential of a matrix of a norm below a half, to round-off


@dataclass(frozen=True, eq=False)
class StepFlow:
    r"""Steps along the flow of a robot, v' = L v + N(q, v, u), of which the decay L is taken exactly.

    Without decay they are those of the classical Runge-Kutta method of fourth order.

    Attributes
    ----------
    robot : Robot
    slopes : ndarray, shape (n, nv, nv)
        L, of each row [1/s].
    lengths : ndarray, shape (n, 1)
        h [s].
    whole, half : tuple of ndarray, shape (n, nv, nv)
        exp(hL), phi_1(hL), phi_2(hL) and phi_3(hL), and those of h/2.
    """

    robot: Robot
    slopes: Array
    lengths: Array
    whole: tuple[Array, ...]
    half: tuple[Array, ...]

    @classmethod
    def of(cls, robot: Robot, qs: Array, vs: Array, us: Array, lengths: Array) -> StepFlow:
        """With the slopes of accelerations at some states, row by row."""
        rest = accelerations(robot, qs, vs, us)
        changed = [accelerations(robot, qs, vs + change, us) for change in _CHANGE * np.eye(robot.nv)]
        slopes, h = (np.stack(changed, axis=-1) - rest[..., None]) / _CHANGE, lengths[..., None]
        slopes = np.where(np.isfinite(slopes), slopes, 0.0)
        return cls(robot, slopes, lengths, exponentials(h * slopes), exponentials(h / 2.0 * slopes))

    def step(self, qs: Array, vs: Array, us: Sequence[Array]) -> tuple[Array, Array]:
        """States, row by row, after a step under controls at its begin, middle and end."""
        h, (e, p1, p2, p3), (e_half, p_half, *_) = self.lengths, self.whole, self.half
        n1 = self._rest(qs, vs, us[0])
        v2 = _times(e_half, vs) + h / 2.0 * _times(p_half, n1)
        n2 = self._rest(self._move(qs, h / 2.0 * vs), v2, us[1])
        v3 = _times(e_half, vs) + h / 2.0 * _times(p_half, n2)
        n3 = self._rest(self._move(qs, h / 2.0 * v2), v3, us[1])
        v4 = _times(e_half, v2) + h / 2.0 * _times(p_half, 2.0 * n3 - n1)
        n4 = self._rest(self._move(qs, h * v3), v4, us[2])
        ends = _times(p1 - 3.0 * p2 + 4.0 * p3, n1) + _times(4.0 * p3 - p2, n4)
        after = _times(e, vs) + h * (ends + _times(2.0 * p2 - 4.0 * p3, n2 + n3))
        return self._move(qs, h / 6.0 * (vs + 2.0 * v2 + 2.0 * v3 + v4)), after

    @classmethod
    def states(
        cls,
        robot: Robot,
        begins: tuple[Array, Array],
        controls: Callable[[float], Array],
        lengths: Array,
        parts: int,
    ) -> Iterator[tuple[Array, Array]]:
        """Configurations and velocities after each of some parts of steps, row by row.

        Parameters
        ----------
        robot : Robot
        begins : tuple of ndarray, shapes (n, nq), (n, nv)
            Configurations and velocities at which steps begin.
        controls : callable
            Returns controls at a share of each step, shape (n, nu).
        lengths : ndarray, shape (n, 1)
            Of the steps [s].
        parts : int
            Of equal length.
        """
        qs, vs = begins
        flow = cls.of(robot, qs, vs, controls(0.0), lengths / parts)
        us = [controls(k / (2 * parts)) for k in range(2 * parts + 1)]
        for k in range(parts):
            qs, vs = flow.step(qs, vs, us[2 * k : 2 * k + 3])
            yield qs, vs

    def _rest(self, qs: Array, vs: Array, us: Array) -> Array:
        return accelerations(self.robot, qs, vs, us) - _times(self.slopes, vs)

    def _move(self, qs: Array, ways: Array) -> Array:
        if self.robot.is_vector_space:
            return qs + ways
        is_known = np.isfinite(np.hstack([qs, ways])).all(axis=1)  # steps that are too long overflow
        moved = np.full_like(qs, np.nan)
        for k in np.flatnonzero(is_known):
            moved[k] = self.robot.integrate(qs[k], ways[k])
        return moved


def exponentials(matrices: Array) -> tuple[Array, ...]:
    """exp, phi_1, phi_2 and phi_3 of some matrices: the first row of the exponential of a block matrix.

    By scaling and squaring; SciPy's, which is as accurate, is slow to import.
    """
    n, nv, _ = matrices.shape
    blocks = np.zeros((n, 4 * nv, 4 * nv))
    blocks[:, :nv, :nv] = matrices
    blocks += np.eye(4 * nv, k=nv)
    halvings = 1 + int(np.frexp(np.abs(blocks).sum(axis=-1).max(initial=1.0))[1])
    scaled, one = blocks / 2.0**halvings, np.eye(4 * nv)
    found = one + scaled / _TERMS
    for k in range(_TERMS - 1, 0, -1):
        found = one + scaled @ found / k
    for _ in range(halvings):
        found = found @ found
    return tuple(np.split(found[:, :nv], 4, axis=-1))


def _times(matrices: Array, vectors: Array) -> Array:
    return np.einsum("nij,nj->ni", matrices, vectors)

"""Which rows of an end condition the controls can act upon, independently of each other.

Some systems meet a condition by themselves: a symmetric top without a torque about its axis keeps its spin.
Such a row repeats the dynamics; with it the constraints of a problem are linearly dependent (no LICQ), and
interior-point solvers crawl. The derivative of all rows in all controls shows them, at a motion with nothing
special about it: one with random controls.

Where dynamics amplify (a light pendulum that is driven hard), all derivatives point one way up to round-off,
and rows look dependent that are not. What the dynamics imply they imply for every motion and any controls:
weaker ones, and the last of them, have to show the same.
"""

from __future__ import annotations

from dataclasses import field
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import OverdeterminedGoal
from mbocp.programme import StagewiseProgramme
from mbocp.programme.kernel import kernel_programme

_RANK_TOLERANCE = 1e-9  # relative to the largest derivative: far above round-off, far below a real one
_MET = 1e-6  # violation of a row that nothing acts upon beyond which the goal is out of reach
# Of the random controls, relative to their bounds or to one: all that lead to a tame motion.
_AMPLITUDES = (0.3, 0.03, 0.003)
_SHARES = (1.0, 0.25, 0.06)  # of the controls that are looked at: all, and the last of them
_WILD = 1e12  # states of a motion that explodes, relative to the start or to one
_SWEEP_TOLERANCE, _SWEEP_ITERATIONS = 1e-10, 50


@dataclass(frozen=True)
class _Case:
    """A programme, compared by all that the answer depends on; a goal's numbers are not among it."""

    identity: tuple[object, ...]
    programme: StagewiseProgramme = field(compare=False)

    @classmethod
    def of(cls, programme: StagewiseProgramme, rows: Array) -> _Case:
        identity = (
            programme.functions.identity,
            programme.end_functions.identity,
            programme.num_steps,
            programme.dt,
            np.round(programme.x_start, 9).tobytes(),
            np.round(rows, 9).tobytes(),
        )
        return cls(identity, programme)


def dependent_end_rows(programme: StagewiseProgramme, rows: Array) -> tuple[int, ...]:
    """Rows of the end condition that the others and the dynamics imply.

    Parameters
    ----------
    programme : StagewiseProgramme
    rows : ndarray, shape (ng, k)
        Projections of the end condition; a case that was seen is not looked at again.

    Raises
    ------
    OverdeterminedGoal
        If no control acts upon a row that is not met.
    """
    if programme.ng == 0:
        return ()
    found = _examine(_Case.of(programme, rows))
    if found.untouched:
        values = programme.end_functions.function("terminal_values")
        missed = np.asarray(values(found.x_end, programme.rho_terminal)[1]).ravel()
        for row in found.untouched:
            if abs(missed[row]) > _MET:
                raise OverdeterminedGoal(
                    f"goal: no control acts upon {programme.describe_row(-1, row)}, which is not met by "
                    "itself; change the goal or the start there, or leave it out"
                )
    return found.dependent


class _Found(NamedTuple):
    dependent: tuple[int, ...]
    untouched: tuple[int, ...]  # those of them that no control acts upon at all
    x_end: Array  # state at the end of the motion that was looked at


@lru_cache(maxsize=256)
def _examine(case: _Case) -> _Found:
    programme = case.programme
    dependent, untouched = set(range(programme.ng)), set(range(programme.ng))
    x_end: Array | None = None
    for amplitude in _AMPLITUDES:
        found = _derivative(programme, amplitude)
        if found is None:
            continue
        derivative, x_end = found
        for share in _SHARES:  # the last controls are not amplified yet
            late = derivative[:, -max(programme.ng, round(share * derivative.shape[1])) :]
            implied, idle = _find_implied(late)
            dependent, untouched = dependent & implied, untouched & idle
        if not dependent:
            break
    if x_end is None:
        return _Found((), (), programme.x_start)
    return _Found(tuple(sorted(dependent)), tuple(sorted(untouched)), x_end)


def _find_implied(derivative: Array) -> tuple[set[int], set[int]]:
    """Rows that those before them imply, and those of them that are zero."""
    largest = np.abs(derivative).max(initial=0.0)
    chosen: list[int] = []
    basis = np.zeros((0, derivative.shape[1]))
    for row, slope in enumerate(derivative):
        left = slope - basis.T @ (basis @ slope)
        left = left - basis.T @ (basis @ left)  # twice is enough
        norm = float(np.linalg.norm(left))
        if norm > _RANK_TOLERANCE * largest * np.sqrt(slope.size):
            chosen.append(row)
            basis = np.vstack([basis, left / norm])
    dependent = {row for row in range(len(derivative)) if row not in chosen}
    return dependent, {r for r in dependent if np.abs(derivative[r]).max() <= _RANK_TOLERANCE * largest}


def _derivative(programme: StagewiseProgramme, amplitude: float) -> tuple[Array, Array] | None:
    """Of the end condition in all controls, at a random motion, and its last state; None if it explodes.

    Explicit schemes explode where a joint turns by too much in a step, and closed loops are torn open; large
    numbers then hide what a control acts upon.
    """
    native = kernel_programme(programme, sweeps=True)
    native.u = _random_controls(programme, amplitude)
    xs = np.zeros((programme.num_steps + 1, programme.x_start.size))
    xs[0] = programme.x_start
    native.x = xs.ravel()
    if not native.simulate(_SWEEP_TOLERANCE, _SWEEP_ITERATIONS).ok:
        return None
    size = max(1.0, float(np.abs(programme.x_start).max(initial=0.0)))
    if not np.abs(native.x).max() <= _WILD * size:  # NaN, too
        return None
    native.evaluate()
    native.gradient()
    derivative = native.end_sensitivity().reshape(programme.ng, -1)
    if not np.isfinite(derivative).all():
        return None
    return derivative, np.array(native.x.reshape(xs.shape)[-1])


def _random_controls(programme: StagewiseProgramme, amplitude: float) -> Array:
    bounds = programme.bounds
    reach = np.minimum(np.minimum(np.abs(bounds.u_lower), np.abs(bounds.u_upper)), 1.0)
    rng = np.random.default_rng(1)
    controls: Array = amplitude * reach * rng.uniform(-1.0, 1.0, reach.shape)
    return controls.ravel()

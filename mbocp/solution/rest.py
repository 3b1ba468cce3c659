"""Where a problem begins on the motion of a solution, and the rest of that motion as a warm start."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.exceptions import InvalidValue
from mbocp.problem import Problem
from mbocp.programme.iterate import IterateRecord
from mbocp.robot.kinematics import difference
from mbocp.solution.solution import Solution

_AGREES = 0.05  # of the motion's extent and of its largest velocity: what a start is away from it at most
_NEARER = 0.5  # of its distance from the motion's start, or the motion is taken from there
_SAME = 1e-9  # of the same: round-off
_LEAST = 0.1  # [steps]: a start that is hardly later is the motion's own


@dataclass(frozen=True, eq=False)
class Rest:
    """The motion of a solution from a time on.

    Attributes
    ----------
    solution : Solution
    at : float
        [s], as `solution.t` counts.
    """

    solution: Solution
    at: float

    @property
    def qs(self) -> Array:
        """Configurations of the whole motion, shape (N + 1, nq)."""
        return self.solution.qs

    @property
    def iterate(self) -> IterateRecord | None:
        """The solver's iterate for the whole motion."""
        return self.solution.iterate


def place_at(saved: Solution, at: float) -> float:
    """Place of a time [s] on a motion, in steps from its start.

    Raises
    ------
    InvalidValue
        If the motion has ended by then, or not begun.
    """
    if not saved.t[0] <= at < saved.t[-1]:
        raise InvalidValue("at", at, f"a time from {saved.t[0]:g} s, before {saved.t[-1]:g} s")
    return float(np.interp(at, saved.t, np.arange(len(saved.t))))


def place_of_start(saved: Solution, problem: Problem) -> float:
    """Place on a motion where a problem begins, in steps from its start; 0 where it is not on the motion.

    The nearest place counts, by configuration and velocity together, each relative to how far the motion
    gets and how fast it is.
    """
    gaps = _gaps(saved, problem)
    if gaps is None:
        return 0.0
    moves = np.diff(gaps, axis=0)
    lengths = np.einsum("ni,ni->n", moves, moves)
    shares = -np.einsum("ni,ni->n", gaps[:-1], moves) / np.where(lengths > 0.0, lengths, 1.0)
    shares = np.clip(shares, 0.0, 1.0)
    distances = np.linalg.norm(gaps[:-1] + shares[:, None] * moves, axis=1)
    n = int(distances.argmin())
    place = n + float(shares[n])
    is_on_it = distances[n] <= min(_AGREES, _NEARER * float(np.linalg.norm(gaps[0])))
    return place if is_on_it and _LEAST <= place <= saved.num_steps - 1 else 0.0


def begins_beside(saved: Solution, problem: Problem) -> bool:
    """Whether a problem begins near the start of a motion, but not there."""
    gaps = _gaps(saved, problem)
    return gaps is not None and _SAME < float(np.linalg.norm(gaps[0])) <= _AGREES


def _gaps(saved: Solution, problem: Problem) -> Array | None:
    """From a problem's start to each node of a motion, relative to its extent and largest velocity."""
    if problem.start_free is not None:
        return None
    model, start = problem.robot.model, np.asarray(problem.q_start)
    moved = np.array([difference(model, saved.qs[0], q) for q in saved.qs])
    extent, fastest = (np.linalg.norm(rows, axis=1).max() for rows in (moved, saved.vs))
    if not (np.isfinite(extent + fastest) and extent and fastest):
        return None
    away = np.array([difference(model, start, q) for q in saved.qs])
    return np.hstack([away / extent, (saved.vs - problem.v_start) / fastest])

"""Where the solver starts."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from mbocp._arrays import Array, dataclass, frozen_array
from mbocp.exceptions import DimensionMismatch, ProblemError
from mbocp.problem._checks import check_choice, check_finite

GuessKind = Literal["auto", "control", "line", "way", "at_rest", "hold", "joint", "solution"]

GUESSES: tuple[GuessKind, ...] = ("auto", "control", "line", "way", "at_rest", "hold", "joint", "solution")

_OWNERS = (
    ("u", "u", "control"),
    ("q", "q", "way"),
    ("path", "file", "solution"),
    ("at", "at", "solution"),
)  # attribute, key of the file and the kind that it belongs to


@dataclass(frozen=True, kw_only=True, eq=False)
class Guess:
    """Initial guess of the trajectory.

    Attributes
    ----------
    kind : {"auto", "control", "line", "way", "at_rest", "hold", "joint", "solution"}
        ``control``: a constant control and the forward simulation with it (the paper's);
        ``line``: a straight line in the configuration space with inverse dynamics;
        ``way``: straight lines through given configurations, as a path planner finds them;
        ``at_rest``: the same line with all velocities and controls zero, which no dynamics agree with;
        ``hold``: stay at the start with gravity compensated;
        ``joint``: the optimum in joint coordinates, for natural coordinates only;
        ``solution``: a saved solution, of any number of steps;
        ``auto``: what suits the problem.
    u : ndarray, shape (nu,), optional
        The constant control, for ``control`` only [N, N m].
    path : Path, optional
        The saved solution, for ``solution`` only.
    q : ndarray, shape (n, nq), optional
        Configurations between start and goal, for ``way`` only.
    at : float, optional
        Time [s] on the motion of the saved solution at which the problem begins, for ``solution`` only; None:
        it is found.
    """

    kind: GuessKind = "auto"
    u: Array | None = None
    path: Path | None = None
    q: Array | None = None
    at: float | None = None

    def __post_init__(self) -> None:
        check_choice("guess.kind", self.kind, GUESSES)
        if self.u is not None:
            u = frozen_array(self.u, shape=(None,), name="guess.u")
            check_finite("guess.u", u)
            object.__setattr__(self, "u", u)
        if self.q is not None:
            q = frozen_array(self.q, shape=(None, None), name="guess.q")
            check_finite("guess.q", q)
            object.__setattr__(self, "q", q)
        if self.path is not None:
            object.__setattr__(self, "path", Path(self.path))
        if self.at is not None:
            object.__setattr__(self, "at", float(self.at))
            check_finite("guess.at", np.array([self.at]))
        for key, file_key, owner in _OWNERS:
            given = getattr(self, key) is not None
            if self.kind == owner and not given and key != "at":
                raise ProblemError(f'guess: kind = "{owner}" needs the key {file_key!r}')
            if self.kind != owner and given:
                raise ProblemError(
                    f'guess.{file_key}: only used with kind = "{owner}", got kind = "{self.kind}"'
                )

    def check_dimensions(self, nq: int, nu: int) -> None:
        """Refuse what does not fit a robot of `nq` coordinates with `nu` actuators."""
        if self.u is not None and self.u.shape != (nu,):
            raise DimensionMismatch("guess.u", self.u.shape, (nu,))
        if self.q is not None and self.q.shape[1:] != (nq,):
            raise DimensionMismatch("guess.q", self.q.shape, (None, nq))

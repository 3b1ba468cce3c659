"""A step as the rules of what states remember see it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, eq=False)
class Passage:
    """Symbols of one step, or arrays with a row for each: the rules are plain arithmetic.

    Attributes
    ----------
    s0, s1 : casadi.SX, shape (ns,), or ndarray, shape (N, ns)
        Speeds before and after it.
    u : casadi.SX, shape (nu,), or ndarray, shape (N, nu)
        Controls as the state counts them.
    units_of_u : casadi.SX, shape (nu,), or float
        From there to the user's.
    dt : casadi.SX, or ndarray, shape (N, 1)
        Its length [s].
    spacing : casadi.SX, or ndarray, shape (N, 1)
        Time from the middle of the step before to its own [s]; in the first step its length.
    has_before : casadi.SX, or ndarray, shape (N, 1)
        0 in the first step, 1 in all others.
    before : mapping of str
        What was remembered before it, by name.
    units : mapping of str
        Units of the blocks, by name.
    controls : mapping of str
        Controls of the programme, by name.
    given : mapping of str
        Parameters of the step, by name.
    forces : callable
        Rows of the robot's constraints -> their forces in the step [N, N m].
    way : callable
        What leads from the configuration before to that after it, of the shape of speeds [m, rad].
    begin : casadi.SX, shape (nu,), or ndarray, shape (N, nu), or None
        Controls at the begin of the step where they are linear in it; u is at its end.
    """

    s0: Any
    s1: Any
    u: Any
    units_of_u: Any
    dt: Any
    spacing: Any
    has_before: Any
    before: Mapping[str, Any]
    units: Mapping[str, Any]
    controls: Mapping[str, Any]
    given: Mapping[str, Any]
    forces: Callable[[Sequence[int]], Any]
    way: Callable[[], Any]
    begin: Any = None

    @property
    def acceleration(self) -> Any:
        """Mean acceleration."""
        return (self.s1 - self.s0) / self.dt

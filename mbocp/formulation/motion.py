"""Motions of the joints, from which programmes begin and to which their numbers are read back.

A `Passage` is a step of one as the rules of what states remember see it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Any

import numpy as np

from mbocp._arrays import Array, dataclass
from mbocp.integrators import control_powers, controls_within
from mbocp.mechanics import Mechanics


@dataclass(frozen=True, eq=False)
class Motion:
    """A motion of the joints.

    Attributes
    ----------
    qs : ndarray, shape (N + 1, nq)
        Configurations [m, rad, unit quaternion xyzw].
    vs : ndarray, shape (N + 1, nv)
        Velocities [m/s, rad/s].
    us : ndarray, shape (N, nu)
        Controls [N, N m, and the units of drives]; where they vary within steps their means.
    dts : ndarray, shape (N,)
        Lengths of the steps [s].
    values : ndarray, shape (N, k, nu)
        Controls at `shares` of each step; of shape (0, 0, 0) where they are constant.
    shares : tuple of float
        See `mbocp.integrators.controls`.
    found : ndarray, shape (parameters,)
        Numbers of the robot that are found with the motion; empty where nobody has looked.
    lams : ndarray, shape (N, rows)
        Multipliers of all constraints, for what is made of them; of shape (0, 0) where they are not known.
    """

    qs: Array
    vs: Array
    us: Array
    dts: Array
    values: Array = field(default_factory=lambda: np.zeros((0, 0, 0)))
    shares: tuple[float, ...] = ()
    found: Array = field(default_factory=lambda: np.zeros(0))
    lams: Array = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def us_at_ends(self) -> Array:
        """Controls at the ends of the steps, shape (N, nu)."""
        return self.us_at(np.ones(1))[:, 0]

    def us_at(self, at: Array) -> Array:
        """Controls at shares (m,) of each step, shape (N, m, nu)."""
        return controls_within(self.us, self.values, self.shares, at)

    @property
    def us_in_powers(self) -> Array:
        """Coefficients of 1, s, s^2, ... in the share s of a step that has passed, shape (N, k nu)."""
        if not self.shares:
            return self.us
        found: Array = np.einsum("pk,nku->npu", control_powers(self.shares), self.values)
        return found.reshape(len(self.us), -1)


@dataclass(frozen=True, eq=False)
class NodeSlopes:
    """Derivatives of the configurations, in their tangent space, and velocities of a motion.

    Attributes
    ----------
    in_states : ndarray, shape (N + 1, 2 nv, ndx)
        Of each node in its state, along the state's tangent.
    in_us : ndarray, shape (N + 1, 2 nv, nu)
        In the controls of the step after it, of the last node in those of the step before.
    """

    in_states: Array
    in_us: Array


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
    q0 : casadi.SX, shape (nq,), or ndarray, shape (N, nq)
        Configuration before, where coordinates are those of the joints [m, rad].
    way : callable
        What leads from the configuration before to that after it, of the shape of speeds [m, rad].
    mechanics : callable
        The mechanics of the robot.
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
    q0: Any
    way: Callable[[], Any]
    mechanics: Callable[[], Mechanics]
    begin: Any = None

    @property
    def acceleration(self) -> Any:
        """Mean acceleration."""
        return (self.s1 - self.s0) / self.dt

r"""Explicit Runge-Kutta steps on the joints' Lie groups: plain, stabilised, and of Munthe-Kaas's kind.

The state is (z, s): coordinates of the configuration, and speeds. With slopes :math:`k_i = (v_i, \dot s_i)`

- plain: the coordinates z are integrated as if they were a vector, section 4.1 of [Manara2017]_. They leave
  the groups by the error of the method.
- Baumgarte: the same for z with a fictitious rate towards the groups, Eqs. (46), (47); the print of (47) has
  the wrong sign and order of factors.
- Munthe-Kaas: the slopes are taken to the Lie algebra, where the method is at home, and the step ends with
  the exponential, Eqs. (49) to (53). The listings of sections 4.2 and 4.3 leave :math:`\mathrm{dexp}^{-1}`
  out and sum stages where slopes are meant; with them the order is two whatever the tableau.

:math:`\mathrm{dexp}_{-w}^{-1} v = v + \tfrac12 [w, v] + \tfrac1{12} [w, [w, v]] + O(w^4)`, Eq. (52), is taken
up to the terms that are written: the next one is of the fourth order in the step, multiplies a slope, and so
is below the error of every method of order five and less.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import casadi as ca

from mbocp.integrators.chain import Affine, Chain, add_weighted, dense_function
from mbocp.integrators.tableaux import TABLEAUX
from mbocp.mechanics.forward import ForwardMechanics


class Gains(NamedTuple):
    """Rates of Baumgarte's stabilisation [1/s]: gamma_q, gamma_R, and that of holonomic constraints."""

    quaternion: ca.SX
    dcm: ca.SX
    constraint: ca.SX


class CoordinateState(NamedTuple):
    """Coordinates of the configuration, shape (nq,), and speeds, shape (ns,) [m/s, rad/s]."""

    z: Affine
    s: Affine


class ExplicitStep:
    """One step of an explicit method, for any length and control.

    Parameters
    ----------
    mechanics : ForwardMechanics
    scheme : str
        One of `TABLEAUX`.
    lie : {"plain", "baumgarte", "munthe_kaas"}
    substeps : int
        Steps of equal length that make up this one.
    is_free : bool
        Whether the step length is among the unknowns, and derivatives are taken in it.
    """

    def __init__(
        self, mechanics: ForwardMechanics, scheme: str, lie: str, substeps: int, *, is_free: bool = False
    ) -> None:
        self._tableau = TABLEAUX[scheme]
        self._substeps = substeps
        self._is_on_group = lie == "munthe_kaas"
        self._symbols = mechanics.fixed
        self._links = _Links(mechanics, is_stabilised=lie == "baumgarte", is_free=is_free)

    def __call__(
        self, chain: Chain, before: CoordinateState, u: Affine, dt: ca.SX | Affine, gains: Gains
    ) -> CoordinateState:
        """State after a step of length `dt` [s] with the constant control u, as links of a chain.

        Numbers of the robot that are found follow the control.
        """
        rates = ca.vertcat(gains.quaternion, gains.dcm, gains.constraint, self._symbols)
        state, h = before, dt / self._substeps if isinstance(dt, ca.SX) else ca.SX(1)
        if not isinstance(dt, ca.SX):  # then slopes come with it as a factor, see `_Links`
            u = Affine.join([u, (1.0 / self._substeps) * dt])
        step = self._group_step if self._is_on_group else self._plain_step
        for _ in range(self._substeps):
            state = step(chain, state, u, h, rates)
        return state

    def _plain_step(
        self, chain: Chain, at: CoordinateState, u: Affine, h: ca.SX, rates: ca.SX
    ) -> CoordinateState:
        slopes_z: list[Affine] = []
        slopes_s: list[Affine] = []
        for row in self._tableau.a:
            arguments = [_move(at.z, h, row, slopes_z), _move(at.s, h, row, slopes_s), u]
            slope_z, slope_s = chain.apply(self._links.plain, arguments, [rates])
            slopes_z.append(slope_z)
            slopes_s.append(slope_s)
        b = self._tableau.b
        return CoordinateState(_move(at.z, h, b, slopes_z), _move(at.s, h, b, slopes_s))

    def _group_step(
        self, chain: Chain, at: CoordinateState, u: Affine, h: ca.SX, rates: ca.SX
    ) -> CoordinateState:
        slopes_w: list[Affine] = []
        slopes_s: list[Affine] = []
        for row in self._tableau.a:
            s_i = _move(at.s, h, row, slopes_s)
            if any(row):
                arguments = [at.z, h * add_weighted(row, slopes_w), s_i, u]
                slope_w, slope_s = chain.apply(self._links.in_algebra, arguments, [rates])
            else:
                slope_w, slope_s = chain.apply(self._links.at_identity, [at.z, s_i, u], [rates])
            slopes_w.append(slope_w)
            slopes_s.append(slope_s)
        b = self._tableau.b
        (z,) = chain.apply(self._links.exponential, [at.z, h * add_weighted(b, slopes_w)])
        return CoordinateState(z, _move(at.s, h, b, slopes_s))


class _Links:
    """The functions that a step is made of.

    Where the step length is free it follows the controls, and is a factor of all slopes: products of unknowns
    are inside a link then. dexp^{-1} is linear, so that it does not matter when it comes in.
    """

    def __init__(self, mechanics: ForwardMechanics, *, is_stabilised: bool, is_free: bool) -> None:
        space = mechanics.space
        z, s = ca.SX.sym("z", mechanics.nq), ca.SX.sym("s", mechanics.ns)
        u, rates = ca.SX.sym("u", mechanics.nu), ca.vertcat(ca.SX.sym("rates", 3), mechanics.fixed)
        w = ca.SX.sym("w", mechanics.nv)
        v, rate = mechanics.velocity(z, s, u), mechanics.speed_rate(z, s, u, rates[2])
        along = space.rate(z, v)
        if is_stabilised:
            along += space.attraction(z, rates[0], rates[1])
        u = ca.vertcat(u, mechanics.found)
        if is_free:
            length = ca.SX.sym("length")
            u = ca.vertcat(u, length)
            v, rate, along = length * v, length * rate, length * along
        self.at_identity = dense_function("at_identity", [z, s, u, rates], [v, rate])
        self.plain = dense_function("plain", [z, s, u, rates], [along, rate])

        moved = space.integrate(z, w)
        v, rate = self.at_identity(moved, s, u, rates)
        first = space.bracket(w, v)
        pulled_back = v + first / 2 + space.bracket(w, first) / 12  # Eqs. (51), (52)
        self.in_algebra = dense_function("in_algebra", [z, w, s, u, rates], [pulled_back, rate])
        self.exponential = dense_function("exponential", [z, w], [moved])  # Eq. (49)


def _move(base: Affine, h: ca.SX, row: Sequence[Fraction], slopes: Sequence[Affine]) -> Affine:
    return base + h * add_weighted(row, slopes) if any(row) else base

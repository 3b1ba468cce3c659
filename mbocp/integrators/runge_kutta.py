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
from dataclasses import dataclass
from fractions import Fraction

import casadi as ca

from mbocp.integrators.tableaux import TABLEAUX, Tableau
from mbocp.mechanics.forward import ForwardMechanics

__all__ = ["Gains", "explicit_step"]


@dataclass(frozen=True)
class Gains:
    """Rates of Baumgarte's stabilisation [1/s]: gamma_q, gamma_R, and that of holonomic constraints."""

    quaternion: ca.SX
    dcm: ca.SX
    constraint: ca.SX


def explicit_step(
    mechanics: ForwardMechanics,
    scheme: str,
    lie: str,
    substeps: int,
    z: ca.SX,
    s: ca.SX,
    u: ca.SX,
    dt: ca.SX,
    gains: Gains,
) -> tuple[ca.SX, ca.SX]:
    """State (z, s) after a step of length `dt` with a constant control.

    Parameters
    ----------
    mechanics : ForwardMechanics
    scheme : str
        One of `EXPLICIT_SCHEMES`.
    lie : {"plain", "baumgarte", "munthe_kaas"}
    substeps : int
        Steps of equal length that make up this one.
    z : casadi.SX, shape (nq,)
        Coordinates of the configuration.
    s : casadi.SX, shape (ns,)
        Speeds [m/s, rad/s].
    u : casadi.SX, shape (nu,)
    dt : casadi.SX
        [s].
    gains : Gains
    """
    z_in, s_in, u_in, h = (
        ca.SX.sym(n, k) for n, k in zip("zsuh", (z.numel(), s.numel(), u.numel(), 1), strict=True)
    )
    rates = ca.vertcat(gains.quaternion, gains.dcm, gains.constraint)
    rates_in = ca.SX.sym("rates", 3)
    inner = Gains(rates_in[0], rates_in[1], rates_in[2])
    step = _group_step if lie == "munthe_kaas" else _plain_step
    reached = step(mechanics, TABLEAUX[scheme], z_in, s_in, u_in, h, inner, lie == "baumgarte")
    function = ca.Function("step", [z_in, s_in, u_in, h, rates_in], list(reached))
    for _ in range(substeps):
        z, s = function(z, s, u, dt / substeps, rates)
    return z, s


def _plain_step(
    mechanics: ForwardMechanics,
    tableau: Tableau,
    z: ca.SX,
    s: ca.SX,
    u: ca.SX,
    h: ca.SX,
    gains: Gains,
    is_stabilised: bool,
) -> tuple[ca.SX, ca.SX]:
    slope = _slope_function(mechanics)
    slopes_z: list[ca.SX] = []
    slopes_s: list[ca.SX] = []
    for row in tableau.a:
        z_i, s_i = z + h * _sum(row, slopes_z), s + h * _sum(row, slopes_s)
        v, rate = slope(z_i, s_i, u, gains.constraint)
        k = mechanics.space.rate(z_i, v)
        if is_stabilised:
            k += mechanics.space.attraction(z_i, gains.quaternion, gains.dcm)
        slopes_z.append(k)
        slopes_s.append(rate)
    return z + h * _sum(tableau.b, slopes_z), s + h * _sum(tableau.b, slopes_s)


def _group_step(
    mechanics: ForwardMechanics,
    tableau: Tableau,
    z: ca.SX,
    s: ca.SX,
    u: ca.SX,
    h: ca.SX,
    gains: Gains,
    is_stabilised: bool,
) -> tuple[ca.SX, ca.SX]:
    slope, space = _slope_function(mechanics), mechanics.space
    slopes_w: list[ca.SX] = []
    slopes_s: list[ca.SX] = []
    for row in tableau.a:
        w, s_i = h * _sum(row, slopes_w), s + h * _sum(row, slopes_s)
        z_i = space.integrate(z, w) if any(row) else z
        v, rate = slope(z_i, s_i, u, gains.constraint)
        if any(row):
            first = space.bracket(w, v)
            v = v + first / 2 + space.bracket(w, first) / 12  # Eq. (51), (52)
        slopes_w.append(v)
        slopes_s.append(rate)
    return space.integrate(z, h * _sum(tableau.b, slopes_w)), s + h * _sum(tableau.b, slopes_s)


def _slope_function(mechanics: ForwardMechanics) -> ca.Function:
    """(z, s, u, gamma) -> v, ds/dt, in symbols of its own: rates along the motion are taken in them."""
    z, s = ca.SX.sym("z", mechanics.nq), ca.SX.sym("s", mechanics.ns)
    u, gamma = ca.SX.sym("u", mechanics.nu), ca.SX.sym("gamma")
    outputs = [mechanics.velocity(z, s, u), mechanics.speed_rate(z, s, u, gamma)]
    return ca.Function("slope", [z, s, u, gamma], [ca.densify(o) for o in outputs])


def _sum(row: Sequence[Fraction], slopes: Sequence[ca.SX]) -> ca.SX | float:
    terms = [float(a) * k for a, k in zip(row, slopes, strict=True) if a]
    return sum(terms[1:], start=terms[0]) if terms else 0.0

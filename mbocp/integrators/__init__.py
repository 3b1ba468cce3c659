"""Time discretisation: one step of the mechanics as equations between two states."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.integrators.controls import CONTROLS as CONTROLS
    from mbocp.integrators.controls import ControlKind as ControlKind
    from mbocp.integrators.controls import basis_slopes as basis_slopes
    from mbocp.integrators.controls import control_basis as control_basis
    from mbocp.integrators.controls import control_means as control_means
    from mbocp.integrators.controls import control_powers as control_powers
    from mbocp.integrators.controls import control_squares as control_squares
    from mbocp.integrators.controls import controls_within as controls_within
    from mbocp.integrators.controls import cost_order as cost_order
    from mbocp.integrators.controls import root_mean_squares as root_mean_squares
    from mbocp.integrators.controls import shares_of as shares_of
    from mbocp.integrators.euler import State as State
    from mbocp.integrators.euler import evaluation_point as evaluation_point
    from mbocp.integrators.euler import evaluation_points as evaluation_points
    from mbocp.integrators.euler import step_rows as step_rows
    from mbocp.integrators.pairs import PAIRS as PAIRS
    from mbocp.integrators.pairs import Pair as Pair
    from mbocp.integrators.schemes import EULER_SCHEMES as EULER_SCHEMES
    from mbocp.integrators.schemes import SCHEMES as SCHEMES
    from mbocp.integrators.schemes import TAU as TAU
    from mbocp.integrators.schemes import VELOCITY_TAU as VELOCITY_TAU
    from mbocp.integrators.schemes import schemes_that as schemes_that
    from mbocp.integrators.tableaux import LIE_METHODS as LIE_METHODS
    from mbocp.integrators.tableaux import TABLEAUX as TABLEAUX
    from mbocp.integrators.tableaux import Tableau as Tableau


__getattr__ = names_of(__name__, __file__)

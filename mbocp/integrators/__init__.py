"""Time discretisation: one step of the mechanics as equations between two states."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.integrators.controls import (
        CONTROLS,
        ControlKind,
        basis_slopes,
        control_basis,
        control_means,
        control_powers,
        control_squares,
        cost_order,
        root_mean_squares,
        shares_of,
    )
    from mbocp.integrators.euler import State, StepRows, evaluation_point, step_rows
    from mbocp.integrators.pairs import PAIRS, Pair
    from mbocp.integrators.points import evaluation_points
    from mbocp.integrators.schemes import SCHEMES, SchemeData, schemes_that
    from mbocp.integrators.tableaux import LIE_METHODS, TABLEAUX, Tableau
    from mbocp.integrators.tau import EULER_SCHEMES, TAU, VELOCITY_TAU

__all__ = [
    "CONTROLS",
    "EULER_SCHEMES",
    "LIE_METHODS",
    "PAIRS",
    "SCHEMES",
    "TABLEAUX",
    "TAU",
    "VELOCITY_TAU",
    "ControlKind",
    "Pair",
    "SchemeData",
    "State",
    "StepRows",
    "Tableau",
    "basis_slopes",
    "control_basis",
    "control_means",
    "control_powers",
    "control_squares",
    "cost_order",
    "evaluation_point",
    "evaluation_points",
    "root_mean_squares",
    "schemes_that",
    "shares_of",
    "step_rows",
]

__getattr__ = names_of(__name__, __file__)

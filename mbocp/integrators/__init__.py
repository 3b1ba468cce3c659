"""Time discretisation: one step of the mechanics as equations between two states."""

from mbocp.integrators.euler import EULER_SCHEMES, TAU, State, StepRows, evaluation_point, step_rows
from mbocp.integrators.points import evaluation_points
from mbocp.integrators.tableaux import EXPLICIT_SCHEMES, LIE_METHODS, TABLEAUX, Tableau

SCHEMES = (*EULER_SCHEMES, *EXPLICIT_SCHEMES)

__all__ = [
    "EULER_SCHEMES",
    "EXPLICIT_SCHEMES",
    "LIE_METHODS",
    "SCHEMES",
    "TABLEAUX",
    "TAU",
    "State",
    "StepRows",
    "Tableau",
    "evaluation_point",
    "evaluation_points",
    "step_rows",
]

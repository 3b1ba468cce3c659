"""One step of the mechanics as a residual; a method is a small table plus a docstring."""

from mbocp.integrators.euler import SCHEMES, TAU, State, StepRows, evaluation_point, step_rows
from mbocp.integrators.points import evaluation_points

__all__ = ["SCHEMES", "TAU", "State", "StepRows", "evaluation_point", "evaluation_points", "step_rows"]

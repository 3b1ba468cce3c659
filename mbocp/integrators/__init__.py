"""One step of the mechanics as a residual; a method is a small table plus a docstring."""

from mbocp.integrators.euler import SCHEMES, StepRows, step_rows

__all__ = ["SCHEMES", "StepRows", "step_rows"]

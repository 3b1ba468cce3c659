"""Problem x integrator -> stagewise programme, and the way back from its numbers to motions."""

from mbocp.formulation.base import Duals, Formulation
from mbocp.formulation.formulate import formulate, transcribe
from mbocp.formulation.motion import Motion

__all__ = ["Duals", "Formulation", "Motion", "formulate", "transcribe"]

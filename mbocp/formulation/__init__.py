"""Problem x integrator -> stagewise programme, and what its numbers mean."""

from mbocp.formulation.base import Formulation
from mbocp.formulation.build import formulate, transcribe

__all__ = ["Formulation", "formulate", "transcribe"]

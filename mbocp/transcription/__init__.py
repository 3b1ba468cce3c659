"""Problem x integrator -> stagewise programme; compilation of its functions and their cache."""

from mbocp.transcription.programme import StageKind, StagewiseProgramme, transcribe

__all__ = ["StageKind", "StagewiseProgramme", "transcribe"]

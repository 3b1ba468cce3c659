"""What a solve returns, its diagnostics, and its files."""

from __future__ import annotations

from mbocp.solution.accuracy import Accuracy
from mbocp.solution.conserved import ConservedQuantity
from mbocp.solution.limits import ActiveLimit
from mbocp.solution.records import Column, IterationRecord, Labels, Phase, Status
from mbocp.solution.solution import Solution

__all__ = [
    "Accuracy",
    "ActiveLimit",
    "Column",
    "ConservedQuantity",
    "IterationRecord",
    "Labels",
    "Phase",
    "Solution",
    "Status",
]

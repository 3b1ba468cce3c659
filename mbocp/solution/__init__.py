"""What a solve returns, its diagnostics, and its files."""

from __future__ import annotations

from mbocp.solution.accuracy import Accuracy
from mbocp.solution.conserved import ConservedQuantity
from mbocp.solution.limits import ActiveLimit
from mbocp.solution.loads import Load, loads_of
from mbocp.solution.records import Column, Labels
from mbocp.solution.solution import Solution
from mbocp.solvers.records import IterationRecord, Phase, Status

__all__ = [
    "Accuracy",
    "ActiveLimit",
    "Column",
    "ConservedQuantity",
    "IterationRecord",
    "Labels",
    "Load",
    "Phase",
    "Solution",
    "Status",
    "loads_of",
]

"""What a solve returns, its diagnostics, and its files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mbocp._exports import names_of

if TYPE_CHECKING:
    from mbocp.solution.active_limits import ActiveLimit as ActiveLimit
    from mbocp.solution.conserved import ConservedQuantity as ConservedQuantity
    from mbocp.solution.details import Accuracy as Accuracy
    from mbocp.solution.details import Column as Column
    from mbocp.solution.details import Labels as Labels
    from mbocp.solution.loads import Load as Load
    from mbocp.solution.loads import loads_of as loads_of
    from mbocp.solution.solution import Solution as Solution
    from mbocp.solvers.records import IterationRecord as IterationRecord
    from mbocp.solvers.records import Phase as Phase
    from mbocp.solvers.records import Status as Status

__getattr__ = names_of(__name__, __file__)

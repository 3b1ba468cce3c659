"""Forces of what is held, and of constraints whose forces are bounded: the size of each over time."""

from __future__ import annotations

import numpy as np

from mbocp.solution import Solution
from mbocp.view.figures.lines import LinePanel
from mbocp.view.figures.style import plain_text
from mbocp.view.forces import in_time

_FORCE = "J/m"  # unit of multipliers of positions: newtons


def force_panels(solution: Solution) -> list[LinePanel]:
    """Return one panel with the size of each force [N]; none where nothing is held, and no force is bounded.

    Impulses are no forces: in steps of no duration the force of the step before goes on.
    """
    asked = {*solution.facts.held, *solution.facts.contacts}
    columns: dict[str, list[int]] = {}
    for k, column in enumerate(solution.labels.lam):
        owner = column.name if column.name in asked else column.name.rpartition(".")[0]
        if owner in asked and column.unit == _FORCE:
            columns.setdefault(owner, []).append(k)
    if not columns:
        return []
    sizes = [np.linalg.norm(solution.lams[:, found], axis=1) for found in columns.values()]
    values = in_time(np.column_stack(sizes), np.diff(solution.t))
    names = tuple(plain_text(name) for name in columns)
    return [LinePanel("Forces of constraints", "$|f|$ [N]", names, solution.t, values, step=True)]

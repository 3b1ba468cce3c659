"""How an interior-point solver ended, as a status and advice."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp.programme import StagewiseProgramme
from mbocp.solvers.nlp.nlp_layout import NlpLayout
from mbocp.solvers.records import Status

_ACCEPTABLE_RESIDUAL = 1e-5  # residual below which a solver that stalls has found what it was looking for

_IPOPT = {
    "Solve_Succeeded": Status.CONVERGED,
    "Infeasible_Problem_Detected": Status.INFEASIBLE,
    "Maximum_Iterations_Exceeded": Status.MAX_ITERATIONS,
    "Maximum_WallTime_Exceeded": Status.TIME_LIMIT,
    "Search_Direction_Becomes_Too_Small": Status.LINE_SEARCH_FAILED,
    "Restoration_Failed": Status.LINE_SEARCH_FAILED,
    "Solved_To_Acceptable_Level": Status.LINE_SEARCH_FAILED,
    "Diverging_Iterates": Status.DIVERGED,
    "Invalid_Number_Detected": Status.DIVERGED,
    "Error_In_Step_Computation": Status.SINGULAR,
    "Not_Enough_Degrees_Of_Freedom": Status.INFEASIBLE,
}


def status_of(name: str, stats: Mapping[str, Any], stopped: str, max_iterations: int) -> Status:
    """Status from what the solver returned; `stopped`: why mbocp ended it."""
    if stopped:
        return Status.INTERRUPTED if stopped == "interrupted" else Status.TIME_LIMIT
    if stats.get("success"):
        return Status.CONVERGED
    if name == "ipopt":
        return _IPOPT.get(str(stats.get("return_status")), Status.LINE_SEARCH_FAILED)
    # All that fatrop says; one iteration is too few for it to take any.
    is_spent = int(stats.get("iter_count", 0)) >= (max_iterations if max_iterations > 1 else 0)
    return Status.MAX_ITERATIONS if is_spent else Status.LINE_SEARCH_FAILED


def advice_of(
    status: Status,
    programme: StagewiseProgramme,
    lay: NlpLayout,
    violations: Array,
    taken: int,
    residual: float,
) -> str:
    """What the status means here, and what to do."""
    worst = _worst(programme, lay, violations)
    iterations = f"{taken} iteration{'' if taken == 1 else 's'}"
    texts = {
        Status.CONVERGED: "a local minimum: the solver's optimality error is below the tolerance",
        Status.INFEASIBLE: "no motion meets all constraints, as far as the solver can see from this guess; "
        "widen the limits, take a longer duration or another goal",
        Status.MAX_ITERATIONS: f"not converged in {iterations}; raise solver.max_iterations, or start from "
        "another guess",
        Status.TIME_LIMIT: f"not converged within solver.time_limit, after {iterations}; raise it, or start "
        "from another guess",
        Status.LINE_SEARCH_FAILED: f"no step makes progress any more after {iterations}; the goal may be out "
        "of reach within the limits; try a longer duration, wider limits, another guess, or the other of "
        '"ipopt" and "fatrop"',
        Status.DIVERGED: "the iterates left the finite numbers, or steps that keep errors small; take "
        "more steps or another guess",
        Status.SINGULAR: "the linear system cannot be solved; look for constraints that depend on each other",
        Status.INTERRUPTED: f"interrupted after {iterations}; the last iterate",
    }
    if status is Status.CONVERGED:
        return texts[status]
    if status is Status.LINE_SEARCH_FAILED and residual < _ACCEPTABLE_RESIDUAL:
        return (
            f"near a solution, but no step makes progress any more after {iterations} "
            f'(residual {residual:.1e}); raise solver.tolerance, or take the other of "ipopt" and "fatrop"'
        )
    return f"{texts[status]}; {worst}"


def _worst(programme: StagewiseProgramme, lay: NlpLayout, violations: Array) -> str:
    row = int(np.argmax(violations))
    size = f"({violations[row]:.1e})"
    if violations[row] <= 1e-8:
        return f"all constraints hold {size}"
    describe = programme.describe_row
    for name, rows in (("steps", lay.steps), ("gaps", lay.gaps)):
        at = np.argwhere(rows == row)
        if at.size:
            step, index = (int(i) for i in at[0])
            words = describe(step, index) if name == "steps" else f"the step to node {step + 1}"
            return f"largest violation: {words} {size}"
    at = np.argwhere(lay.path == row)
    if at.size:
        node, index = (int(i) for i in at[0])
        when = programme.describe_node(node + 1)
        return f"largest violation: {programme.describe_path(index)} {when} {size}"
    if row in lay.end:
        return f"largest violation: {describe(-1, int(row - lay.end[0]))} {size}"
    return f"largest violation: {'guard of the end condition' if row in lay.guards else 'start'} {size}"

"""Where the numbers of a problem's cost terms come from."""

from __future__ import annotations

from mbocp.lie import ConfigurationSpace
from mbocp.problem import Cost, Problem
from mbocp.problem.contact_bounds import force_rows
from mbocp.terms.cost import TermNumbers


def term_numbers(problem: Problem, cost: Cost, joints: ConfigurationSpace) -> TermNumbers:
    """Return those of a problem with a cost, which may be that of a phase, compared on `joints`."""
    forces = force_rows(problem.terms, problem.robot, problem.scheme, problem.timeline.switches)
    return TermNumbers(cost, problem.robot, joints, problem.num_steps, problem.terms, forces)

"""Why a solve could not succeed, in one line."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbocp.problem import Problem


def first_cause(problem: Problem) -> str:
    """The first thing that arithmetic says against a problem; "" if it says nothing."""
    from mbocp.problem.reasons.causes import causes_of

    causes = causes_of(problem)
    if not causes:
        return ""
    return causes[0].words if causes[0].is_certain else f"probably: {causes[0].words}"

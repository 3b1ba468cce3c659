"""A formulation as it is read: with the robot that was found where some of its numbers were."""

from __future__ import annotations

from dataclasses import replace

from mbocp.formulation.base import Formulation
from mbocp.formulation.motion import Motion


def at_found(formulation: Formulation, motion: Motion) -> Formulation:
    """Return it with the robot of a motion; its programme and all else of the problem stay as they are."""
    problem, names = formulation.problem, [one.name for one in formulation.problem.parameter]
    if not names:
        return formulation
    found = problem.with_found(dict(zip(names, motion.found.tolist(), strict=True)))
    return replace(formulation, problem=found)

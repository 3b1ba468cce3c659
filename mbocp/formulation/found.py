"""A formulation as it is read: with the robot that was found where some of its numbers were."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

from mbocp.formulation.base import Formulation
from mbocp.formulation.motion import Motion
from mbocp.problem.parameter import with_values


def at_found(formulation: Formulation, motion: Motion) -> Formulation:
    """Return it with the robot of a motion; its programme and all else of the problem stay as they are."""
    problem = formulation.problem
    if not problem.parameter:
        return formulation
    robot = with_values(problem.robot, problem.parameter, motion.found)
    return cast(Formulation, replace(cast(Any, formulation), problem=replace(problem, robot=robot)))

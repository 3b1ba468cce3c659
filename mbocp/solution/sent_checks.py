"""What a robot and its surroundings say of a motion as it is sent: torques, path constraints, obstacles."""

from __future__ import annotations

import numpy as np

from mbocp.problem import Problem
from mbocp.solution.sent import Excess, Sent
from mbocp.solution.sent_path import path_excesses
from mbocp.solution.sent_torques import has_torques, torque_excesses


def check_sent(sent: Sent, problem: Problem) -> tuple[tuple[Excess, ...], tuple[str, ...]]:
    """Look at the torques that a motion takes as it is sent, and at path constraints and obstacles.

    Parameters
    ----------
    sent : Sent
    problem : Problem
        What the motion is a solution of; terms of one's own may be missing.

    Returns
    -------
    excesses : tuple of Excess
        Of torques, the worst first, and of path constraints.
    unknown : tuple of str
        What was not looked at: efforts, and path constraints by name.
    """
    excesses, unseen = path_excesses(sent, problem)
    rows = {label.name for constraint in problem.path for label in constraint.labels}
    unknown = [*unseen, *(row.name for row in sent.solution.facts.path if row.name not in rows)]
    if np.isfinite(sent.solution.limits_u).any():
        if has_torques(sent, problem.robot):
            excesses = (*torque_excesses(sent, problem.robot), *excesses)
        else:
            unknown.insert(0, "efforts")
    return excesses, tuple(unknown)

"""Links that are in each other at the start or at the goal, where spheres do not tell."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp._tolerances import BOUND_TOLERANCE
from mbocp.exceptions import ProblemError
from mbocp.problem.goals.goal import Goal
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.problem.obstacles.shape_distances import ShapeDistances


def refuse_links_in_each_other(clearance: Clearance, q_start: Array, goal: Goal) -> None:
    """Refuse a start, and a goal given in full, in which links meet whose spheres may overlap.

    Raises
    ------
    ProblemError
        With the names of both links.
    """
    groups = np.unique(clearance.groups[clearance.overlaps > 0.0])
    shapes = ShapeDistances(clearance, [clearance.link_pairs[group] for group in groups])
    ends = {"start": q_start} | ({"goal": goal.q} if goal.is_exact and goal.q_active.all() else {})
    for where, q in ends.items() if groups.size else ():
        shapes.place(clearance.scene_configurations(q[None])[0])
        for k, group in enumerate(groups):
            distance = shapes.of(k)
            margin = float(clearance.margins[clearance.groups == group][0])
            if distance < margin - BOUND_TOLERANCE:
                link, other = clearance.names_of(clearance.link_pairs[group])
                how = f"{1e3 * abs(distance):.4g} mm {'inside' if distance < 0.0 else 'from'} {other}"
                raise ProblemError(
                    f"self_collision: at the {where} {link} is {how}, and the margin is {1e3 * margin:.4g} "
                    f"mm; move the {where}"
                )

"""How far the steps of a motion are from the motion of the robot, in words."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text

from mbocp.integrators.schemes import what_errs_less

if TYPE_CHECKING:
    from mbocp.solution import Accuracy, Solution

_KNOWN_WORK = 0.05  # part of a work: energy that steps make beside it, of which nothing is said


def coarse_words(solution: Solution) -> Text:
    """What has to be known before everything else: that the steps are too long for the motion."""
    found = solution.accuracy
    if not found.is_known or found.is_small:
        return Text()
    words = (
        f"the errors of the steps are {_percent(found.share)} of the way of {found.way_joint}: a robot "
        f"under these controls moves otherwise; take {what_errs_less(solution.scheme)} (see accuracy)"
    )
    return Text(words, style="bold yellow")


def _feedback(found: Accuracy, size: Callable[[float, str], str]) -> list[str]:
    """What a feedback leaves of the errors."""
    if math.isnan(found.tracked_error):
        return []
    if math.isinf(found.tracked_error):
        return ["with the feedback of the optimum, held over each step, errors grow too fast to be told"]
    missed = size(found.tracked_error, found.tracked_joint)
    return [f"with the feedback of the optimum they miss it by {missed}"]


def _percent(share: float) -> str:
    return f"{100 * share:.2g} %" if share < 1.0 else f"{100 * share:.0f} %"


def work_words(solution: Solution) -> str:
    """Work of the controls, and what the steps make beside it, where that is much."""
    if math.isnan(solution.positive_work):
        return ""
    words = f"{solution.positive_work:.4g} J by the controls, braking left out"
    made = solution.accuracy.made_energy
    is_known = not abs(made) > _KNOWN_WORK * solution.positive_work
    return words if is_known else f"{words}; {_describe_energy_made(made)} beside it"


def _describe_energy_made(energy: float) -> str:
    return f"the steps {'make' if energy > 0.0 else 'lose'} {abs(energy):.2g} J"


def accuracy_words(solution: Solution) -> str:
    """Errors of single steps, of their sum, and of a replay."""
    found = solution.accuracy
    if not found.is_known:
        return ""
    units = {column.name: column.unit.removesuffix("/s") for column in solution.labels.v}
    units |= {column.name: column.unit for column in solution.labels.q}  # not root_joint.rx

    def size(value: float, joint: str) -> str:
        return f"{value:.2g} {units.get(joint, 'rad' * bool(joint))}".rstrip() + f" ({joint})"

    missed = "more than can be told, for errors grow too fast"
    if math.isfinite(found.replay_error):
        missed = size(found.replay_error, found.replay_joint)
    moves = found.way > 0.0
    of_way = f"; all of them by {_percent(found.share)} of the way of {found.way_joint}" if moves else ""
    lines = [
        *_horizon_and_solver(solution),
        f"a step is wrong by {size(found.local_error, found.local_joint)} at most, to t = "
        f"{found.local_time:.4g} s{of_way}",
        f"the controls alone, without feedback, miss the end by {missed}",
        *_feedback(found, size),
        f"{_describe_energy_made(found.made_energy)} of {found.energy_range:.3g} J",
    ]
    return "\n".join(lines)


def _horizon_and_solver(solution: Solution) -> list[str]:
    """What was asked for, and how many steps it took."""
    found = solution.accuracy
    if math.isnan(found.asked):
        return []
    rounds = "1 round" if found.rounds == 1 else f"{found.rounds} rounds"
    lengths = np.diff(solution.t)
    wrong = f"the cost is wrong by {found.cost_error:.1g} of it" if found.cost_error else "the cost is zero"
    return [
        f"{found.asked:g} was asked for: {solution.num_steps} steps of {lengths.min():.3g} to "
        f"{lengths.max():.3g} s, found in {rounds}; {wrong}"
    ]

"""Whether the steps of a motion resolve it, and the least time that it takes."""

from __future__ import annotations

import numpy as np

from mbocp.formulation.base import Formulation
from mbocp.formulation.motion import Motion
from mbocp.mechanics.diagnostics import largest_turn
from mbocp.programme import Iterate

_LARGEST_TURN = 1.0  # [rad] in one step; a symplectic Euler step of that size has lost all accuracy
_MOSTLY = 0.9  # of a cost: what makes it one of time
_SENSITIVE = 5.0  # times as large as the change of all limits of controls: 0.5 is usual, as for a mass


def describe_coarse_turn(formulation: Formulation, motion: Motion) -> str | None:
    """Say which joint turns too far in one step for a motion of the robot, and how far; None if none does."""
    problem = formulation.problem
    longest = float(motion.dts.max())
    name, turn = largest_turn(problem.robot, motion.qs, motion.vs, longest, problem.substeps)
    if not turn > _LARGEST_TURN:
        return None
    return f"{name} turns by {turn:.1f} rad in one step, which is no motion any more"


def describe_sensitive_time(
    formulation: Formulation, iterate: Iterate, motion: Motion, cost: float
) -> str | None:
    r"""Say that a least time stands and falls with the limits of the controls; None if it does not.

    With multipliers :math:`\lambda` of the limits of the controls u,

    .. math:: S = \frac{1}{T} \sum_{n, i} |\lambda_{n, i}\, u_{n, i}|

    is by how many times a relative change of all limits changes the time T, 1/2 for a mass that is moved from
    rest to rest. Where it grows without bound as steps become shorter, the least time has no derivative: what
    steps are wrong by, a little of a control that leaps, costs as much as a whole step.
    """
    problem, bounds = formulation.problem, iterate.bounds
    of_time = float(problem.cost.weight("time") * motion.dts.sum())
    is_least_time = problem.duration_range is not None and of_time >= _MOSTLY * cost > 0.0
    if not is_least_time or bounds is None:
        return None
    own = slice(0, formulation.layout.num_own)
    times = float(np.abs(bounds.us[:, own] * iterate.us[:, own]).sum() / of_time)
    if not times > _SENSITIVE:
        return None
    return (
        f"the least time hangs on the limits of the controls: a small change of these changes it by "
        f"{times:.2g} times as much (0.5 is usual), and steps may make it longer by one of them, "
        f"{motion.dts.max():.2g} s: compare with more steps"
    )

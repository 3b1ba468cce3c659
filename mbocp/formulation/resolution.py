"""Whether the steps of a motion resolve it."""

from __future__ import annotations

from mbocp.formulation.base import Formulation
from mbocp.formulation.motion import Motion
from mbocp.mechanics.diagnostics import largest_turn

_LARGEST_TURN = 1.0  # [rad] in one step; a symplectic Euler step of that size has lost all accuracy


def describe_coarse_turn(formulation: Formulation, motion: Motion) -> str | None:
    """Say which joint turns too far in one step for a motion of the robot, and how far; None if none does."""
    problem = formulation.problem
    longest = float(motion.dts.max())
    name, turn = largest_turn(problem.robot, motion.qs, motion.vs, longest, problem.substeps)
    if not turn > _LARGEST_TURN:
        return None
    return f"{name} turns by {turn:.1f} rad in one step, which is no motion any more"

"""Numbers of what states remember: units, and the memory of the nodes of a motion."""

from __future__ import annotations

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.features.control_values import ends_of, values_of
from mbocp.formulation.features.memory import MEMORY, memory_along
from mbocp.formulation.features.progress import advances
from mbocp.formulation.features.reactions import reaction_rows, unit_of_reactions
from mbocp.formulation.features.step_lengths import lengths_of_states
from mbocp.formulation.features.switches import impacts_of
from mbocp.formulation.layout import StateLayout
from mbocp.problem import Problem

__all__ = ["memory_at_start", "memory_units", "with_memory"]

_RISE = 8.0  # part of the duration over which the greatest jerk makes a typical acceleration


def memory_units(problem: Problem) -> dict[str, float]:
    """Units of the blocks that have one [m/s^2, rad/s^2 and the like], by name.

    Those of the limits. Where the jerk alone is limited, accelerations are of the size that it makes.
    """
    units = {name: 1.0 for name, block in MEMORY.items() if block.has_unit}
    units |= {name: c.scale for c in problem.rate_limits for name in c.term.remembers[-1:] if name in units}
    keys = {limit.key for limit in problem.rate_limits}
    if "jerk" in keys and "acceleration" not in keys:
        units["acceleration"] = units["jerk"] * problem.duration / _RISE
    return units | {"reaction": unit_of_reactions(problem)}


def memory_at_start(problem: Problem, at: StateLayout) -> Array:
    """What the first state remembers, shape (nr,): the acceleration before the start, and else nothing."""
    known = _before(problem)
    parts = [known.get(name, np.zeros(where.stop - where.start)) for name, where in at.remembered.items()]
    return np.concatenate([np.zeros(0), *parts])


def _before(problem: Problem) -> dict[str, Array]:
    """What was before the start and is not zero, by name of its block."""
    if not problem.a_start.any():
        return {}
    return {"acceleration": problem.a_start / memory_units(problem)["acceleration"]}


def with_memory(problem: Problem, at: StateLayout, xs: Array, us: Array, lams: Array | None = None) -> Array:
    """States (N + 1, nx) that remember what their speeds, controls (N, any) and lengths of steps say.

    `lams`: forces of the robot's constraints, shape (N, nc), where any are remembered.
    """
    if not at.nr:
        return xs
    nu, dts = at.num_own, lengths_of_states(problem, at, xs)
    names = tuple(at.remembered)
    paces = (us[:, nu : nu + at.num_paces], advances(problem))
    forces = None if lams is None else lams[:, list(reaction_rows(problem))]
    if forces is not None:
        forces = np.where(impacts_of(problem)[:, None], forces / problem.dt, forces)
    first = nu + at.num_paces
    moves = us[:, first : first + at.num_moves]
    begins = values_of(at, us)[:, 0] if at.is_continuous else None
    given = (memory_units(problem), paces, impacts_of(problem), forces, moves, begins)
    found = memory_along(names, xs[:, at.s], ends_of(at, us), dts, *given, _before(problem))
    filled = np.array(xs)
    for name, where in at.remembered.items():
        filled[:, where] = found[name]
    return filled

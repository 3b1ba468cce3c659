"""Weights of the running cost that differ from phase to phase.

The functions of a programme take the heaviest weights of all phases, and for each step the part of them that
counts in its phase. So the cost stays linear in parameters of the whole horizon, and functions depend on
which weights differ, not on their numbers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mbocp._arrays import Array
from mbocp.problem.cost import Cost, weights_by_key
from mbocp.problem.timeline.named_phase import NamedPhase
from mbocp.robot import Robot


def heaviest_cost(cost: Cost, phases: Sequence[NamedPhase], robot: Robot) -> Cost:
    """The cost with those weights of all phases that are largest, component by component."""
    rows = _weights_of_phases(cost, phases, robot)
    return cost.with_weights({key: _shaped(key, _heaviest(values)) for key, values in rows.items()})


def weight_shares(cost: Cost, phases: Sequence[NamedPhase], robot: Robot) -> dict[str, Array]:
    """Which part of the heaviest weights counts in each phase, shape (phases, size), by the term's key."""
    found = {}
    for key, values in _weights_of_phases(cost, phases, robot).items():
        heaviest = _heaviest(values)
        found[key] = np.divide(values, heaviest, out=np.ones_like(values), where=heaviest != 0.0)
    return found


def _weights_of_phases(cost: Cost, phases: Sequence[NamedPhase], robot: Robot) -> dict[str, Array]:
    """Weights in each phase, shape (phases, size), of those terms that a phase names."""
    if not phases:
        return {}
    known = weights_by_key()
    keys = [key for key in known if any(key in phase.weights for phase in phases)]
    found = {}
    for key in keys:
        size = known[key].size_over(robot.nu, robot.nv)
        rows = [np.asarray(phase.weights.get(key, cost.weight(key)), dtype=float) for phase in phases]
        found[key] = np.array([np.broadcast_to(row, (size,)) for row in rows])
    return found


def _heaviest(rows: Array) -> Array:
    places = np.abs(rows).argmax(axis=0)
    found: Array = rows[places, np.arange(rows.shape[1])]
    return found


def _shaped(key: str, weights: Array) -> Array | float:
    return float(weights[0]) if key == "potential" else weights

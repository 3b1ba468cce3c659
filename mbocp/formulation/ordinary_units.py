"""The units that suit a problem: those of the user, unless forces or costs are far from one there.

Solvers have absolute numbers: tolerances, shifts, barriers, filters. They suit forces of 0.1 to 1000 N or
N m and weights that fit them. Such problems keep the user's units. Others get those in which gravity, or the
motion from start to goal, takes forces of about one, and costs about one. Where tracking alone costs so much,
it costs a thousand: such weights are of what hardly leaves its target, and what the motion costs is less.
"""

from __future__ import annotations

import math

import numpy as np

from mbocp._arrays import BoolArray
from mbocp.formulation.parameter_layout import ParameterLayout, mask
from mbocp.formulation.pieces import Pieces
from mbocp.formulation.signature import FunctionSignature
from mbocp.problem import Problem
from mbocp.problem.weights import typical_force
from mbocp.programme.stagewise import Units

_ORDINARY_FORCE = (2.0**-4, 2.0**10)  # [N, N m]
_ORDINARY_COST = (2.0**-10, 2.0**20)
_LARGE_TRACKING = 2.0**10  # of a radian or a metre all the time, where that is beyond ordinary costs


def units_of(pieces: Pieces) -> Units:
    """The units that suit a problem, and the entries of its programme that count in them."""
    robot, at, signature, algebraic = pieces.problem.robot, pieces.layout, pieces.signature, pieces.algebraic
    is_force = np.arange(robot.nu) < robot.nu - len(robot.drives)
    x, rows = np.zeros(at.nx, dtype=bool), np.append(np.zeros(at.ndx, dtype=bool), algebraic.is_balance)
    for block in at.blocks:
        if block.counts_as_control:
            x[at.states[block.name]] = rows[at.rows[block.name]] = is_force
    u = np.zeros(at.num_controls, dtype=bool)
    u[: at.num_own] = np.tile(is_force, signature.control_values.count)
    rows[at.ds] = not signature.steps.rows_are_gaps
    force, cost = ordinary_units(pieces.problem)
    parameters = pieces.parameters
    terminal, end_rows = units_of_end(signature, parameters)
    return Units(
        force=force,
        cost=cost,
        theta=mask(parameters.theta, ("force",)),
        x=x,
        u=u,
        y=algebraic.is_force,
        rows=rows,
        terminal=terminal,
        end_rows=end_rows,
    )


def units_of_end(signature: FunctionSignature, parameters: ParameterLayout) -> tuple[BoolArray, BoolArray]:
    """Of the end's parameters and of its rows those that count in the unit of force, see `Units`."""
    goal, rows = signature.goal, np.arange(signature.end_rows)
    of_force = mask(parameters.terminal, ("D_rate",) if goal.rate == "p" else ())
    return of_force, (goal.ng_q <= rows) & (rows < goal.rows) & (goal.rate == "p")


def ordinary_units(problem: Problem) -> tuple[float, float]:
    """Unit of force [N, N m] and factor of the cost, see `Units`; (1, 1): the user's."""
    goal = problem.goal
    is_asked = goal.q_active | bool(goal.poses)
    force = typical_force(problem.robot, problem.q_start, problem.v_start, goal.q, is_asked, problem.duration)
    cost = _typical_cost(problem, force)
    if _is_within(force, _ORDINARY_FORCE) and _is_within(cost, _ORDINARY_COST):
        return 1.0, 1.0
    unit = 1.0 if _is_within(force, _ORDINARY_FORCE) else _power_of_two(force)
    is_tracking = cost > _ORDINARY_COST[1] and cost <= problem.duration * _find_largest_tracking(problem)
    return unit, (_LARGE_TRACKING if is_tracking else 1.0) / _power_of_two(cost)


def _is_within(value: float, band: tuple[float, float]) -> bool:
    return band[0] <= value <= band[1] or not 0.0 < value < math.inf


def _power_of_two(value: float) -> float:
    return 2.0 ** round(math.log2(value)) if 0.0 < value < math.inf else 1.0


def _typical_cost(problem: Problem, force: float) -> float:
    """What the running cost comes to with such forces, over the whole duration."""
    cost, nv, T = problem.cost, problem.robot.nv, problem.duration
    weights = cost.tracking * np.asarray(cost.tracking_weights)
    rates = (
        np.max(cost.on_squares, initial=0.0) * force**2,
        np.max(cost.control_rate, initial=0.0) * (force / T) ** 2,
        np.max(cost.velocity, initial=0.0) / T**2,
        _find_largest_tracking(problem),
        np.max(weights[nv:], initial=0.0) * (force * T) ** 2,
        abs(cost.potential) * force,
        float(cost.weight("time")),
    )
    return T * float(max(rates))


def _find_largest_tracking(problem: Problem) -> float:
    """Largest weight of a distance from the target's configuration."""
    cost = problem.cost
    return float(np.max(cost.tracking * np.asarray(cost.tracking_weights)[: problem.robot.nv], initial=0.0))

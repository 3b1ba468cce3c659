"""`[cost]`: the keys of its terms, from what is written to weights and targets, and back."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp._keys import Table, merge_tables
from mbocp.exceptions import ProblemError
from mbocp.problem.cost import Cost, further_terms, weights_by_key
from mbocp.problem.file.messages import locate
from mbocp.problem.file.named_values import configuration_from, control_from, tangent_from, weights_from
from mbocp.problem.file.target import read_target
from mbocp.problem.goals.goal import Goal
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.sequence import are_alike
from mbocp.problem.timeline.times import check_duration
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.typical import typical_force, velocity_weight
from mbocp.robot import Robot
from mbocp.terms import COST_TERMS
from mbocp.terms.cost import Reader
from mbocp.terms.tables import WeightsTable
from mbocp.terms.written import AUTO

CostTable = merge_tables(
    "CostTable", "What is minimised: the keys of all terms.", (t.Keys for t in COST_TERMS), Table
)

PhaseCostTable = merge_tables(
    "PhaseCostTable", "Weights that differ in a phase.", (t.Keys for t in weights_by_key().values()), Table
)


def make_cost_reader(
    robot: Robot,
    said_goal: Goal,
    folder: Path,
    said_duration: float,
    said_duration_range: tuple[float, float] | None,
    said_via: tuple[ViaPoint, ...],
    phases_unweighted: tuple[Phase, ...],
    said_num_steps: int,
    said_q_start: Array,
    said_v_start: Array,
) -> Reader:
    """Return what reads the values of `[cost]`, here and in phases."""
    has_free_times = any(point.is_free for point in said_via) or not are_alike(phases_unweighted)
    horizon = {"duration": said_duration, "duration_range": said_duration_range}
    start = (said_q_start, said_v_start)
    return _CostReader(robot, said_goal, folder, horizon, has_free_times, said_num_steps, *start)


def read_cost(cost_table: Any, goals: tuple[Goal, ...], is_cost_left: bool, cost_reader: Reader) -> Cost:
    """The cost; that of a file without one weighs velocities as suits the motion."""
    table = cost_table.model_copy(update={"velocity": AUTO}) if is_cost_left else cost_table
    if goals and table.tracking and table.target is None and table.target_file is None:
        raise ProblemError("cost.tracking: of several goals none is the target; give cost.target")
    values: dict[str, Any] = {}
    for term in COST_TERMS:
        values |= term.read(table, cost_reader)
    further = {key: values.pop(key) for key in further_terms()}
    return Cost(**values, further=further)


def write_cost(cost: Cost) -> dict[str, Any]:
    """Return the table that reads back as the same."""
    table: dict[str, Any] = {}
    for term in COST_TERMS:
        table |= term.write(cost)
    return table


@dataclass(frozen=True)
class _CostReader:
    """From the values of `[cost]` to arrays, see `mbocp.terms.Reader`."""

    robot: Robot
    goal: Goal
    folder: Path
    horizon: dict[str, Any]  # duration and its range
    has_free_times: bool  # of via points
    num_steps: int
    q_start: Array
    v_start: Array

    def on_controls(self, written: Any, key: str) -> Any:
        if type(written) is float:
            return written  # one for all; errors name no control then
        with locate(key):
            return control_from(self.robot, written, key)

    def on_velocities(self, written: Any, key: str) -> Array:
        if written is None:
            return np.zeros(self.robot.nv)
        if written == AUTO:
            goal = self.goal
            T, _ = check_duration(self.horizon["duration"], self.horizon["duration_range"])
            ends = (self.q_start, self.v_start, goal.q, goal.q_active)
            return velocity_weight(self.robot, typical_force(self.robot, *ends, T), T)
        with locate(key):
            return weights_from(self.robot, written, key)

    def targets(self, target: Any, target_file: str | None) -> tuple[Array, Array, BoolArray]:
        robot, goal = self.robot, self.goal
        target_q, given_q = goal.q, goal.q_active
        target_p, given_p = _goal_momentum(robot, goal)
        if target is not None and target_file is not None:
            raise ProblemError("cost: give target or target_file, not both")
        if target is not None:
            target_q, given_q = _target_rows(robot, target.q, "q", goal.q)
            target_p, given_p = _target_rows(robot, target.p, "p", np.zeros(robot.nv))
        elif target_file is not None:
            path = self.folder / target_file
            if self.horizon["duration_range"] is not None or self.has_free_times:
                what = "horizon.duration is" if self.horizon["duration_range"] is not None else "via.time is"
                raise ProblemError(
                    f"cost.target_file: a file says when the robot is where, and {what} free; "
                    "give a number there, or cost.target, whose rows belong to the steps"
                )
            target_q, target_p = read_target(path, robot, self.horizon["duration"], self.num_steps)
            given_q = given_p = np.ones(robot.nv, dtype=np.bool_)
        return target_q, target_p, np.concatenate([given_q, given_p])

    def goal_says(self) -> BoolArray:
        return np.concatenate([self.goal.q_active, self.goal.rate_active])

    def on_states(self, written: WeightsTable | None, default: BoolArray, key: str) -> Array:
        return _weights(self.robot, written, default, key)

    def check_weighed(self, weights: Array, given: BoolArray, key: str, source: str) -> None:
        if source == "the goal" and self.goal.frames and not weights.any():
            return  # frames have weights of their own
        _check_targets(self.robot, weights, given, key, source)


def _goal_momentum(robot: Robot, goal: Goal) -> tuple[Array, BoolArray]:
    """Return the momentum at the goal, and which components of it the goal determines."""
    if goal.rate == "p":
        return goal.value, goal.rate_active
    is_known = bool(goal.rate_active.all())
    if not (is_known and goal.value.any()):
        return np.zeros(robot.nv), np.full(robot.nv, is_known)  # at rest p = 0, whatever q
    if goal.q_active.all():
        return np.array(robot.momentum(goal.q, goal.value)), goal.rate_active
    return np.zeros(robot.nv), np.zeros(robot.nv, dtype=np.bool_)


def _target_rows(robot: Robot, written: Any, letter: str, base: Array) -> tuple[Array, BoolArray]:
    """Return a target, one row or one for each step, and which directions of it were written."""
    key = f"cost.target.{letter}"
    if written is None:
        return base, np.zeros(robot.nv, dtype=np.bool_)
    is_trajectory = isinstance(written, list) and written and isinstance(written[0], list)
    rows, active = [], np.ones(robot.nv, dtype=np.bool_)
    with locate(key):
        for row in written if is_trajectory else [written]:
            if letter == "q":
                q, active = configuration_from(robot, row, base, key)
                rows.append(robot.normalise(q, name=key))
            else:
                p, active = tangent_from(robot, row, key)
                rows.append(p)
    return (np.array(rows) if is_trajectory else np.array(rows[0])), active


def _weights(robot: Robot, table: WeightsTable | None, default: BoolArray, key: str) -> Array:
    if table is None:
        return np.asarray(default, dtype=np.float64)
    with locate(key):
        if table.qp is not None:
            return np.array(table.qp)
        parts = [
            weights_from(robot, part, f"{key}.{letter}") if part is not None else np.zeros(robot.nv)
            for letter, part in (("q", table.q), ("p", table.p))
        ]
        return np.concatenate(parts)


def _check_targets(robot: Robot, weights: Array, given: BoolArray, key: str, source: str) -> None:
    """Refuse a weight on a component that has no target."""
    if weights.shape != given.shape:
        return  # the class says what is wrong with the length
    missing = np.flatnonzero((weights != 0.0) & ~given)
    if missing.size:
        index = int(missing[0])
        labels = [*robot.v_labels, *robot.p_labels]
        part = "q" if index < robot.nv else "p"
        raise ProblemError(
            f"{key}[{index}]: got {weights[index]:g} on {part} of {labels[index].name!r}, but {source} does "
            f"not say {part} there; add it, or set the weight to 0"
        )
    if not weights.any():
        raise ProblemError(f"{key}: all weights are 0, expected at least one above 0")

"""`[cost]`: the keys of its terms, from what is written to weights and targets, also from files, and back."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbocp._arrays import Array, BoolArray, dataclass
from mbocp._files import MEGABYTE, is_file
from mbocp._keys import Table, keys_of
from mbocp._merged import merge_tables
from mbocp._text import show
from mbocp.exceptions import InvalidValue, ProblemError, locate
from mbocp.problem.file.motion_table import read_columns, read_result
from mbocp.problem.file.named_values import configuration_from, control_from, tangent_from, weights_from
from mbocp.problem.goals.goal import Goal
from mbocp.problem.timeline.phase import Phase
from mbocp.problem.timeline.sequence import are_alike
from mbocp.problem.timeline.times import check_duration
from mbocp.problem.timeline.via import ViaPoint
from mbocp.problem.weights import Cost, further_terms, typical_force, velocity_weight, weights_by_key
from mbocp.robot import Robot
from mbocp.terms.cost import CostTableReader
from mbocp.terms.kinds import COST_TERMS
from mbocp.terms.written import AUTO, WeightsTable

CostTable = merge_tables(
    "CostTable", "What is minimised: the keys of all terms.", (t.Keys for t in COST_TERMS), Table
)

PhaseCostTable = merge_tables(
    "PhaseCostTable", "Weights that differ in a phase.", (t.Keys for t in weights_by_key().values()), Table
)
_KEY = "cost.target_file"
_MAX_BYTES = 256 * MEGABYTE  # of a CSV table


def read_cost(
    cost_table: Any, goals: tuple[Goal, ...], is_cost_left: bool, cost_reader: CostTableReader
) -> Cost:
    """The cost; that of a file without one weighs velocities as suits the motion."""
    table = cost_table.model_copy(update={"velocity": AUTO}) if is_cost_left else cost_table
    if goals and table.tracking and table.target is None and table.target_file is None:
        raise ProblemError("cost.tracking: of several goals none is the target; give cost.target")
    values: dict[str, Any] = {}
    for term in COST_TERMS:
        values |= term.read(table, cost_reader)
    _check_weights_are_given(cost_table)
    further = {key: values.pop(key) for key in further_terms()}
    return Cost(**values, further=further)


def _check_weights_are_given(cost_table: Any) -> None:
    """Refuse keys of terms that do not count, since nobody gave their weights."""
    given = cost_table.model_fields_set
    for name, key in keys_of(CostTable).items():
        value = getattr(cost_table, name)
        says = name in given and value is not None and getattr(value, "model_fields_set", True)
        if key.weight and key.weight not in given and says:
            expected = f"cost.{key.weight}, the weight of the term that it belongs to"
            raise InvalidValue(f"cost.{name}", f"no cost.{key.weight}", expected)


def write_cost(cost: Cost) -> dict[str, Any]:
    """Return the table that reads back as the same."""
    table: dict[str, Any] = {}
    for term in COST_TERMS:
        table |= term.write(cost)
    return table


@dataclass(frozen=True)
class CostReader:
    """From the values of `[cost]` and of those of phases to arrays, see `mbocp.terms.cost.CostTableReader`.

    Its fields have the names of the values that it is made of, see `mbocp.problem.pipeline.Step`.
    """

    robot: Robot
    said_goal: Goal
    folder: Path
    said_duration: float
    said_duration_range: tuple[float, float] | None
    said_via: tuple[ViaPoint, ...]
    phases_unweighted: tuple[Phase, ...]
    said_num_steps: int
    said_q_start: Array
    said_v_start: Array

    def on_controls(self, written: Any, key: str) -> Any:
        """Return weights on the controls, a number or one for each."""
        if type(written) is float:
            return written  # one for all; errors name no control then
        with locate(key):
            return control_from(self.robot, written, key)

    def on_velocities(self, written: Any, key: str) -> Array:
        """Return weights on the velocities of the joints."""
        if written is None:
            return np.zeros(self.robot.nv)
        if written == AUTO:
            goal = self.said_goal
            T, _ = check_duration(self.said_duration, self.said_duration_range)
            ends = (self.said_q_start, self.said_v_start, goal.q, goal.q_active)
            return velocity_weight(self.robot, typical_force(self.robot, *ends, T), T)
        with locate(key):
            return weights_from(self.robot, written, key)

    def targets(self, target: Any, target_file: str | None) -> tuple[Array, Array, BoolArray]:
        """Return the targets of q and p, and which of their components are given."""
        robot, goal = self.robot, self.said_goal
        target_q, given_q = goal.q, goal.q_active
        target_p, given_p = _goal_momentum(robot, goal)
        if target is not None and target_file is not None:
            raise ProblemError("cost: give target or target_file, not both")
        if target is not None:
            target_q, given_q = _target_rows(robot, target.q, "q", goal.q)
            target_p, given_p = _target_rows(robot, target.p, "p", np.zeros(robot.nv))
        elif target_file is not None:
            path = self.folder / target_file
            is_free, is_alike = self.said_duration_range is not None, are_alike(self.phases_unweighted)
            if is_free or any(point.is_free for point in self.said_via) or not is_alike:
                what = "horizon.duration is" if is_free else "via.time is"
                raise ProblemError(
                    f"cost.target_file: a file says when the robot is where, and {what} free; "
                    "give a number there, or cost.target, whose rows belong to the steps"
                )
            target_q, target_p = read_target(path, robot, self.said_duration, self.said_num_steps)
            given_q = given_p = np.ones(robot.nv, dtype=np.bool_)
        return target_q, target_p, np.concatenate([given_q, given_p])

    def goal_says(self) -> BoolArray:
        """Tell which components of (q, rate) the goal gives."""
        return np.concatenate([self.said_goal.q_active, self.said_goal.rate_active])

    def on_states(self, written: WeightsTable | None, default: BoolArray, key: str) -> Array:
        """Return weights on (q, p)."""
        return _weights(self.robot, written, default, key)

    def check_weighed(self, weights: Array, given: BoolArray, key: str, source: str) -> None:
        """Refuse a weight on a component without a target."""
        if source == "the goal" and self.said_goal.frames and not weights.any():
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
    if not given.any():
        weight = key.removesuffix("_weights")
        raise ProblemError(
            f"{weight}: {source} says neither q nor p of a joint; say one there, or leave it out"
        )
    if not weights.any():
        raise ProblemError(f"{key}: all weights are 0, expected at least one above 0")


class _Motion(NamedTuple):
    t: Array
    qs: Array
    ps: Array


def read_target(path: Path, robot: Robot, duration: float, num_steps: int) -> tuple[Array, Array]:
    """Return the target at the end of every step.

    Parameters
    ----------
    path : Path
        A result of ``mbocp solve -o``, or a CSV table with the columns ``t [s]``, ``q:NAME [unit]`` and
        ``p:NAME [unit]`` (as `Solution.to_csv` writes it); the time may be sampled in any way.
    robot : Robot
    duration : float
        [s].
    num_steps : int

    Returns
    -------
    target_q : ndarray, shape (N, nq)
    target_p : ndarray, shape (N, nv)
    """
    if not is_file(path):
        raise ProblemError(f"{_KEY}: no such file {show(str(path))}")
    if path.suffix.lower() == ".csv":
        motion = _read_csv(path, robot)
    else:
        arrays = read_result(path, _KEY).arrays
        motion = _Motion(*(arrays[name] for name in _Motion._fields))
    _check(motion, robot, path, duration)
    times = np.arange(1, num_steps + 1) * (duration / num_steps)
    qs, ps = zip(*(_at(motion, robot, t) for t in times), strict=True)
    return np.array(qs), np.array(ps)


def _read_csv(path: Path, robot: Robot) -> _Motion:
    wanted = ["t", *(f"q:{c.name}" for c in robot.q_labels), *(f"p:{c.name}" for c in robot.p_labels)]

    def choose(names: Sequence[str]) -> list[str]:
        missing = [name for name in wanted if name not in names]
        if missing:
            listed = ", ".join(missing[:6]) + (", ..." if len(missing) > 6 else "")
            known = ", ".join(names[:12])
            raise ProblemError(f"{_KEY}: {path} has no column {listed}; its columns are {known}")
        return wanted

    table = read_columns(path, _KEY, _MAX_BYTES, choose)
    return _Motion(table[:, 0], table[:, 1 : 1 + robot.nq], table[:, 1 + robot.nq :])


def _check(motion: _Motion, robot: Robot, path: Path, duration: float) -> None:
    if motion.t.ndim != 1 or motion.qs.ndim != 2 or motion.ps.ndim != 2:
        raise ProblemError(f"{_KEY}: {path} holds t, q or p of another shape than a row for each time")
    if motion.qs.shape != (len(motion.t), robot.nq) or motion.ps.shape != (len(motion.t), robot.nv):
        raise ProblemError(
            f"{_KEY}: {path} holds q with {motion.qs.shape[-1]} and p with {motion.ps.shape[-1]} columns, "
            f"expected {robot.nq} and {robot.nv} for robot {robot.name!r}"
        )
    if not all(np.isfinite(part).all() for part in motion):
        raise ProblemError(f"{_KEY}: {path} has entries that are not finite")
    if len(motion.t) < 2 or not (np.diff(motion.t) > 0.0).all():
        raise ProblemError(f"{_KEY}: {path} needs at least two rows with increasing times")
    if motion.t[0] > 1e-9 * duration or motion.t[-1] < duration * (1.0 - 1e-9):
        raise ProblemError(
            f"{_KEY}: {path} covers {motion.t[0]:g} to {motion.t[-1]:g} s, expected 0 to {duration:g} s"
        )


def _at(motion: _Motion, robot: Robot, t: float) -> tuple[Array, Array]:
    """Interpolate along the geodesics of the joints."""
    i = int(np.clip(np.searchsorted(motion.t, t, side="right") - 1, 0, len(motion.t) - 2))
    share = min((t - motion.t[i]) / (motion.t[i + 1] - motion.t[i]), 1.0)
    q = robot.integrate(motion.qs[i], share * robot.difference(motion.qs[i], motion.qs[i + 1]))
    p = (1.0 - share) * motion.ps[i] + share * motion.ps[i + 1]
    return q, p

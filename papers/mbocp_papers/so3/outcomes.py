"""What came of the tasks of the lattice: ends, iterations, times and costs, formulation by formulation."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from mbocp._arrays import Array, BoolArray
from mbocp.exceptions import StudyError
from mbocp.study import Spread, StudyResult
from mbocp_papers.so3.data import FORMULATIONS

UPRIGHT, HALF_TURN, ELSEWHERE, NOT_CONVERGED = "upright", "half-turn", "elsewhere", "not converged"
ENDS = (UPRIGHT, HALF_TURN, ELSEWHERE, NOT_CONVERGED)

_TOLERANCE = 1e-6  # [rad] around the upright attitude
_NEAR_HALF_TURN = 1e-3  # [rad]
_QUATERNION = slice(2, 6)  # of the pendulum in a configuration


@dataclass(frozen=True, eq=False)
class Runs:
    """Tasks that one formulation has tried.

    Attributes
    ----------
    label : str
        Of the formulation.
    tasks : ndarray, shape (n,)
        Number of each task within the lattice.
    ends : tuple of str
        How each ended, one of `ENDS`.
    iterations, seconds, cost : ndarray, shape (n,)
        NaN where there is none; time of the solver [s].
    statuses : tuple of str
        Of the solver.
    """

    label: str
    tasks: Array
    ends: tuple[str, ...]
    iterations: Array
    seconds: Array
    cost: Array
    statuses: tuple[str, ...]

    @property
    def is_success(self) -> BoolArray:
        """Which tasks ended upright."""
        return np.array([end == UPRIGHT for end in self.ends], dtype=bool)

    @property
    def success_rate(self) -> float:
        """Part of the tasks that ended upright; NaN without tasks."""
        return float(self.is_success.mean()) if self.ends else math.nan

    @property
    def counts(self) -> Mapping[str, int]:
        """How many ended in each way."""
        found = Counter(self.ends)
        return {end: found[end] for end in ENDS}

    @property
    def failures(self) -> Mapping[str, int]:
        """Statuses of those that did not converge, the most frequent first."""
        pairs = zip(self.ends, self.statuses, strict=True)
        return dict(Counter(status for end, status in pairs if end == NOT_CONVERGED).most_common())

    def spread(self, name: str, only: Array | None = None) -> Spread:
        """Mean and standard deviation over the successes.

        Parameters
        ----------
        name : {"iterations", "seconds", "cost", "milliseconds"}
            The last is the time of an iteration [ms].
        only : ndarray, optional
            Tasks of the lattice to look at.
        """
        chosen = self.is_success
        if only is not None:
            chosen = chosen & np.isin(self.tasks, only)
        if name == "milliseconds":
            chosen = chosen & (self.iterations > 0)
            kept = 1e3 * self.seconds[chosen] / self.iterations[chosen]
        else:
            kept = getattr(self, name)[chosen]
        return Spread.of(kept[np.isfinite(kept)].tolist())


@dataclass(frozen=True, eq=False)
class Outcomes:
    """All that a file of rows says.

    Attributes
    ----------
    runs : tuple of Runs
        In the paper's order; only formulations that have rows.
    num_tasks : int
        Tasks of the whole study, each formulation's.
    is_complete : bool
        Whether every task has a row.
    solver, variant : str
    """

    runs: tuple[Runs, ...]
    num_tasks: int
    is_complete: bool
    solver: str
    variant: str

    @cached_property
    def common(self) -> Array:
        """Tasks in which every formulation succeeded."""
        sets = [set(runs.tasks[runs.is_success].tolist()) for runs in self.runs]
        return np.array(sorted(set.intersection(*sets)) if sets else [], dtype=np.int64)

    @property
    def words(self) -> str:
        """What the numbers are over."""
        done = sum(len(runs.ends) for runs in self.runs)
        count = f"{done}" if self.is_complete else f"{done} of {self.num_tasks}"
        return f"{count} tasks, {self.solver}, {self.variant.replace('_', ' ')}"


def outcomes_of(result: StudyResult) -> Outcomes:
    """Read rows of a study made by `lattice_study`.

    Raises
    ------
    StudyError
        If the rows are of another study, or there are none.
    """
    if "formulation" not in result.header["varied"] or "q_final" not in result.header["record"]:
        raise StudyError(
            f"{result.name!r} is no study of the second paper's lattice: it varies "
            f"{', '.join(result.header['varied'])}; run examples/so3/lattice.toml"
        )
    if not len(result):
        raise StudyError("there are no rows yet, and nothing to show")
    by_label: dict[str, list[Mapping[str, Any]]] = {}
    for row in result.rows:
        by_label.setdefault(str(row["values"]["formulation"]), []).append(row)
    known = [one.label for one in FORMULATIONS]
    labels = [label for label in known if label in by_label] + [x for x in by_label if x not in known]
    problem = result.header["tables"]["problem"]
    (axis,) = result.header["tables"]["axis"]
    return Outcomes(
        runs=tuple(_runs(label, by_label[label], len(axis["values"])) for label in labels),
        num_tasks=result.num_tasks,
        is_complete=result.is_complete,
        solver=_solver(problem),
        variant="as_printed" if problem.get("goal", {}).get("redundant") == "keep" else "corrected",
    )


def turn_from_upright(q: Sequence[float]) -> float:
    """Angle between the pendulum and its upright attitude in a configuration of the unicycle [rad]."""
    x, y, z, w = np.asarray(q, dtype=float)[_QUATERNION]
    return float(2.0 * np.arctan2(np.linalg.norm([x, y, z]), abs(w)))


def running_mean(runs: Runs, name: str, seed: int = 0) -> Array:
    """Mean over the first n successes in a random order, n = 1, 2, ...: Figure 3."""
    values = getattr(runs, name)[runs.is_success]
    order = np.random.default_rng(seed).permutation(len(values))
    means: Array = np.cumsum(values[order]) / np.arange(1, len(values) + 1)
    return means


def settled_after(means: Array, share: float = 0.04) -> int:
    """Number of tests from which on a running mean stays within a share of its last value."""
    if not len(means):
        return 0
    outside = np.flatnonzero(np.abs(means - means[-1]) > share * abs(means[-1]))
    return int(outside[-1]) + 2 if outside.size else 1


def _runs(label: str, rows: Sequence[Mapping[str, Any]], formulations: int) -> Runs:
    def numbers(name: str) -> Array:
        return np.array([math.nan if row[name] is None else row[name] for row in rows], dtype=float)

    return Runs(
        label=label,
        tasks=np.array([row["index"] // formulations for row in rows], dtype=np.int64),
        ends=tuple(_end(row) for row in rows),
        iterations=numbers("iterations"),
        seconds=numbers("solver_time_s"),
        cost=numbers("cost"),
        statuses=tuple(str(row["status"]) for row in rows),
    )


def _end(row: Mapping[str, Any]) -> str:
    q = row.get("record", {}).get("q_final")
    if not row["converged"] or q is None:
        return NOT_CONVERGED
    turn = turn_from_upright(q)
    if turn <= _TOLERANCE:
        return UPRIGHT
    return HALF_TURN if abs(turn - math.pi) <= _NEAR_HALF_TURN else ELSEWHERE


def _solver(problem: Mapping[str, Any]) -> str:
    solver = problem.get("solver", "auto")
    return str(solver.get("method", "auto") if isinstance(solver, Mapping) else solver)

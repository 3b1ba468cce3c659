"""The verdict on a solution."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import numpy as np

from tests.checker.clearance import centers, missing
from tests.checker.conditions import Conditions, Motion, joint_conditions, natural_conditions
from tests.checker.optimality import stationarity
from tests.checker.system import System
from tests.checker.task import Task

__all__ = ["TOLERANCES", "Report", "check_solution"]

# A solver stops at residuals of 1e-9 on its own scales; these are on the checker's.
TOLERANCES = {
    "start": 1e-12,  # of the state
    "step": 1e-7,  # of the terms that cancel in a step
    "constraint": 1e-8,  # m, rad, m^2
    "end": 1e-7,  # of rad and m; velocities of the largest speed
    "limits": 1e-6,  # of the limit
    "cost": 1e-9,  # relative
    "stationarity": 1e-4,  # of the terms that cancel in the gradient; the cost is off by the square of it
    "complementarity": 1e-4,  # of the cost
}


@dataclass(frozen=True)
class Report:
    """Each measure with its tolerance in `TOLERANCES`."""

    start: float
    step: float
    constraint: float
    end: float
    limits: float
    cost: float
    stationarity: float
    complementarity: float
    multipliers: str
    active: int

    @property
    def failures(self) -> tuple[str, ...]:
        """Measures that are above their tolerance, or no number at all."""
        return tuple(name for name, bound in TOLERANCES.items() if not getattr(self, name) <= bound)

    @property
    def holds(self) -> bool:
        return not self.failures

    def to_dict(self) -> dict[str, object]:
        return asdict(self)


def check_solution(system: System, task: Task, motion: Motion) -> Report:
    """Verify a motion: start, steps, constraints, end, limits, cost and first-order optimality."""
    if not all(np.isfinite(a).all() for a in (motion.qs, motion.vs, motion.us)):
        return Report(*(np.nan,) * len(TOLERANCES), "", 0)
    if task.duration_range is not None:
        task = replace(task, duration=motion.duration)
    system.choose_rows(task.q_start)
    build = natural_conditions if task.coordinates == "natural" else joint_conditions
    conditions: Conditions = build(system, task, motion)
    found = stationarity(conditions)
    start = max(
        float(np.abs(system.away(task.q_start, motion.qs[0])).max()),
        _start_velocity(system, task, motion),
    )
    violated = max((b.value / b.scale for b in conditions.bounds), default=0.0)
    violated = max(violated, missing(task, centers(system, task.balls, motion.qs[1:])))
    size = max(abs(conditions.cost), 1e-300)
    return Report(
        start=start,
        step=conditions.residual,
        constraint=conditions.constraint,
        end=conditions.end,
        limits=max(violated, 0.0),
        cost=abs(conditions.cost - motion.cost) / size,
        stationarity=found.residual,
        complementarity=found.complementarity,
        multipliers=found.source,
        active=found.active,
    )


def _start_velocity(system: System, task: Task, motion: Motion) -> float:
    """SE2 begins with a velocity that reaches the loops' next position; drives jump with their control."""
    if system.drives or (task.scheme == "se2" and system.nc) or task.coordinates == "natural":
        return 0.0
    return float(np.abs(motion.vs[0] - task.v_start).max()) / max(1.0, float(np.abs(task.v_start).max()))

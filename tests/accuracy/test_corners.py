"""Costs of motions that come to a limit within a step: no order is seen in them."""

from __future__ import annotations

import math

from mbocp import Problem
from mbocp.accuracy.rounds import Round
from mbocp.job import Job
from mbocp.strategies import OneSolve

COST = 0.05922544  # of 768 steps; 192 differ by 2e-5


def test_the_error_at_a_velocity_limit_is_not_below_the_truth() -> None:
    """Differences of costs with 12, 24 and 48 steps grow, and the last is less than what is missing."""
    problem = Problem.create(
        "double_pendulum",
        1.5,
        12,
        start={"q": [-0.2, -0.06]},
        goal={"q": [-1.02, 0.7], "v": 0},
        controls="linear",
        cost={"effort": 1.0},
        limits={"velocity": 0.63},
    )
    at_nodes = OneSolve()  # without limits that hold within steps, which these are too coarse for
    coarsest, coarse, fine = (at_nodes.run(Job.of(problem.with_(num_steps=n))) for n in (12, 24, 48))
    assert any(limit.kind == "velocity" for limit in fine.active_limits)
    found = Round.of(
        problem.with_(accuracy=0.1), problem.with_(num_steps=48), (coarse, fine), deadline=math.inf
    ).compare_with([coarsest], None)
    true = abs(fine.cost - COST)
    assert abs(fine.cost - coarse.cost) < true <= found.error < 10.0 * true
    assert abs(found.limit.value - COST) <= found.limit.unsure

"""Speeds of tools, tubes and cones between nodes: kept there, or told with what is left."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.formulation import formulate
from mbocp.job import Job
from mbocp.problem import Problem
from mbocp.solution import Status
from mbocp.solution.curves import Curves
from mbocp.strategies import OneSolve
from tests.formulation.stages import check_derivatives

SLOW = {"name": "slow", "kind": "speed", "frame": "link2", "max": 0.25}
DRAG = {
    "kind": "follow",
    "frame": "link2",
    "points": [[0, 0, 0], [0.02, 0, 0.01], [0.03, 0, 0.02]],
    "relative": True,
    "tolerance": 0.002,
    "min": 0.1,
    "max": 3.0,
    "until": {"share": 0.5},
}


def swing(controls: str = "stages", steps: int = 24, **path: Any) -> Problem:
    """A double pendulum that has to hurry, whose elbow may not."""
    return Problem.create(
        mbocp.load_robot("double_pendulum", damping=False),
        {"min": 0.1, "max": 3.0, "guess": 1.2},
        steps,
        goal={"q": [0.8, -0.8], "v": 0},
        path=[{**SLOW, **path}],
        cost={"time": 1.0, "effort": 1e-3},
        limits={"velocity": 10.0, "effort": 20.0},
        scheme="gauss2",
        controls=controls,
    )


def fastest(problem: Problem, s: mbocp.Solution) -> float:
    """Of the elbow, along the cubics through the nodes, a thousand times a second [m/s]."""
    model, data = problem.robot.model, problem.robot.model.createData()
    frame = model.getFrameId("link2")
    q, v, *_ = Curves(s.t, s.qs, s.vs).at(np.arange(s.t[0], s.t[-1], 1e-3))
    found = []
    for at in zip(q, v, strict=True):
        pin.forwardKinematics(model, data, *at)
        found.append(np.linalg.norm(pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear))
    return float(max(found))


@pytest.fixture(scope="module")
def problem() -> Problem:
    return swing()


@pytest.fixture(scope="module")
def kept(problem: Problem) -> mbocp.Solution:
    return mbocp.solve(problem, check=True)


def test_a_speed_that_is_left_between_nodes_is_told_with_its_time(problem: Problem) -> None:
    alone = OneSolve().run(Job.of(problem))
    assert alone.limit_violation < 1e-6
    assert alone.status is Status.UNDER_RESOLVED
    assert alone.limit_excess_of == "path constraint slow"
    assert f"between nodes the path constraint slow is {fastest(problem, alone):.1f}"[:-1] in alone.advice
    assert alone.limit_excess == pytest.approx(fastest(problem, alone) / 0.25 - 1.0, rel=0.1)
    assert "take more steps" in alone.advice


def test_it_is_kept_there(problem: Problem, kept: mbocp.Solution, tmp_path: Path) -> None:
    """To a hundredth, as a motion is sent; a warm start begins with what it kept."""
    assert fastest(problem, kept) < 1.01 * 0.25
    assert kept.path_names[:2] == ("slow", "slow within steps, first coefficient")
    assert kept.lam_path.shape == (kept.num_steps, 5)
    assert "slow within steps, third coefficient" in {limit.name for limit in kept.active_limits}
    read = mbocp.Solution.load(kept.save(tmp_path / "slow.h5"))
    assert mbocp.solve(problem, warm_start=read, check=True).iterations <= 1


def test_multipliers_are_what_the_cost_gains_from_a_wider_bound(kept: mbocp.Solution) -> None:
    costs = [mbocp.solve(swing(max=0.25 + h), warm_start=kept, check=True).cost for h in (-1e-4, 1e-4)]
    assert -kept.lam_path.sum() == pytest.approx((costs[1] - costs[0]) / 2e-4, rel=1e-2)


@pytest.mark.parametrize("controls", ["constant", "linear"])
def test_constant_speeds_hold_within_steps(controls: str) -> None:
    window = {"min": 0.25, "from": {"share": 0.25}, "until": {"share": 0.75}}
    problem = swing(controls, 16, **window)
    s = mbocp.solve(problem)
    assert s.converged or (s.limit_excess_of == "path constraint slow" and s.limit_excess < 0.1)
    held = replace(problem, limits_within="p")
    check_derivatives(formulate(held), 5, [0, 2])


def test_tubes_and_cones_about_a_path_have_rows_within_steps() -> None:
    problem = swing(steps=6).with_(path=[DRAG], limits={})
    check_derivatives(formulate(replace(problem, limits_within="p")), 2, [0, 3, -1])

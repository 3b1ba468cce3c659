"""Loads of motors, against sums over fine samples of the motion."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.cli.solution_summary import solution_rows
from mbocp.solution import loads_of

EXAMPLES = Path(__file__).parents[2] / "examples"


def powers_of_flow(s: mbocp.Solution, robot: mbocp.Robot, parts: int = 100) -> np.ndarray:
    """Powers along the flow of an arm from each node, at the middles of parts of its step."""
    data = robot.model.createData()
    found, h = [], s.duration / s.num_steps / parts
    for n, (q, v) in enumerate(zip(s.qs[:-1], s.vs[:-1], strict=True)):
        for u in s.controls_at(s.t[n] + (np.arange(parts) + 0.5) * h):
            half = v + h / 2.0 * pin.aba(robot.model, data, q, v, u)
            q_half = robot.integrate(q, h / 2.0 * v)
            found.append(u * half)
            v = v + h * pin.aba(robot.model, data, q_half, half, u)
            q = robot.integrate(q, h * half)
    return np.array(found)


@pytest.mark.parametrize("controls", ["constant", "linear"])
def test_root_mean_squares_are_those_of_fine_samples(controls: str) -> None:
    problem = mbocp.load_problem(EXAMPLES / "arms" / "ur5_reach.toml").with_(controls=controls, steps=20)
    s, robot = mbocp.solve(problem), problem.robot
    middles = (np.arange(40_000) + 0.5) * s.duration / 40_000
    fine = s.controls_at(middles)
    loads = loads_of(s, robot)
    assert [load.name for load in loads] == list(robot.joint_names)
    np.testing.assert_allclose([load.rms for load in loads], np.sqrt((fine**2).mean(axis=0)), rtol=1e-7)
    ends = np.vstack([s.controls_at(s.t[:-1]), s.us_at_ends])
    np.testing.assert_allclose([load.largest for load in loads], np.abs(ends).max(axis=0))
    flows = powers_of_flow(s, robot)
    for sign, peaks, energies in (
        (1.0, [load.power for load in loads], [load.work for load in loads]),
        (-1.0, [load.braking for load in loads], [load.braked for load in loads]),
    ):
        given = (sign * flows).clip(0.0)
        np.testing.assert_allclose(peaks, given.max(axis=0), rtol=0.03)
        np.testing.assert_allclose(energies, given.mean(axis=0) * s.duration, rtol=5e-3)
    assert sum(load.work for load in loads) == pytest.approx(s.positive_work)
    assert math.isnan(s.drawn_energy)
    rows = {name: str(words).split(", ")[1] for name, words in solution_rows(s, "") if "effort" in name}
    assert rows == {
        "rms effort": f"shoulder_lift_joint {loads[1].rms:.4g} N m",
        "peak effort": f"shoulder_lift_joint {loads[1].largest:.4g} N m",
    }


def test_an_impact_takes_no_time() -> None:
    problem = mbocp.load_problem(EXAMPLES / "arms" / "lift_and_place.toml")
    s = mbocp.solve(problem)
    loads = loads_of(s, problem.robot)
    assert all(0.0 < load.rms <= load.largest for load in loads)


def test_controls_that_prescribe_a_motion_have_no_power() -> None:
    problem = mbocp.load_problem(EXAMPLES / "arms" / "ur5_reach.toml")
    kinematic = mbocp.Problem.create(
        mbocp.load_robot("ur5", dynamics=False), goal={"q": problem.goal.q, "v": 0.0}, duration=2.0, steps=20
    )
    s = mbocp.solve(kinematic)
    loads = loads_of(s, kinematic.robot)
    assert all(math.isnan(load.power) and math.isnan(load.braking) for load in loads)
    assert loads[0].unit == "rad/s^2"
    assert all(load.rms > 0.0 for load in loads if load.largest > 0.0)
    assert not {"rms effort", "peak effort", "energy"} & set(dict(solution_rows(s, "")))

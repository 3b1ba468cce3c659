"""The robots with closed loops: degrees of freedom, redundant rows, and loops that close."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import mbocp
from mbocp.robot import Robot, describe

EXAMPLES = Path(__file__).parents[3] / "examples" / "loops"


class Expected(NamedTuple):
    """What a mechanism is by its geometry: mobility, rows of its constraints, and how many are redundant."""

    mobility: int
    rows: int
    redundant: int
    passive: int  # joints without a motor


LOOPS = {
    "four_bar": Expected(1, 5, 3, 2),
    "slider_crank": Expected(1, 3, 1, 2),
    "five_bar": Expected(2, 5, 3, 2),
    "parallelogram_arm": Expected(2, 5, 3, 2),
    "delta": Expected(3, 18, 3, 10),
    "stewart": Expected(6, 18, 0, 13),
}


@pytest.fixture(params=LOOPS)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def robot(name: str) -> Robot:
    return mbocp.load_robot(name)


def nearby(robot: Robot, count: int, size: float = 0.1) -> list[np.ndarray]:
    """Configurations with closed loops around the initial one."""
    rng = np.random.default_rng(7)
    return [
        robot.assemble(robot.integrate(robot.q0, size * rng.standard_normal(robot.nv))) for _ in range(count)
    ]


def test_degrees_of_freedom_and_redundant_rows(name: str, robot: Robot) -> None:
    expected, told = LOOPS[name], describe(robot)
    assert told["mobility"] == expected.mobility == robot.nu
    assert len(told["passive"]) == expected.passive
    assert sum(len(c["rows"]) for c in told["constraints"]) == expected.rows
    assert sum(len(c["redundant_rows"]) for c in told["constraints"]) == expected.redundant
    assert robot.nc == expected.rows - expected.redundant == robot.nv - expected.mobility


def test_the_initial_pose_closes_every_row(robot: Robot) -> None:
    assert np.abs(robot.closure_residual(robot.q0)).max() < 1e-12


def test_kept_rows_are_independent_and_imply_the_others(robot: Robot) -> None:
    for q in nearby(robot, 4):
        kept, every = robot.constraint_jacobian(q), robot.closure_jacobian(q)
        assert np.linalg.svd(kept, compute_uv=False).min() > 1e-3
        assert np.linalg.matrix_rank(every, tol=1e-9) == robot.nc
        assert np.abs(robot.closure_residual(q)).max() < 1e-10


def test_motors_drive_every_motion(robot: Robot) -> None:
    """Motions along the constraints at which no motor turns would be out of control."""
    driven = np.abs(robot.actuation.selection).sum(axis=1) > 0
    for q in nearby(robot, 4):
        _, singular, vt = np.linalg.svd(robot.constraint_jacobian(q))
        motions = vt[np.count_nonzero(singular > 1e-9) :].T
        assert np.linalg.svd(motions[driven], compute_uv=False).min() > 1e-2


def test_delta_keeps_its_platform_level() -> None:
    robot = mbocp.load_robot("delta")
    at = robot.configuration_indices("platform")
    for q in nearby(robot, 4):
        np.testing.assert_allclose(q[at][3:], [0, 0, 0, 1], atol=1e-9)


def test_parallelogram_turns_the_forearm_with_the_crank() -> None:
    robot = mbocp.load_robot("parallelogram_arm")
    for q in nearby(robot, 4):
        angle = {joint: q[robot.configuration_indices(joint)][0] for joint in robot.joint_names}
        assert angle["crank"] == pytest.approx(angle["shoulder"] + angle["elbow"], abs=1e-9)


def test_legs_of_the_stewart_platform_reach_its_balls() -> None:
    robot = mbocp.load_robot("stewart")
    q = robot.assemble(robot.q0)
    legs = [q[robot.configuration_indices(f"leg_{i}")][0] for i in range(1, 7)]
    assert np.ptp(legs) < 1e-9  # level and in the middle: all of one length


def test_examples_start_and_end_closed(name: str) -> None:
    problem = mbocp.load_problem(EXAMPLES / f"{name}.toml")
    for q in (problem.q_start, problem.goal.q):
        assert np.abs(problem.robot.closure_residual(q)).max() < 1e-8
    assert np.abs(problem.robot.constraint_residual(problem.goal.q)).max() < 1e-10
    moved = problem.robot.difference(problem.q_start, problem.goal.q)
    assert np.abs(moved).max() > 0.1
    assert not problem.v_start.any()
    assert not problem.goal.value.any()

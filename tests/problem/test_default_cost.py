"""A problem without [cost]: robot, start, goal and horizon alone give a motion that one would run."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.exceptions import ProblemFileError
from mbocp.solvers import Status

SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("panda", "z1", "baxter")]  # to compile


def poses(robot: mbocp.Robot) -> tuple[np.ndarray, np.ndarray]:
    """Two poses within the limits, each joint a radian from one to the other where it has so much room."""
    lower, upper = robot.limits.position_lower, robot.limits.position_upper
    lower, upper = np.maximum(lower, -2.0), np.minimum(upper, 2.0)
    middle, room = (lower + upper) / 2, np.minimum(0.25 * (upper - lower), 0.5)
    signs = np.where(np.arange(robot.nq) % 2 == 0, 1.0, -1.0)
    unbounded = [slice(at, at + 2) for at in range(robot.nq - 1) if robot.q_labels[at].unit == ""]
    q0, q1 = middle - signs * room, middle + signs * room
    for pair in unbounded[::2]:
        q0[pair], q1[pair] = (math.cos(0.5), -math.sin(0.5)), (math.cos(0.5), math.sin(0.5))
    return q0, q1


@pytest.mark.parametrize("duration", [1.0, 4.0])
@pytest.mark.parametrize("name", ["kinova", *SLOW])
def test_the_first_problem_that_one_writes_gives_a_motion_that_one_would_run(name, duration):
    robot = mbocp.load_robot(name, friction="none")
    q0, q1 = poses(robot)
    solution = mbocp.solve(mbocp.Problem.create(robot, duration, 50, start={"q": q0}, goal={"q": q1, "v": 0}))
    assert solution.status is Status.CONVERGED, solution.advice
    moved = np.array([robot.difference(a, b) for a, b in zip(solution.qs[:-1], solution.qs[1:], strict=True)])
    straight = np.abs(robot.difference(q0, q1))
    assert (np.abs(moved).sum(axis=0) < straight + 1.0).all()  # no detour of a radian
    assert np.abs(moved).max() < 0.1


def arm(**options: object) -> mbocp.Problem:
    return mbocp.Problem.create("ur5", 2.0, 50, goal={"q": [0.5, -1, 1, 0, 0.5, 0], "v": 0}, **options)


def test_the_weight_is_a_tenth_of_force_times_duration_squared():
    """The force is that of gravity, here in a stretched pose: the arm's weight by half its reach, or so."""
    problem = arm(start={"q": [0.0] * 6})
    weights, robot = problem.cost.velocity, problem.robot
    held = np.abs(pin.computeGeneralizedGravity(robot.model, robot.model.createData(), np.zeros(6))).max()
    assert held > 50.0
    assert weights == pytest.approx(np.full(6, 0.1 * (held * 2.0) ** 2))
    assert np.array_equal(arm(start={"q": [0.0] * 6}, cost={"velocity": "auto"}).cost.velocity, weights)
    assert np.array_equal(problem.with_(num_steps=20).cost.velocity, weights)


@pytest.mark.parametrize("cost", [{}, {"effort": 1.0}, {"effort": 2.0, "control_rate": 1e-3}])
def test_a_cost_that_is_written_means_what_it_says(cost):
    assert not arm(cost=cost).cost.velocity.any()
    assert not arm().with_(cost=cost).cost.velocity.any()


def test_heavier_robots_move_alike(tmp_path):
    """The weight counts in the square of forces: ten times the mass changes no motion."""
    found = []
    for mass in (1.0, 10.0):
        file = tmp_path / f"arm_{mass:g}.urdf"
        file.write_text(URDF.format(mass=mass, inertia=0.1 * mass))
        problem = mbocp.Problem.create(str(file), 1.0, 40, goal={"q": [1.0, 0.5], "v": 0})
        found.append((problem.cost.velocity, mbocp.solve(problem).qs))
    assert found[1][0] == pytest.approx(100.0 * found[0][0])
    assert found[1][1] == pytest.approx(found[0][1], abs=1e-8)


URDF = """
<robot name="two_links"><link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.5"/><mass value="{mass}"/>
    <inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 0.5"/><mass value="{mass}"/>
    <inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="joint1" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="1 0 0"/>
    <limit lower="-9" upper="9" effort="99" velocity="99"/></joint>
  <joint name="joint2" type="revolute"><parent link="upper"/><child link="lower"/><axis xyz="1 0 0"/>
    <origin xyz="0 0 1"/><limit lower="-9" upper="9" effort="99" velocity="99"/></joint>
</robot>
"""


def test_drives_and_terms_of_ones_own_get_no_weight():
    reached = mbocp.load_problem("examples/so3/unicycle_pendulum.toml")
    assert reached.robot.drives
    bare = mbocp.Problem.create(
        reached.robot, 1.0, 20, start={"q": reached.q_start}, goal={"q": reached.goal.q}, scheme="heun"
    )
    assert not bare.cost.velocity.any()


def test_other_words_than_auto_are_refused():
    with pytest.raises(ProblemFileError, match=r"cost\.velocity"):
        arm(cost={"velocity": "automatic"})


@pytest.mark.parametrize("duration", [0, -1.0, math.nan])
def test_a_duration_that_is_none_is_refused_before_it_divides(duration):
    with pytest.raises(ProblemFileError, match=r"horizon\.duration"):
        mbocp.Problem.create("double_pendulum", duration, 20, goal={"q": [1, 0], "v": 0})

"""Start and goal of mechanisms with closed loops: what follows from what is written, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp.cli.app import app
from mbocp.exceptions import (
    InconsistentStart,
    LoopNotClosed,
    MbocpError,
    OverdeterminedGoal,
    UnreachableGoal,
)
from mbocp.mechanisms.closed_path import find_closed_path
from mbocp.problem import Problem, ProblemWarning, load_problem
from mbocp.robot import load_robot
from tests.robot.loops import builders as loops

Load = Callable[..., Problem]

FILE = """
robot = "./{}"
[horizon]
duration = 1.0
steps = 20
[start.q]
crank = 1.0
[goal]
v = [0, 0, 0]
[goal.q]
crank = 2.0
"""
POSED = loops.MOTOR + loops.OPEN_POSE
FOUR_BAR = loops.four_bar()
PARALLELOGRAM = FOUR_BAR.replace(f'xyz="{loops.GROUND} 0 0"', f'xyz="{loops.COUPLER} 0 0"').replace(
    f'xyz="{loops.ROCKER} 0 0"', f'xyz="{loops.CRANK} 0 0"'
)
GEAR = '[[constraint]]\ntype = "coupling"\njoints = ["crank", "rockr"]\n'
ROBOTS = {  # name: URDF, robot.toml
    "four_bar": (FOUR_BAR, POSED + loops.HINGE),
    "parallelogram": (
        PARALLELOGRAM,
        loops.MOTOR + "[initial]\nq = { crank = 1, coupler = -1, rocker = 1 }\n" + loops.HINGE,
    ),
    "torn": (FOUR_BAR.replace(f'xyz="{loops.GROUND} 0 0"', 'xyz="1.9 0 0"'), loops.HINGE),
    "passive": (FOUR_BAR, "[actuation]\njoints = []\n[initial]\nq = { crank = 1.0 }\n" + loops.HINGE),
    "twice": (FOUR_BAR, POSED + loops.HINGE + loops.HINGE.replace('"pin"', '"bolt"')),
    "no_frame": (FOUR_BAR, POSED + loops.HINGE.replace("coupler_end", "coupler_tip")),
    "no_joint": (FOUR_BAR, POSED + loops.HINGE + GEAR),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = tmp_path_factory.mktemp("loops")
    for name, (urdf, toml) in ROBOTS.items():
        (base / name).mkdir()
        (base / name / "robot.urdf").write_text(urdf)
        (base / name / "robot.toml").write_text(toml)
    return base


@pytest.fixture
def load(folder: Path) -> Load:
    def loader(*overrides: str, robot: str = "four_bar") -> Problem:
        path = folder / "problem.toml"
        path.write_text(FILE.format(robot))
        return load_problem(path, list(overrides))

    return loader


# What follows


def test_joints_that_are_not_written_are_found(load: Load) -> None:
    problem = load()
    robot = problem.robot
    for q, crank in ((problem.q_start, 1.0), (problem.goal.q, 2.0)):
        assert q[robot.configuration_indices("crank")] == crank
        np.testing.assert_allclose(robot.closure_residual(q), 0.0, atol=1e-12)
    np.testing.assert_array_equal(problem.goal.q_active, [True, False, False])
    assert problem.num_end_conditions == 2  # one degree of freedom: position and velocity


@pytest.mark.parametrize("turns", [1, -1])
def test_a_goal_of_a_driven_joint_may_be_full_turns_away(load: Load, turns: int) -> None:
    problem = load(f"goal.q.crank={1.0 + 2 * np.pi * turns}")
    moved = problem.goal.q - problem.q_start
    np.testing.assert_allclose(moved, 2 * np.pi * turns * np.array([1.0, -1.0, 0.0]), atol=1e-9)


def test_what_is_written_in_full_moves_only_on_demand(load: Load) -> None:
    near = "q=[1.0,-0.5,1.6]"
    said = r"start\.q: violates constraint 'pin\.x' of robot 'four_bar' by .* m .*start\.assemble = true"
    with pytest.raises(InconsistentStart, match=said):
        load(f"start.{near}")
    with pytest.raises(InconsistentStart, match=said.replace("start", "goal")):
        load(f"goal.{near}")
    problem = load(f"start.{near}", "start.assemble=true", f"goal.{near}", "goal.assemble=true")
    robot = problem.robot
    np.testing.assert_allclose(problem.q_start, robot.assemble([1.0, -0.5, 1.6]), atol=1e-12)
    np.testing.assert_allclose(problem.goal.q, problem.q_start, atol=1e-12)


def test_velocities_that_are_not_written_follow(load: Load) -> None:
    problem = load("start.v={crank=1.0}")
    robot, v = problem.robot, problem.v_start
    assert v[robot.velocity_indices("crank")] == 1.0
    np.testing.assert_allclose(robot.constraint_jacobian(problem.q_start) @ v, 0.0, atol=1e-12)


@pytest.mark.parametrize("key", ["v", "p"])
def test_velocities_that_violate_the_constraints(load: Load, key: str) -> None:
    with pytest.raises(
        InconsistentStart, match=r"start: violates constraint 'pin\.x' .* m/s .*start\.assemble = true"
    ):
        load(f"start.{key}=[1.0,0,0]")
    problem = load(f"start.{key}=[1.0,0,0]", "start.assemble=true")
    robot, v = problem.robot, problem.v_start
    np.testing.assert_allclose(robot.constraint_jacobian(problem.q_start) @ v, 0.0, atol=1e-12)
    given = np.array([1.0, 0.0, 0.0])
    wanted = given if key == "v" else robot.velocity_from_momentum(problem.q_start, given)
    np.testing.assert_allclose(v, robot.assemble_velocity(problem.q_start, wanted), atol=1e-12)


def test_a_goal_in_full_velocity_that_violates_the_constraints(load: Load) -> None:
    with pytest.raises(InconsistentStart, match=r"goal\.v: no motion on the constraints of robot 'four_bar'"):
        load("goal.v=[1.0,0,0]")
    value = load("goal.v=[1.0,0,0]", "goal.assemble=true").goal.value
    np.testing.assert_array_less(0.1, np.abs(value))


# What is refused


def test_a_start_at_which_the_loops_cannot_be_closed(load: Load) -> None:
    with pytest.raises(
        LoopNotClosed,
        match=r"start\.q: robot 'four_bar': the loops cannot be closed with 'rocker' held.*'pin",
    ):
        load("start.q={rocker=0.2}")


UNREACHABLE = {
    # of a joint: nowhere, or not in this mode
    "goal.q={rocker=0.2}": (
        InconsistentStart,
        r"goal\.q: no configuration .*'pin' is stretched .*'rocker' can go no farther .*'rocker'$",
    ),
    "goal.q={rocker=4.5}": (UnreachableGoal, r"out of reach in the start's assembly mode .*'rocker'"),
    # in full: the mirror image, and the start itself with a turn too many
    "goal.q=[1,0.6,-1.6]": (UnreachableGoal, r"another assembly mode of robot 'four_bar'.*\('pin'\)"),
    "goal.q=[1,-0.551,7.883]": (UnreachableGoal, r"whole turns away .* with rocker = 1\.599\d+ is in"),
}


@pytest.mark.parametrize("goal", UNREACHABLE)
def test_goals_out_of_reach(load: Load, goal: str) -> None:
    error, message = UNREACHABLE[goal]
    if "=[1,0.6" in goal:  # mirrored about the line from the crank's end to the ground pin
        robot = load().robot
        x, z = np.array([loops.GROUND - loops.CRANK * np.cos(1.0), -loops.CRANK * np.sin(1.0)])
        q = robot.q0.copy()
        about = np.arctan2(z, x)
        q[1] = 2 * about - (robot.q0[0] + robot.q0[1]) - 1.0
        q[2] = 2 * about - robot.q0[2] + 2 * np.pi
        np.testing.assert_allclose(robot.closure_residual(q), 0.0, atol=1e-12)
        goal = f"goal.q={q.tolist()}"
    with pytest.raises(error, match=message):
        load(goal, "goal.assemble=true") if "551" in goal else load(goal)


@pytest.mark.parametrize("angle", [2e5, -1e8])
def test_what_is_far_too_far_is_refused_at_once(load: Load, angle: float) -> None:
    said = rf"crank is {abs(angle):.0e}.* rad from .* of robot 'four_bar', .* over 300 rad at most".replace(
        "+", r"\+"
    )
    with pytest.raises(InconsistentStart, match=r"start\.q: " + said):
        load(f"start.q.crank={angle}")
    with pytest.raises(UnreachableGoal, match=r"goal\.q: " + said):
        load(f"goal.q.crank={angle}")
    with pytest.raises(UnreachableGoal, match=r"goal\.q: " + said):
        load(f"goal.q.crank={angle}", "goal.assemble=true")


def test_a_guess_leads_no_such_way(load: Load) -> None:
    """A penalty may ask for anything."""
    problem = load()
    far = problem.goal.q + np.array([1e5, 0.0, 0.0])
    assert find_closed_path(problem.robot, problem.q_start, far, np.linspace(0.0, 1.0, 21)) is None


def test_a_goal_behind_a_detour_is_in_reach(load: Load) -> None:
    """A parallelogram becomes an antiparallelogram where it is flat, at crank = 0."""
    robot = load(robot="parallelogram").robot
    crossed = robot.assemble([1.0, -1.75, -1.75], fixed=["crank"])
    assert crossed[2] < -1.0
    problem = load(f"goal.q={crossed.tolist()}", robot="parallelogram")
    np.testing.assert_array_equal(problem.goal.q, crossed)


def test_a_singular_start_is_told(load: Load) -> None:
    with pytest.warns(ProblemWarning, match=r"start\.q: in this pose of robot .* constraint 'pin\.x' holds"):
        load("start.q={crank=0.0}", robot="parallelogram")


def test_a_singular_goal_is_told_or_refused(load: Load) -> None:
    with pytest.raises(OverdeterminedGoal, match=r"2 independent .* on 1 degree of freedom: in this pose"):
        load("goal.q={crank=0.0}", robot="parallelogram")
    with pytest.warns(ProblemWarning, match=r"goal\.q: in this pose .* holds nothing; the solver may stop"):
        load("goal.q={crank=0.0}", "goal.v={crank=0.0}", robot="parallelogram")


def test_a_motion_through_a_singular_pose_is_told(load: Load) -> None:
    solution = mbocp.solve(load("goal.q.crank=-1.0", robot="parallelogram"))
    assert "a singular configuration " in solution.advice
    assert "there the constraint 'pin.x' holds nothing" in solution.advice
    assert "singular" not in mbocp.solve(load(robot="parallelogram")).advice


BAD_ROBOTS = {
    "torn": "the loops cannot be closed: the nearest configuration violates 'pin.x' by -1.4 m",
    "twice": "constraint 'bolt' is a duplicate: 'pin' implies it; take it out",
    "no_frame": "constraint 'pin': robot 'no_frame' has no frame 'coupler_tip': did you mean 'coupler",
    "no_joint": "constraint 'coupling_1': robot 'no_joint' has no joint 'rockr': did you mean 'rocker'?",
    "passive": "'passive' has no actuator; name the driven joints",
}


@pytest.mark.parametrize("robot", BAD_ROBOTS)
def test_robots_that_cannot_be(load: Load, robot: str, folder: Path) -> None:
    """In Python and on the command line: one line, and exit status 2."""
    with pytest.raises(MbocpError) as caught:
        load(robot=robot)
    assert BAD_ROBOTS[robot] in str(caught.value)
    result = CliRunner().invoke(app, ["solve", str(folder / "problem.toml")])
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ")
    assert len(result.stderr.splitlines()) == 1
    assert BAD_ROBOTS[robot] in result.stderr


def test_a_passive_robot_may_be_shown(folder: Path) -> None:
    robot = load_robot(folder / "passive")
    assert (robot.nu, robot.nc) == (0, 2)


def test_an_unreachable_goal_ends_the_command_line(load: Load, folder: Path) -> None:
    load()
    command = ["solve", str(folder / "problem.toml"), "--set", "goal.q={rocker=0.2}"]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 2
    assert "goal.q: no configuration of robot 'four_bar' has it with closed loops" in result.stderr
    assert "give a nearer position of 'rocker'" in result.stderr

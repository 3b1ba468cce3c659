"""Motions of closed loops that no motor drives: found, told apart from what swings, and held."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.problem import Problem
from mbocp.robot import HeldJointsWarning, Robot, load_parts, load_robot
from mbocp.robot.loops.undriven import joints_to_hold, undriven_motions
from tests.robot.loops import builders as loops

YAML = "closed_loop: [['tip_A', 'tip_B']]\nname_mot: ['mot_a', 'mot_b']\n"


def five_bar(
    folder: Path,
    text: str = "",
    *,
    offset: float = 0.0,
    inertia: float = 1e-5,
    tilt: float = 0.0,
    **keys: bool,
) -> Robot:
    """A five-bar linkage whose tips are two balls on hinges, welded to each other: both turn at the tip."""
    urdf = (
        '<robot name="five"><link name="base"/>'
        + loops.link("a1", 0.3)
        + loops.link("a2", 0.5)
        + loops.link("b1", 0.3)
        + loops.link("b2", 0.5)
        + ball("ball_a", offset, inertia, tilt)
        + ball("ball_b", offset, inertia, tilt)
        + loops.joint("mot_a", "base", "a1", rpy="0 -2.2 0")
        + loops.joint("knee", "a1", "a2", "0.3 0 0", rpy="0 1.2 0")
        + loops.joint("turn_a", "a2", "ball_a", "0.5 0 0")
        + loops.joint("mot_b", "base", "b1", "0.4 0 0", rpy="0 -0.9 0")
        + loops.joint("free", "b1", "b2", "0.3 0 0", rpy="0 -1.2 0")
        + loops.joint("turn_b", "b2", "ball_b", "0.5 0 0")
        + loops.tip("tip_A", "ball_a", 0.0)
        + loops.tip("tip_B", "ball_b", 0.0)
        + "</robot>"
    )
    folder.mkdir(exist_ok=True)
    (folder / "robot.urdf").write_text(urdf)
    (folder / "robot.yaml").write_text(YAML + text)
    return load_robot(folder, **keys)


def ball(name: str, offset: float, size: float, tilt: float = 0.0) -> str:
    return (
        f'<link name="{name}"><inertial><origin xyz="{offset} 0 0"/><mass value="0.2"/>'
        f'<inertia ixx="{size}" iyy="{size}" izz="{size}" ixy="{tilt * size}" ixz="0" iyz="{tilt * size}"/>'
        "</inertial></link>"
    )


def test_balls_at_the_tip_are_held(tmp_path: Path) -> None:
    """One joint is locked, where the free robot stands, and as many motions as motors are left."""
    free = five_bar(tmp_path / "free", "undriven: free\n")
    assert free.nv - free.nc == 3
    (motion,) = undriven_motions(free, free.q0).T
    moved = {free.joint_names[i] for i in np.flatnonzero(np.abs(motion) > 1e-9)}
    assert moved == {"turn_a", "turn_b"}
    (joint,), change = joints_to_hold(free)
    assert 0.0 < change < 1e-3
    with pytest.warns(HeldJointsWarning, match=rf"no motor drives what turns with '{joint}' at .*undriven"):
        held = five_bar(tmp_path / "held")
    assert set(free.joint_names) - set(held.joint_names) == {joint}
    assert held.nv - held.nc == held.nu == 2
    for name in held.joint_names:
        np.testing.assert_allclose(
            held.q0[held.configuration_indices(name)], free.q0[free.configuration_indices(name)], atol=1e-9
        )


def test_a_robot_toml_and_parts_say_it_too(tmp_path: Path) -> None:
    """By default nothing of a robot.toml is held; what a part holds is held in the whole."""
    with pytest.warns(HeldJointsWarning):
        five_bar(tmp_path)
    with pytest.warns(HeldJointsWarning):
        whole = load_parts([{"robot": str(tmp_path), "name": "left"}])
    assert whole.nv - whole.nc == 2
    (tmp_path / "robot.yaml").unlink()
    toml = '[actuation]\njoints = ["mot_a", "mot_b"]\n[[constraint]]\ntype = "weld"\nname = "tip"\n'
    toml += 'frames = ["tip_A", "tip_B"]\n'
    (tmp_path / "robot.toml").write_text(toml)
    assert load_robot(tmp_path).nv == 6
    (tmp_path / "robot.toml").write_text('undriven = "hold"\n' + toml)
    with pytest.warns(HeldJointsWarning, match=r'undriven "free" in robot\.toml'):
        assert load_robot(tmp_path).nv == 5


def test_balls_of_robots_that_float_are_held(tmp_path: Path) -> None:
    """No motor drives the base either, which feet may hold; that masses are uneven turns no ball at rest."""
    with pytest.warns(HeldJointsWarning, match="no motor drives what turns with"):
        robot = five_bar(tmp_path, free_flyer=True, tilt=0.3)
    assert robot.nv - robot.nc == 6 + robot.nu
    assert undriven_motions(robot, robot.q0).shape == (robot.nv, 0)


@pytest.mark.parametrize("more", [{"offset": 0.05}, {"inertia": 1.0}, {"offset": 0.05, "free_flyer": True}])
def test_what_swings_or_is_heavy_stays_free(tmp_path: Path, more: dict[str, float]) -> None:
    """Balls off their axis are pendulums: gravity turns them; large ones hinder the motors where held."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", HeldJointsWarning)
        robot = five_bar(tmp_path, **more)  # type: ignore[arg-type]
    assert undriven_motions(robot, robot.q0).shape[1] == 1
    assert joints_to_hold(robot).joints == ()


def test_driven_loops_have_none() -> None:
    robot = load_robot("five_bar")
    assert undriven_motions(robot, robot.q0).shape == (robot.nv, 0)
    assert joints_to_hold(robot).joints == ()


@pytest.mark.filterwarnings("ignore::mbocp.robot.HeldJointsWarning")
@pytest.mark.parametrize("reach", [0.2, -0.2])
def test_motors_reach_their_goal(tmp_path: Path, reach: float) -> None:
    robot = five_bar(tmp_path)
    goal = {n: float(robot.q0[robot.configuration_indices(n)][0]) + reach for n in ("mot_a", "mot_b")}
    solution = mbocp.solve(Problem.create(robot, 1.0, 40, start={"q": robot.q0}, goal={"q": goal, "v": 0}))
    assert solution.converged
    assert solution.iterations < 20

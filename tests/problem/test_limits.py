"""Limits: how they are written, what they mean, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mbocp.exceptions import DimensionMismatch, InvalidValue, MbocpError, ProblemError
from mbocp.problem import Bounds, Problem, parse_problem, problem_to_toml
from mbocp.robot import Robot

Loader = Callable[..., Problem]

INFINITE = np.full(6, np.inf)
ARM_GOAL = {"q": [0.5, -1.2, 0.5, -0.3, 0.4, 0.2], "v": [0] * 6}


def limited(robot: Robot | str, **limits: Any) -> Bounds:
    return Problem.create(robot, 1.0, 20, goal={"v": [0] * 6}, limits=limits).limits


def test_nothing_is_limited_by_default(load: Loader, ur5: Robot) -> None:
    for bounds in (load().limits, Bounds.none(ur5), limited(ur5, effort=False, velocity=False)):
        assert not bounds.any_finite
        for letter in "uvq":
            np.testing.assert_array_equal(getattr(bounds, f"{letter}_lower"), -INFINITE)
            np.testing.assert_array_equal(getattr(bounds, f"{letter}_upper"), INFINITE)


def test_true_means_the_robots_own(ur5: Robot) -> None:
    bounds = limited(ur5, effort=True, velocity=True, position=True)
    np.testing.assert_array_equal(bounds.u_upper, ur5.limits.effort)
    np.testing.assert_array_equal(bounds.u_lower, -ur5.limits.effort)
    np.testing.assert_array_equal(bounds.v_upper, ur5.limits.velocity)
    np.testing.assert_array_equal(bounds.q_lower, ur5.limits.position_lower)
    np.testing.assert_array_equal(bounds.q_upper, ur5.limits.position_upper)
    assert bounds.any_finite


def test_numbers_lists_and_tables(ur5: Robot) -> None:
    np.testing.assert_array_equal(limited(ur5, effort=3).u_lower, np.full(6, -3.0))
    listed = limited(ur5, velocity=[1, [-2, 3], np.inf, [-np.inf, 4], 5, 6])
    np.testing.assert_array_equal(listed.v_lower, [-1, -2, -np.inf, -np.inf, -5, -6])
    np.testing.assert_array_equal(listed.v_upper, [1, 3, np.inf, 4, 5, 6])
    named = limited(ur5, effort={"elbow_joint": 2.0, "wrist_1_joint": [-1, 5]})
    np.testing.assert_array_equal(named.u_lower, [-np.inf, -np.inf, -2, -1, -np.inf, -np.inf])
    np.testing.assert_array_equal(named.u_upper, [np.inf, np.inf, 2, 5, np.inf, np.inf])
    ranges = [[-7, 7]] * 5 + [[-np.inf, 1]]
    np.testing.assert_array_equal(limited(ur5, position=ranges).q_upper, [7, 7, 7, 7, 7, 1])
    one = limited(ur5, position={"elbow_joint": [-1, 2]})
    np.testing.assert_array_equal(np.flatnonzero(one.finite("q")), [2])


def test_only_plain_coordinates_have_positions(kinova: Robot, hector: Robot) -> None:
    with pytest.warns(UserWarning, match="outside the position limits"):  # of what [limits] leaves out
        bounds = limited(kinova, velocity=True)
    assert bounds.finite("v").all()
    free = limited(hector, position={"root_joint.z": [0.0, 2.0]})
    np.testing.assert_array_equal(free.q_upper, [np.inf, np.inf, 2, np.inf, np.inf, np.inf, np.inf])
    with pytest.raises(
        ProblemError, match=r"limits\.position\.root_joint: .*; name root_joint\.x, root_joint"
    ):
        limited(hector, position={"root_joint": [0, 1]})
    with pytest.raises(ProblemError, match=r"limits\.position\.root_joint\.qx: a unit quaternion or a \(cos"):
        limited(hector, position={"root_joint.qx": [0, 1]})
    name = "j2s6s200_joint_4"
    with pytest.raises(ProblemError, match=rf"limits\.position\.{name}: a unit quaternion or a \(cos, sin\)"):
        limited(kinova, position={name: [0, 1]})
    with pytest.raises(
        ProblemError, match=r"limits\.position: root_joint\.qx is a part of a unit quaternion"
    ):
        limited(hector, position=[[-1, 1]] * 7)


def test_true_skips_what_is_not_plain(kinova: Robot) -> None:
    start = {"q": {"j2s6s200_joint_2": 2.9, "j2s6s200_joint_3": 1.3}}
    bounds = Problem.create(
        kinova, 1.0, 20, start=start, goal={"v": [0] * 6}, limits={"position": True}
    ).limits
    for joint in kinova.joint_names:
        where = kinova.configuration_indices(joint)
        assert bounds.finite("q")[where].all() == (where.stop - where.start == 1)


@pytest.mark.parametrize(
    ("setting", "key", "reason"),
    [
        ("limits.effort=-1", "limits.effort", r"got -1\.0, expected a positive number, the largest absolute"),
        ("limits.effort=0", "limits.effort", r"got 0\.0, expected a positive number"),
        ("limits.effort=nan", "limits.effort", r"got nan, expected a number \(inf for no limit\)"),
        ("limits.effort='much'", "limits.effort", "got 'much', expected true, a number, a list or a table"),
        ("limits.effort=[1,2]", "limits.effort", r"got shape \(2,\), expected \(6,\); entries: shoulder_pan"),
        ("limits.effort=[1,2,3,4,5,-6]", "limits.effort[5]", r"got -6\.0, expected a positive number"),
        ("limits.effort=[1,2,3,4,5,true]", "limits.effort", "got True at index 5, expected a number"),
        (
            "limits.effort=[1,2,3,4,5,[6]]",
            "limits.effort",
            r"got \[6\] at index 5, expected \[lower, upper\]",
        ),
        ("limits.effort={elbow=1}", "limits.effort", "has no control 'elbow': did you mean 'elbow_joint'"),
        (
            "limits.effort={elbow_joint=[2,1]}",
            "limits.effort.elbow_joint",
            r"got \[2\.0, 1\.0\], expected \[lower, upper\] with lower < upper",
        ),
        ("limits.velocity={elbow_joint='a'}", "limits.velocity", "got 'a' for 'elbow_joint', expected a num"),
        (
            "limits.position=3",
            "limits.position",
            r"got 3, expected true, a list of \[lower, upper\] or a tab",
        ),
        ("limits.position={elbow_joint=1}", "limits.position", r"got 1 for 'elbow_joint', expected \[lower,"),
        ("limits.position=[[0,1]]", "limits.position", r"got shape \(1,\), expected \(6,\)"),
        (
            "limits.torque=1",
            "limits.torque",
            r"unknown key, did you mean 'effort'\? \(allowed in \[limits\]: profile, effort, effo",
        ),
        ("limits=1", "limits", "got 1, expected a table"),
        (
            "limits.position={wrist_1_joint=[-1, 1]}",
            "start.q",
            r"wrist_1_joint is -1\.57 rad, below its limit -1 in limits\.position; no motion keeps it: move",
        ),
        (
            "limits.position={shoulder_pan_joint=[-1, 0.25]}",
            "goal.q",
            r"shoulder_pan_joint is 0\.5 rad, above its limit 0\.25 in limits\.position",
        ),
    ],
)
def test_wrong_limits_name_file_key_got_and_allowed(
    load: Loader, setting: str, key: str, reason: str
) -> None:
    with pytest.raises(
        MbocpError, match=rf"arm\.toml: {key.replace('[', '.').replace(']', '.')}: .*{reason}"
    ):
        load(setting)


def test_velocity_limits_that_exclude_start_or_goal(load: Loader) -> None:
    with pytest.raises(
        ProblemError, match=r"start\.v: elbow_joint is 2 rad/s, above its limit 1 in limits\.v"
    ):
        load("limits.velocity=1", "start.v={elbow_joint=2}")
    with pytest.raises(ProblemError, match=r"goal\.v: elbow_joint is -2 rad/s, below its limit -1"):
        load("limits.velocity=1", "goal.v={elbow_joint=-2}")
    load("limits.velocity=1", "goal.v={elbow_joint=-2}", "goal.enforce=none", "cost.tracking=1")


def test_momentum_at_the_goal_is_held_against_velocity_limits(load: Loader, ur5: Robot) -> None:
    goal_q = ARM_GOAL["q"]
    p = ur5.momentum(goal_q, [0, 0, 2, 0, 0, 0]).tolist()
    with pytest.raises(ProblemError, match=r"goal\.v: elbow_joint is 2 rad/s, above its limit 1"):
        load(f"goal={{q={goal_q}, p={p}}}", "limits.velocity={elbow_joint=1}")
    load(f"goal={{p={p}}}", "limits.velocity={elbow_joint=1}")  # nobody knows where


def test_a_goal_of_other_joints_is_not_held_against_a_limit(load: Loader) -> None:
    load("limits.position={shoulder_pan_joint=[-1, 0.25]}", "goal.q={elbow_joint=0.5}")


def test_true_needs_limits_of_the_robot(hector: Robot) -> None:
    with pytest.raises(
        ProblemError, match=r"limits\.velocity: got true, but robot 'hector' has no such limit"
    ):
        limited(hector, velocity=True)


@pytest.mark.parametrize("method", ["fbsm_newton", "fbsm_bb", "fbsm_bb+monolithic"])
def test_other_methods_cannot_keep_limits(load: Loader, method: str) -> None:
    reason = (
        rf'solver\.method: got "{method.replace("+", ".")}", which cannot keep \[limits\]; take "auto" \|'
    )
    with pytest.raises(ProblemError, match=reason):
        load("limits.effort=true", f"solver.method='{method}'")
    load("limits.effort=false", f"solver.method='{method}'")


@pytest.mark.parametrize("method", ["auto", "monolithic", "ipopt", "fatrop"])
def test_interior_point_methods_keep_limits(load: Loader, method: str) -> None:
    assert load("limits.effort=true", f"solver.method='{method}'").limits.any_finite


def test_the_warning_goes_to_those_who_do_not_enforce_positions(kinova: Robot) -> None:
    words = {"start": {"q": kinova.neutral()}, "goal": {"v": [0] * 6}}
    with pytest.warns(UserWarning, match=r"start\.q: outside the position limits of .*are not enforced"):
        Problem.create(kinova, 1.0, 20, **words)
    with pytest.warns(UserWarning, match="limits are not enforced"):
        Problem.create(kinova, 1.0, 20, **words, limits={"velocity": True})
    Problem.create(kinova, 1.0, 20, **words, limits={"position": {"j2s6s200_joint_2": [-10, 10]}})


def test_limits_read_back(load: Loader) -> None:
    written = load("limits={effort={elbow_joint=5}, velocity=[1,2,3,4,5,inf], position=true}")
    again = parse_problem(problem_to_toml(written))
    for name, value in written.limits.fields.items():
        np.testing.assert_array_equal(value, again.limits.fields[name])
    assert "[limits]" not in problem_to_toml(load())


def test_bounds_are_checked_in_python_too(load: Loader, ur5: Robot) -> None:
    with pytest.raises(
        InvalidValue, match=r"limits\.effort\[1\]: got \[2\.0, 1\.0\], expected a lower below"
    ):
        Bounds(u_lower=[0, 2], u_upper=[1, 1])  # type: ignore[arg-type]
    with pytest.raises(InvalidValue, match=r"limits\.velocity\[0\]"):
        Bounds(v_lower=[np.nan], v_upper=[1.0])  # type: ignore[arg-type]
    with pytest.raises(DimensionMismatch, match=r"limits\.position: got shape \(1,\), expected \(2,\)"):
        Bounds(q_lower=[0], q_upper=[1, 2])  # type: ignore[arg-type]
    with pytest.raises(DimensionMismatch, match=r"limits\.effort: got shape \(2,\), expected \(6,\)"):
        load().with_(limits=Bounds(u_lower=-np.ones(2), u_upper=np.ones(2)))
    bounds = load().with_(limits=Bounds(u_lower=-np.ones(6), u_upper=np.ones(6))).limits
    np.testing.assert_array_equal(bounds.q_upper, INFINITE)
    assert [value.shape for value in Bounds.none(ur5).fields.values()] == [(2, 6)] * 3

"""Lists and tables by joint name; angles of continuous joints."""

import math
import re
import warnings
from typing import Any

import numpy as np
import pytest

from mbocp.exceptions import DimensionMismatch, MbocpError, ProblemError, UnknownJoint
from mbocp.problem import Problem
from mbocp.problem._checks import ProblemWarning
from mbocp.problem.file.named_values import (
    configuration_from,
    control_from,
    joint_values,
    tangent_from,
    weights_from,
)
from mbocp.problem.problem import problem_from_tables
from mbocp.robot import Robot, load_robot


def test_list_is_taken_as_it_is(ur5: Robot) -> None:
    q, active = configuration_from(ur5, [1, 2, 3, 4, 5, 6], ur5.q0, "start.q")
    np.testing.assert_array_equal(q, [1, 2, 3, 4, 5, 6])
    assert active.all()


def test_table_keeps_the_others(ur5: Robot) -> None:
    base = np.arange(6.0)
    q, active = configuration_from(ur5, {"elbow_joint": 0.5, "wrist_3_joint": [0.25]}, base, "goal.q")
    np.testing.assert_array_equal(q, [0, 1, 0.5, 3, 4, 0.25])
    np.testing.assert_array_equal(active, [False, False, True, False, False, True])


def test_continuous_joint_by_angle_by_pair_or_in_a_short_list(kinova: Robot) -> None:
    name = "j2s6s200_joint_4"
    where = kinova.configuration_indices(name)
    by_angle, _ = configuration_from(kinova, {name: 2.0}, kinova.q0, "start.q")
    by_pair, _ = configuration_from(kinova, {name: [math.cos(2.0), math.sin(2.0)]}, kinova.q0, "start.q")
    by_list, _ = configuration_from(kinova, [0, 0, 0, 2.0, 0, 0], kinova.q0, "start.q")
    for q in (by_angle, by_pair, by_list):
        np.testing.assert_allclose(q[where], [math.cos(2.0), math.sin(2.0)], atol=1e-15)


def test_wrong_length_with_continuous_joints_names_both(kinova: Robot) -> None:
    with pytest.raises(
        DimensionMismatch, match=r"got shape \(7,\), expected \(9,\); or \(6,\) with one angle"
    ):
        configuration_from(kinova, [0.0] * 7, kinova.q0, "start.q")


def test_a_list_of_too_few_numbers_asks_for_joints_to_lock(kinova: Robot) -> None:
    with pytest.raises(DimensionMismatch, match=r"`lock` of the robot makes those rigid"):
        configuration_from(kinova, [0.0] * 5, kinova.q0, "start.q")


def test_free_flyer(hector: Robot) -> None:
    q, active = configuration_from(hector, {"root_joint": [1, 2, 3, 0, 0, 0, 1]}, hector.q0, "goal.q")
    np.testing.assert_array_equal(q, [1, 2, 3, 0, 0, 0, 1])
    assert active.all()
    v, active = tangent_from(hector, {"root_joint.wx": 2.0, "root_joint.vz": 1.0}, "goal.v")
    np.testing.assert_array_equal(v, [0, 0, 1, 2, 0, 0])
    np.testing.assert_array_equal(active, [False, False, True, True, False, False])


def test_full_turns_of_a_joint_that_counts_none_are_told(kinova: Robot) -> None:
    name = "j2s6s200_joint_4"
    with pytest.warns(ProblemWarning, match=r"goal\.q\..*12 rad is -0\.5664 rad to it"):
        configuration_from(kinova, {name: 12.0}, kinova.q0, "goal.q")
    base, _ = configuration_from(kinova, {name: -1.0}, kinova.q0, "start.q")
    with pytest.warns(ProblemWarning, match=r"5\.28319 rad is -1 rad to it"):
        configuration_from(kinova, {name: 2 * math.pi - 1.0}, base, "goal.q")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        configuration_from(kinova, {name: 4.0}, kinova.q0, "goal.q")
        configuration_from(kinova, {name: 12.0}, kinova.q0, "start.q")


@pytest.mark.parametrize("key", ["start.q", "goal.q", "limits.position", "limits.velocity"])
def test_joints_without_numbers_of_their_own_are_told_apart_from_unknown_ones(key: str) -> None:
    """Of a finger that mimics the other, and of a locked joint."""
    panda = load_robot("panda", lock=["panda_joint7"], mimic=True)
    table, words = key.split(".")
    entry: object = [0.0, 0.01] if words == "position" else 0.01
    for name, reason in (
        ("panda_finger_joint2", "mimics 'panda_finger_joint1'.*name 'panda_finger_joint1'"),
        ("panda_joint7", "is fixed, by its file or by lock"),
        ("panda_joint9", "has no joint 'panda_joint9'"),
    ):
        tables: dict[str, object] = {"goal": {"q": {"panda_joint1": 0.1}}}
        tables[table] = {**dict(tables.get(table, {})), words: {name: entry}}
        with pytest.raises(UnknownJoint, match=rf"{re.escape(key)}: .*{reason}"):
            Problem.create(panda, 1.0, 10, **tables)


def test_unknown_joint(ur5: Robot) -> None:
    with pytest.raises(UnknownJoint, match="did you mean 'elbow_joint'"):
        tangent_from(ur5, {"elbow_join": 1.0}, "start.v")


def test_control(ur5: Robot) -> None:
    np.testing.assert_array_equal(control_from(ur5, 2, "guess.u"), np.full(6, 2.0))
    np.testing.assert_array_equal(control_from(ur5, {"elbow_joint": 3.0}, "guess.u"), [0, 0, 3, 0, 0, 0])


def test_weights(hector: Robot) -> None:
    np.testing.assert_array_equal(weights_from(hector, 2.0, "w"), np.full(6, 2.0))
    np.testing.assert_array_equal(weights_from(hector, {"root_joint": 2.0}, "w"), np.full(6, 2.0))
    np.testing.assert_array_equal(weights_from(hector, {"root_joint.wz": 3.0}, "w"), [0, 0, 0, 0, 0, 3])


@pytest.mark.parametrize("robot", ["ur5", "kinova", "hector"])
def test_written_values_read_back(robot: str, request: pytest.FixtureRequest) -> None:
    robot_: Robot = request.getfixturevalue(robot)
    rng = np.random.default_rng(0)
    v = rng.standard_normal(robot_.nv)
    active = rng.random(robot_.nv) < 0.5
    v[~active] = 0.0
    again, mask = tangent_from(robot_, joint_values(robot_, v, active), "v")
    np.testing.assert_array_equal(again, v)
    np.testing.assert_array_equal(mask, active)


def test_robot_without_controls_is_refused() -> None:
    with pytest.raises(ProblemError, match=r"robot: 'hector' has no actuator; name the driven joints"):
        Problem.create("hector", 1.0, 20)


def test_quaternion_is_normalised_with_a_warning(hector: Robot) -> None:
    goal = {"q": [0, 0, 1, 0, 0, 0, 1], "v": [0] * 6}
    with pytest.warns(UserWarning, match=r"start\.q\[3:7\].*root_joint.*norm 2"):
        problem = Problem.create(hector, 1.0, 20, start={"q": [0, 0, 1, 0, 0, 2, 0]}, goal=goal)
    np.testing.assert_array_equal(problem.q_start, [0, 0, 1, 0, 0, 1, 0])


def test_zero_quaternion_is_refused(hector: Robot) -> None:
    with pytest.raises(MbocpError, match=r"goal\.q\[3:7\].*root_joint.*norm 0"):
        Problem.create(hector, 1.0, 20, goal={"q": [0, 0, 1, 0, 0, 0, 0]})


def test_limits_of_a_part_are_those_of_all_its_joints() -> None:
    parts = [{"name": "left", "robot": "ur5"}, {"name": "load", "mass": 1.0, "sphere": 0.1}]
    robot = {"part": [*parts, {"name": "table", "mass": 1.0, "free_flyer": False}]}
    limits: dict[str, Any] = {
        "velocity": {"left": 2.0, "left/elbow_joint": [-1.0, 0.5], "load": 3.0},
        "effort": {"left": 40.0},
        "position": {"left": [-1.0, 1.5]},
    }
    given = {"horizon": {"duration": 1.0, "steps": 5}, "goal": {"v": 0.0}}
    found = problem_from_tables({"robot": robot, "limits": limits, **given}).limits
    assert found.v_upper.tolist() == [2.0, 2.0, 0.5, 2.0, 2.0, 2.0] + [3.0] * 6
    assert found.v_lower[2] == -1.0
    assert found.u_lower.tolist() == [-40.0] * 6
    assert found.q_upper[:6].tolist() == [1.5] * 6
    assert not np.isfinite(found.q_upper[6:]).any()
    with pytest.raises(MbocpError, match="'table'"):  # which has no joints
        problem_from_tables({"robot": robot, "limits": {"velocity": {"table": 1.0}}, **given})

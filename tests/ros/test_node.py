"""The node, end to end, with a controller and rclpy that are none."""

from __future__ import annotations

import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from mbocp_ros.messages import goal_positions, joint_state, trajectory_message
from mbocp_ros.node import main
from mbocp_ros.planner import Planner, load_planner

from mbocp.exceptions import DimensionMismatch, ProblemError

from . import stubs
from .conftest import write_problem

STATE = stubs.JointState(["gripper", "elbow", "shoulder"], [0.01, 0.3, -0.2], [0.0, 0.0, 0.0])


def run(
    file: Path | str, monkeypatch: pytest.MonkeyPatch, controller: stubs.Controller, use: Any
) -> stubs.Node:
    """Run the node until `use`, which gets it and its action server, is through."""
    node = stubs.Node(problem=str(file), reaction=0.3)
    modules = stubs.fake_modules(node, controller, lambda server: use(node, server))
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    main()
    assert node.is_destroyed
    return node


def test_a_goal_becomes_a_trajectory_and_a_cancel_a_stop(
    problem_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    controller, handles, found = stubs.Controller(), [], []

    def use(node: stubs.Node, server: Any) -> None:
        assert server.name == "move"
        assert server.cancel_callback(None) == "accept"
        node.subscriptions["joint_states"](STATE)
        for will_cancel in (False, True):
            handle = stubs.GoalHandle(stubs.goal_message(shoulder=0.1 if not will_cancel else 2.2))
            thread = threading.Thread(target=lambda h=handle: found.append(server.execute_callback(h)))
            node.subscriptions["joint_states"](STATE)
            thread.start()
            if will_cancel:
                while len(controller.received) < 2:
                    time.sleep(0.01)
                time.sleep(0.2)
                handle.is_cancel_requested = True
            thread.join(timeout=60.0)
            handles.append(handle)

    node = run(problem_file, monkeypatch, controller, use)
    assert [handle.state for handle in handles] == ["succeeded", "canceled"], node.words
    assert [(result.error_code, result.error_string) for result in found] == [(0, ""), (0, "")]
    _, motion, stop = controller.received
    assert motion.joint_names == stop.joint_names == ["shoulder", "elbow"]
    assert vars(motion.header.stamp) == vars(stop.header.stamp)  # one clock
    ts, tm = stubs.times(stop), stubs.times(motion)
    same = int(np.argmin(np.isclose(ts[: len(tm)], tm[: len(ts)])))  # points until the stop begins
    assert 0.2 < ts[same - 1] < 1.5
    np.testing.assert_allclose(
        stubs.rows(stop, "positions")[:same], stubs.rows(motion, "positions")[:same], atol=1e-6
    )
    np.testing.assert_array_equal(stubs.rows(stop, "velocities")[-1], 0.0)
    assert ts[-1] < tm[-1]
    assert stubs.rows(stop, "positions")[-1, 0] < 2.0
    assert "ready" in node.words


@pytest.mark.parametrize(
    ("controller", "message", "says"),
    [
        (stubs.Controller(), stubs.goal_message(wrist=1.0), "no joint 'wrist'"),
        (stubs.Controller(), stubs.goal_message(elbow=9.0), "above its limit 2.5"),
        (stubs.Controller(accepts=False), stubs.goal_message(elbow=0.4), "controller: it refused"),
        (stubs.Controller(status=6), stubs.goal_message(elbow=0.4), "ended with status 6"),
    ],
)
def test_what_is_refused_says_why(
    problem_file: Path,
    monkeypatch: pytest.MonkeyPatch,
    controller: stubs.Controller,
    message: Any,
    says: str,
) -> None:
    def use(node: stubs.Node, server: Any) -> None:
        early = stubs.GoalHandle(message)
        assert "no joint states" in server.execute_callback(early).error_string
        node.subscriptions["joint_states"](stubs.JointState(["other"], [0.0], []))
        node.subscriptions["joint_states"](STATE)
        handle = stubs.GoalHandle(message)
        result = server.execute_callback(handle)
        assert early.state == handle.state == "aborted"
        assert says in result.error_string
        assert result.error_code < 0

    node = run(problem_file, monkeypatch, controller, use)
    assert any(says in words for words in node.words)


def test_without_a_problem_there_is_no_node(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ProblemError, match="problem: the parameter is missing"):
        run("", monkeypatch, stubs.Controller(), None)


def test_messages_have_what_is_sent(planner: Planner) -> None:
    motion = planner.plan(*joint_state(STATE), {"elbow": 0.9})
    message = trajectory_message(motion, 12_000_000_345, stubs.CLASSES)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (12, 345)
    t = stubs.times(message)
    assert (np.diff(t) > 0.0).all()
    q, v, a, _ = motion.sent.curves.at(t)
    np.testing.assert_allclose(stubs.rows(message, "positions"), q, atol=1e-8)
    np.testing.assert_allclose(stubs.rows(message, "velocities"), v, atol=1e-6)
    has_accelerations = motion.sent.curves.interpolation == "quintic"
    assert stubs.rows(message, "accelerations").shape == (a.shape if has_accelerations else (len(t), 0))
    assert message.points[0].time_from_start.seconds == 0.0


@pytest.mark.parametrize("limits", ["", "jerk = 60.0"])
def test_messages_have_efforts_where_these_are_asked_for(tmp_path: Path, limits: str) -> None:
    """Of quintics those of inverse dynamics; of cubics those of the solution's steps."""
    planner = load_planner(write_problem(tmp_path, limits))
    motion = planner.plan(*joint_state(STATE), {"elbow": 0.9})
    plain = trajectory_message(motion, 0, stubs.CLASSES)
    assert all(point.effort == [] for point in plain.points)
    message = trajectory_message(motion, 0, stubs.CLASSES, has_efforts=True)
    efforts, model = stubs.rows(message, "effort"), planner.problem.robot.model
    if not limits:
        np.testing.assert_array_equal(efforts, motion.sent.controls(motion.sent.times))
        return
    states = (stubs.rows(message, key) for key in ("positions", "velocities", "accelerations"))
    expected = [pin.rnea(model, model.createData(), *state) for state in zip(*states, strict=True)]
    np.testing.assert_allclose(efforts, expected, atol=1e-6)
    assert np.abs(efforts).max() > 0.01


def test_joints_without_motors_have_no_efforts(planner: Planner) -> None:
    motion = planner.plan(*joint_state(STATE), {"elbow": 0.9})
    solution = motion.sent.solution
    one, other = solution.labels.u
    labels = replace(solution.labels, u=(one, type(other)("belt", other.unit)))
    sent = replace(motion.sent, solution=replace(solution, labels=labels))
    with pytest.raises(ProblemError, match="efforts: joint 'elbow' has no motor of its name"):
        trajectory_message(replace(motion, sent=sent), 0, stubs.CLASSES, has_efforts=True)


def test_goals_are_one_point_at_rest() -> None:
    message = stubs.goal_message(elbow=1.0)
    assert goal_positions(message) == {"elbow": 1.0}
    message.joint_names.append("shoulder")
    with pytest.raises(DimensionMismatch):
        goal_positions(message)
    message.points[0].velocities = [0.1]
    with pytest.raises(ProblemError, match="velocities must be zero"):
        goal_positions(message)
    message.points *= 2
    with pytest.raises(ProblemError, match="got 2 points"):
        goal_positions(message)

"""Motions and stops, without ROS."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from mbocp_ros.messages import trajectory_message
from mbocp_ros.planner import Motion, Planner, load_planner

from mbocp.exceptions import InvalidValue, MbocpError, NotConverged, ProblemError, UnknownJoint
from mbocp.solution.sent import compute_motion_sent
from mbocp.solution.sent_checks import check_sent, joint_excesses
from mbocp.solution.sent_states import Follower

from . import stubs
from .conftest import write_problem

HERE = {"shoulder": 0.2, "elbow": -0.4, "gripper": 0.01}


def check_limits(motion: Motion, jerk: float = math.inf) -> None:
    _, (_, v, a, j) = motion.sent.curves.places(20)
    assert np.abs(v).max() <= 1.0 + 1e-3
    assert np.abs(a).max() <= 4.0 * (1.0 + 1e-3)
    assert np.abs(j).max() <= jerk * (1.0 + 2e-3)


def test_a_motion_leads_from_here_to_the_goal(planner: Planner) -> None:
    motion = planner.plan(HERE, {"shoulder": 0.001}, {"shoulder": 1.2})
    curves = motion.sent.curves
    assert motion.sent.joints == planner.joints == ("shoulder", "elbow")
    np.testing.assert_allclose(curves.q[[0, -1]], [[0.2, -0.4], [1.2, -0.4]], atol=1e-8)
    np.testing.assert_allclose(curves.v[[0, -1]], 0.0, atol=1e-8)
    check_limits(motion)
    assert motion.duration == pytest.approx(1.0 / 1.0 + 1.0 / 4.0, rel=0.02)  # a trapezium of speeds


def write_weak(folder: Path) -> Path:
    """The problem of an arm whose motors are busy all the time, in few steps."""
    file, text = (
        write_problem(folder),
        {"effort = true": "effort = 0.5", "= 4.0": "= 30.0", "= 30\n": "= 16\n"},
    )
    for old, new in text.items():
        assert old in file.read_text()
        file.write_text(file.read_text().replace(old, new))
    return file


def test_a_motion_is_slower_where_its_efforts_ask_for_it(tmp_path: Path) -> None:
    """Cubics between nodes take more than the motors have."""
    planner = load_planner(write_weak(tmp_path))
    motion = planner.plan(HERE, {}, {"shoulder": 1.2, "elbow": 0.3})
    plain = compute_motion_sent(motion.solution, is_joined=True, fit=True)
    (worst, *_), _ = check_sent(plain, motion.solution.problem)
    assert worst.kind == "effort"
    assert worst.ratio > 0.01
    assert not motion.words
    assert 1.0 < motion.sent.slower < 1.1
    assert not joint_excesses(Follower.of(motion.sent, planner.problem.robot))
    stop = planner.stop(motion, 0.3 * motion.duration)
    left = joint_excesses(Follower.of(stop.sent, planner.problem.robot))
    assert [one.words for one in left if one.ratio > 1e-3] == [
        one.words for one in stop.sent.excesses if one.kind == "effort" and one.ratio > 1e-3
    ]


@pytest.mark.parametrize("share", [0.1, 0.5])
@pytest.mark.parametrize("jerk", [math.inf, 60.0])
def test_a_stop_goes_on_from_the_motion_and_keeps_all_limits(
    tmp_path: Path, share: float, jerk: float
) -> None:
    planner = load_planner(write_problem(tmp_path, "" if math.isinf(jerk) else f"jerk = {jerk}"))
    motion = planner.plan(HERE, {}, {"shoulder": 1.2, "elbow": 0.3})
    stop = planner.stop(motion, share * motion.duration)
    assert stop.begin == pytest.approx(share * motion.duration)
    there, here = motion.sent.curves.at(np.array([stop.begin])), stop.sent.curves.at(np.zeros(1))
    for k in range(2 if math.isinf(jerk) else 3):
        np.testing.assert_allclose(here[k], there[k], atol=1e-7)
    np.testing.assert_allclose(stop.sent.curves.v[-1], 0.0, atol=1e-6)
    assert stop.begin < stop.duration < motion.duration
    assert not stop.words
    check_limits(stop, jerk)
    message = trajectory_message(stop, 0, stubs.CLASSES, has_efforts=True)
    t, q = stubs.times(message), stubs.rows(message, "positions")
    before = t < stop.begin - 1e-9
    np.testing.assert_allclose(q[before], motion.sent.curves.at(t[before])[0], atol=1e-8)
    np.testing.assert_allclose(q[~before], stop.sent.curves.at(t[~before] - stop.begin)[0], atol=1e-8)
    assert (np.diff(t) > 0.0).all()
    assert t[-1] == pytest.approx(stop.duration)
    assert stubs.rows(message, "effort").shape == q.shape


def test_joints_that_turn_without_end_go_on_counting(tmp_path: Path) -> None:
    planner = load_planner(write_problem(tmp_path, elbow="continuous"))
    motion = planner.plan({"shoulder": 0.0, "elbow": 7.0}, {}, {"elbow": 7.5})
    np.testing.assert_allclose(motion.sent.curves.q[0] + motion.turns, [0.0, 7.0], atol=1e-8)
    np.testing.assert_allclose(motion.sent.curves.q[-1] + motion.turns, [0.0, 7.5], atol=1e-6)
    stop = planner.stop(motion, 0.3 * motion.duration)
    q = stubs.rows(trajectory_message(stop, 0, stubs.CLASSES), "positions")
    assert q[0, 1] == pytest.approx(7.0)
    assert np.abs(np.diff(q, axis=0)).max() < 0.2


@pytest.mark.parametrize(
    ("q", "v", "goal", "error", "says"),
    [
        (HERE, {}, {"wrist": 1.0}, UnknownJoint, "no joint 'wrist'"),
        (HERE, {}, {"elbow": 2.6}, ProblemError, "above its limit 2.5"),
        ({**HERE, "elbow": -2.6}, {}, {"elbow": 0.0}, ProblemError, "below its limit -2.5"),
        (HERE, {}, {"elbow": math.nan}, MbocpError, "expected a finite number"),
        ({"elbow": 0.0}, {}, {"elbow": 1.0}, InvalidValue, "start.q.shoulder"),
        (HERE, {"elbow": 0.2}, {"elbow": 1.0}, ProblemError, "elbow moves by 0.2"),
        (HERE, {"elbow": math.nan}, {"elbow": 1.0}, ProblemError, "elbow moves by nan"),
    ],
)
def test_what_is_refused(
    planner: Planner, q: dict[str, float], v: dict[str, float], goal: dict[str, float], error: type, says: str
) -> None:
    with pytest.raises(error, match=says):
        planner.plan(q, v, goal)


def test_what_does_not_converge_is_refused(planner: Planner) -> None:
    hurried = Planner(planner.problem.with_(duration={"min": 0.2, "max": 0.5}))
    with pytest.raises(NotConverged, match="infeasible"):
        hurried.plan(HERE, {}, {"shoulder": 2.2})


def test_after_the_end_there_is_no_stop(planner: Planner) -> None:
    motion = planner.plan(HERE, {}, {"shoulder": 1.2})
    with pytest.raises(ProblemError, match="is over before"):
        planner.stop(motion, motion.duration)
    with pytest.raises(MbocpError, match="time"):
        planner.stop(motion, 0.1, time_limit=1e-9)


def test_problems_that_cannot_be_stopped_are_refused(tmp_path: Path) -> None:
    file = write_problem(tmp_path)
    file.write_text(file.read_text().replace("effort = true\n", "").replace("acceleration = 4.0\n", ""))
    with pytest.raises(ProblemError, match="nothing limits how fast"):
        load_planner(file)

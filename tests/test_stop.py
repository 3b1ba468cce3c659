"""The least time to rest, from a motion or from any state."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import DimensionMismatch, InvalidValue, ProblemError
from mbocp.problem import Problem

INERTIA, TORQUE, SPEED = 0.5, 2.0, 3.0
ROTOR = f"""<robot name="rotor"><link name="base"/>
<link name="wheel"><inertial><mass value="1"/>
<inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="axle" type="revolute"><parent link="base"/><child link="wheel"/><axis xyz="0 0 1"/>
<limit lower="-100" upper="100" effort="{TORQUE}" velocity="50"/></joint></robot>"""
EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def rotor(tmp_path: Path) -> mbocp.Robot:
    file = tmp_path / "rotor.urdf"
    file.write_text(ROTOR)
    return mbocp.load_robot(file)


def swing(robot: mbocp.Robot, **limits: Any) -> Problem:
    return Problem.create(robot, 2.0, 20, goal={"q": [1.0], "v": 0}, limits=limits)


def test_a_wheel_stops_as_fast_as_its_torque_can(rotor: mbocp.Robot) -> None:
    s = mbocp.stop(swing(rotor, effort=True), q=[0.3], v=[SPEED])
    assert s.converged
    assert s.duration == pytest.approx(INERTIA * SPEED / TORQUE, rel=1e-3)
    assert s.vs[-1, 0] == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(s.us, -TORQUE, rtol=1e-3)


def test_with_a_limit_of_jerk_it_takes_as_long_as_that_asks_for(rotor: mbocp.Robot) -> None:
    """Down with one jerk and up with the other: 2 sqrt(v / j), between two accelerations that are zero."""
    s = mbocp.stop(swing(rotor, jerk=10.0), q=[0.0], v=[SPEED], steps=60)
    assert s.converged
    assert s.duration == pytest.approx(2.0 * np.sqrt(SPEED / 10.0), rel=0.02)
    half = s.duration / s.num_steps / 2.0
    assert s.accelerations[-1, 0] == pytest.approx(-10.0 * half, rel=1e-4)  # and none after half a step


def test_torques_alone_stop_an_arm_from_any_state() -> None:
    """Within 20 short steps, in which torques leap from limit to limit."""
    words = {"goal": {"q": [0.0] * 6, "v": 0}, "limits": {"effort": True, "velocity": True}}
    problem, rng = Problem.create("ur5", 1.0, 30, **words), np.random.default_rng(7)
    for _ in range(16):  # with a tenth of the weight of controls four of them stagnated
        q, v = rng.uniform(-2.0, 2.0, 6), rng.uniform(-0.9, 0.9, 6) * problem.robot.limits.velocity
        assert mbocp.stop(problem, q=q, v=v).converged


def test_it_goes_on_with_the_acceleration_of_the_motion(rotor: mbocp.Robot) -> None:
    plan = mbocp.solve(swing(rotor, jerk=4.0), check=True)
    s = mbocp.stop(plan, at=0.5)
    n = int(np.searchsorted(plan.t, 0.5, side="right")) - 1
    np.testing.assert_array_equal(s.qs[0], plan.qs[n])
    np.testing.assert_allclose(s.problem.a_start, plan.accelerations[[n - 1, n]].mean(axis=0))
    other = mbocp.stop(plan, at=0.5, a=[0.0])
    assert other.duration != pytest.approx(s.duration, rel=1e-3)


@pytest.mark.parametrize("share", [0.25, 0.6])
def test_an_arm_stops_within_all_its_limits(share: float) -> None:
    plan = mbocp.solve(EXAMPLES / "arms" / "minimum_time.toml", check=True)
    s = mbocp.stop(plan, at=share * plan.duration)
    assert s.converged
    assert s.limit_violation <= 1e-6
    assert s.duration < plan.duration
    assert np.abs(s.vs[-1]).max() < 1e-9
    jerks = s.accelerations[-1] / (s.duration / s.num_steps / 2.0)  # with which none is left at the end
    assert (np.abs(jerks) <= s.facts.bounds_of_rate("jerk")[1] * (1.0 + 1e-6)).all()


def test_a_joint_that_could_stop_before_its_limit_does_so() -> None:
    """And without that constraint it would turn further."""
    robot = mbocp.load_robot("double_pendulum", damping=False)
    braking = {"kind": "braking", "frame": "joint1", "deceleration": 2.0, "max": 1.0}
    words: dict[str, Any] = {"goal": {"q": [0.2, 0.1], "v": 0}, "limits": {"effort": 4.0}}
    begin = {"q": [0.6, 0.0], "v": [1.2, 0.0]}
    free = mbocp.stop(Problem.create(robot, 1.0, 10, **words), **begin)
    held = mbocp.stop(Problem.create(robot, 1.0, 10, path=[braking], **words), **begin)
    assert free.converged
    assert held.converged
    q, v = held.qs[1:, 0], np.maximum(held.vs[1:, 0], 0.0)
    assert (q + v**2 / 4.0).max() <= 1.0 + 1e-6


@pytest.mark.parametrize(
    ("words", "error", "says"),
    [
        ({"v": [0.0]}, ProblemError, "say where it begins"),
        ({"q": [0.0], "v": [0.0]}, ProblemError, "at rest already"),
        ({"at": 0.5}, ProblemError, "is a time of a solution"),
        ({"q": [0.0], "v": [1.0], "limits": {"velocity": 3.0}}, ProblemError, "nothing limits how fast"),
        ({"q": [0.0, 1.0], "v": [1.0]}, DimensionMismatch, "q"),
        ({"q": [0.0], "v": [np.nan]}, InvalidValue, "v"),
        (
            {"q": [0.0], "v": [9.0], "limits": {"effort": True, "velocity": 3.0}},
            ProblemError,
            "above its limit",
        ),
    ],
)
def test_what_is_refused(
    rotor: mbocp.Robot, words: dict[str, Any], error: type[Exception], says: str
) -> None:
    limits = words.pop("limits", {"effort": True})
    with pytest.raises(error, match=says):
        mbocp.stop(swing(rotor, **limits), **words)


def test_a_time_beyond_the_motion_is_refused(rotor: mbocp.Robot) -> None:
    plan = mbocp.solve(swing(rotor, effort=True), check=True)
    with pytest.raises(InvalidValue, match="expected a time from 0 to 2 s"):
        mbocp.stop(plan, at=2.5)

"""Accelerations whose limits fall with the speed of a joint."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import ProblemError
from mbocp.formulation import formulate
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.robot.payload import Payload
from mbocp.solution.sent import compute_motion_sent
from mbocp.solution.sent_checks import path_excesses
from mbocp.solution.sent_states import Follower
from tests.formulation.stages import check_derivatives
from tests.sent.reader import samples_of

ROTOR = """<robot name="rotor"><link name="base"/>
<link name="wheel"><inertial><mass value="1"/>
<inertia ixx="0.5" iyy="0.5" izz="0.5" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="axle" type="revolute"><parent link="base"/><child link="wheel"/><axis xyz="0 0 1"/>
<limit lower="-100" upper="100" effort="0" velocity="50"/></joint></robot>"""
CURVE = [[0.0, 4.0], [1.0, 4.0], [3.0, 1.0]]  # rad/s, rad/s^2
FALLING: dict[str, Any] = {"kind": "acceleration", "frame": "axle", "curve": CURVE}
WAY = 2.0  # [rad]


@pytest.fixture
def rotor(tmp_path: Path) -> mbocp.Robot:
    file = tmp_path / "rotor.urdf"
    file.write_text(ROTOR)
    return mbocp.load_robot(file)


def turn(robot: mbocp.Robot, steps: int = 60, **words: Any) -> Problem:
    """From rest to rest in the least time."""
    words = {"path": [FALLING], "goal": {"q": [WAY], "v": 0}, **words}
    duration = {"min": 0.05, "max": 9.0}
    return Problem.create(robot, duration, steps, cost={"time": 1.0, "effort": 1e-7}, **words)


def least_time() -> float:
    """Twice the time in which half of the way is gone under dv/dt = a(v)."""
    v = np.linspace(0.0, 3.0, 100_001)
    a = np.interp(v, *np.transpose(CURVE))
    slope = 2.0 / (a[1:] + a[:-1])
    t = np.append(0.0, np.cumsum(np.diff(v) * slope))
    x = np.append(0.0, np.cumsum((v[1:] + v[:-1]) / 2.0 * np.diff(t)))
    return float(2.0 * np.interp(WAY / 2.0, x, t))


@pytest.mark.parametrize(
    ("scheme", "controls"),
    [
        ("se1", "constant"),
        ("midpoint", "constant"),
        ("rk4", "constant"),
        ("gauss2", "linear"),
        ("gauss2", "stages"),
    ],
)
def test_least_times_are_those_of_the_table_both_ways(rotor: mbocp.Robot, scheme: str, controls: str) -> None:
    """Nowhere in a step is it left by more than a thousandth, where the wheel speeds up or slows down."""
    s = mbocp.solve(turn(rotor, scheme=scheme, controls=controls), check=True)
    exact = least_time()
    assert exact * (1.0 - 1e-3 * (scheme == "se1")) <= s.duration <= 1.005 * exact
    h = np.diff(s.t)
    means = np.diff(s.vs[:, 0]) / h
    for n, mean in enumerate(means):
        begin, end = s.vs[n : n + 2, 0]
        speeds, rates = np.array([begin, end]), np.array([mean, mean])
        if scheme == "gauss2":
            b = 3.0 * (s.qs[n + 1, 0] - s.qs[n, 0]) / h[n] - begin - end
            shares = np.linspace(0.0, 1.0, 21)
            speeds = (1.0 - shares) ** 2 * begin + 2.0 * shares * (1.0 - shares) * b + shares**2 * end
            rates = 2.0 * ((1.0 - shares) * (b - begin) + shares * (end - b)) / h[n]
        most = np.interp(np.abs(speeds), *np.transpose(CURVE))
        assert (np.abs(rates) <= (1.0 + 1e-3) * most).all()
    touched = {limit.name.partition(" at ")[0] for limit in s.active_limits if limit.kind == "path"}
    assert {f"acceleration of axle{row}" for row in (".1", ".2 speeding up", ".2 slowing down")} <= touched
    assert s.limit_violation < 1e-6


def test_files_say_the_same_and_another_table_compiles_nothing(rotor: mbocp.Robot) -> None:
    one = turn(rotor)
    (path,) = parse_problem(problem_to_toml(one)).frame_constraints
    np.testing.assert_array_equal(path.upper, [4.0, 5.5, 5.5])
    names = [
        "acceleration of axle.1",
        "acceleration of axle.2 speeding up",
        "acceleration of axle.2 slowing down",
    ]
    assert [label.name for label in path.labels] == names
    other = turn(rotor, path=[{**FALLING, "curve": [[0, 3], ["60 rpm", "3 rad/s^2"], [9, 1]]}])
    assert formulate(one).pieces.signature == formulate(other).pieces.signature
    np.testing.assert_allclose(other.frame_constraints[0].number("speeds"), [0.0, 2.0 * np.pi, 9.0])


@pytest.mark.parametrize("controls", ["constant", "linear", "stages"])
def test_rows_within_steps_have_exact_derivatives(rotor: mbocp.Robot, controls: str) -> None:
    problem = turn(rotor, 4, scheme="gauss2", controls=controls)
    check_derivatives(formulate(replace(problem, limits_within="m")), 2, [0, 2])


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ({"curve": [[0, 4], [1, 3], [3, 2]]}, "accelerations that fall less steeply after 1"),
        ({"curve": [[0, 4], [1, 5]]}, "accelerations .* none that rises"),
        ({"curve": [[0, 4]]}, r"two or more rows \[speed, acceleration\]"),
        ({"curve": [[0, 4], [1, "3 N m"]]}, "'3 N m', a torque or an energy, expected a number in rad/s\\^2"),
        ({"curve": None}, "curve: this key is missing"),
        ({"stall": 2.0}, 'kind = "acceleration" does not use it'),
        ({"frame": "wheel"}, "no joint with one angle"),
    ],
)
def test_what_is_no_table_of_accelerations_is_refused(
    rotor: mbocp.Robot, words: dict[str, Any], says: str
) -> None:
    table = {key: value for key, value in {**FALLING, **words}.items() if value is not None}
    with pytest.raises(ProblemError, match=says):
        turn(rotor, path=[table])


def test_natural_coordinates_have_none() -> None:
    with pytest.raises(ProblemError, match="accelerations of joints are those of joint coordinates"):
        Problem.create(
            "double_pendulum",
            1.0,
            20,
            goal={"q": [1.0, 0.5], "v": 0},
            coordinates="natural",
            path=[{**FALLING, "frame": "joint1"}],
        )


def test_a_motor_takes_no_accelerations(rotor: mbocp.Robot) -> None:
    with pytest.raises(ProblemError, match="'3 rad/s\\^2', expected a number in N m"):
        turn(rotor, path=[{"kind": "motor", "frame": "axle", "curve": [[0, 4], [1, "3 rad/s^2"]]}])


LIGHT, HEAVY = [[1200, 900], [1200, 850], [300, 200]], [[800, 600], [700, 500], [100, 50]]  # deg/s^2


def of_profile(folder: Path, mass: float, values: object, words: str, **more: Any) -> Problem:
    file, robot = folder / "own.toml", mbocp.load_robot("double_pendulum")
    text = 'source = ["x"]\njoints = ["joint1", "joint2"]\ndegrees = true\n'
    file.write_text(f"{text}acceleration = {{ {words}, values = {json.dumps(values)} }}")
    loaded = robot.with_payload(Payload(frame=robot.frame_names[-1], mass=mass))
    return Problem.create(
        loaded,
        {"min": 0.2, "max": 4.0},
        30,
        goal={"q": [1.5, -1.0], "v": 0},
        cost={"time": 1.0, "effort": 1e-4},
        limits={"profile": str(file)},
        **more,
    )


def test_a_profile_has_them_over_speed_and_payload(tmp_path: Path) -> None:
    """Without the flat part, which the limit at rest is; between two loads they are between those of both."""
    both, speeds = "payload = [1, 3], speed = [0, 90, 360]", "speed = [0, 90, 360]"
    degree = np.pi / 180.0
    for mass, values in ((1.0, LIGHT), (3.0, HEAVY)):
        one, alone = (
            of_profile(tmp_path, mass, [LIGHT, HEAVY], both),
            of_profile(tmp_path, mass, values, speeds),
        )
        np.testing.assert_allclose(one.limits.a_upper, degree * np.array(values[0]))
        for path, other in zip(one.frame_constraints, alone.frame_constraints, strict=True):
            np.testing.assert_allclose(path.number("values"), other.number("values"))
    half = of_profile(tmp_path, 2.0, [LIGHT, HEAVY], both).frame_constraints
    assert [path.name for path in half] == ["own's acceleration of joint1", "own's acceleration of joint2"]
    np.testing.assert_allclose(half[0].number("values"), degree * np.array([1000.0, 950.0, 200.0]))
    with pytest.raises(
        ProblemError, match="acceleration of joint1: got accelerations that fall less steeply"
    ):
        of_profile(tmp_path, 1.0, [[600, 600], [300, 500], [200, 100]], speeds)


@pytest.mark.parametrize("controls", ["constant", "linear"])
def test_they_are_kept_as_a_motion_is_sent(tmp_path: Path, controls: str) -> None:
    """By differences of samples at 1 kHz; a motion that is sent faster leaves them, and says so."""
    problem = of_profile(tmp_path, 1.0, LIGHT, "speed = [0, 90, 360]", controls=controls)
    s = mbocp.solve(problem, check=True)
    assert any(limit.name.startswith("own's acceleration of joint1") for limit in s.active_limits)
    q = samples_of(s.export(tmp_path / "kept.csv", rate=1000.0))[1]
    degree = np.pi / 180.0
    v, a = np.diff(q, axis=0) * 1e3, np.diff(q, 2, axis=0) * 1e6
    speeds = np.minimum(np.abs(v[1:]), np.abs(v[:-1]))
    for k in (0, 1):
        most = np.interp(speeds[:, k], degree * np.array([0.0, 90.0, 360.0]), degree * np.array(LIGHT)[:, k])
        assert (np.abs(a[:, k]) <= 1.002 * most + 1e-3).all()
    sent = compute_motion_sent(s, 1000.0)
    fast = Follower.of(replace(sent, curves=sent.curves.slow(0.9)), problem.robot)
    assert "own's acceleration of joint1 slowing down" in {
        one.name for one in path_excesses(fast, problem)[0]
    }
    assert not path_excesses(Follower.of(sent, problem.robot), problem)[0]

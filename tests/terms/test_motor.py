"""Motors whose torque falls with their speed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import ProblemError
from mbocp.formulation import formulate
from mbocp.job import Job
from mbocp.problem import Problem, parse_problem, problem_to_toml
from mbocp.strategies import OneSolve
from tests.formulation.stages import check_derivatives

STALL, NO_LOAD, INERTIA = 2.0, 5.0, 0.5
ROTOR = f"""<robot name="rotor"><link name="base"/>
<link name="wheel"><inertial><mass value="1"/>
<inertia ixx="{INERTIA}" iyy="{INERTIA}" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="axle" type="revolute"><parent link="base"/><child link="wheel"/><axis xyz="0 0 1"/>
<limit lower="-100" upper="100" effort="0" velocity="50"/></joint></robot>"""
MOTOR: dict[str, Any] = {"kind": "motor", "frame": "axle", "stall": STALL, "no_load": NO_LOAD}


@pytest.fixture
def rotor(tmp_path: Any) -> mbocp.Robot:
    file = tmp_path / "rotor.urdf"
    file.write_text(ROTOR)
    return mbocp.load_robot(file)


def spin(rotor: mbocp.Robot, speed: float, start: float = 0.0, steps: int = 80, **words: Any) -> Problem:
    words = {"path": [MOTOR], **words}
    return Problem.create(
        rotor,
        {"min": 0.05, "max": 9.0},
        steps,
        start={"v": [start]},
        goal={"v": [speed]},
        cost={"time": 1.0, "effort": 1e-6},
        **words,
    )


def test_a_wheel_comes_up_to_speed_as_its_voltage_lets_it(rotor: mbocp.Robot) -> None:
    """v = v_0 (1 - exp(-t / T)) with T = J v_0 / tau_0, under the whole voltage."""
    s = mbocp.solve(spin(rotor, 0.8 * NO_LOAD), check=True)
    assert s.duration == pytest.approx(np.log(5.0) * INERTIA * NO_LOAD / STALL, rel=2e-2)
    kept = s.us[:, 0] + STALL / NO_LOAD * s.vs[1:, 0]
    np.testing.assert_allclose(kept, STALL, rtol=1e-4)
    (limit,) = s.active_limits
    assert (limit.kind, limit.name, limit.count) == ("path", "motor of axle", 80)


def test_the_voltage_helps_to_brake(rotor: mbocp.Robot) -> None:
    """Then more than the stall torque acts, unless a limit of effort says what the current allows."""
    s = mbocp.solve(spin(rotor, 0.0, start=4.0), check=True)
    assert s.us.min() < -1.5 * STALL
    limited = mbocp.solve(spin(rotor, 0.0, start=4.0, limits={"effort": STALL}), check=True)
    assert limited.us.min() == pytest.approx(-STALL, rel=1e-4)
    assert limited.duration > s.duration


def test_no_speed_above_that_without_load_is_reached(rotor: mbocp.Robot) -> None:
    assert not mbocp.solve(spin(rotor, 1.1 * NO_LOAD)).converged


def test_another_motor_compiles_nothing_and_files_say_the_same(rotor: mbocp.Robot) -> None:
    other = {**MOTOR, "stall": 3.0, "no_load": 7.0}
    one, two = spin(rotor, 1.0), spin(rotor, 1.0, path=[other])
    assert formulate(one).pieces.signature == formulate(two).pieces.signature
    again = parse_problem(problem_to_toml(two))
    (constraint,) = again.path
    assert constraint.upper == pytest.approx([3.0])
    values = constraint.values_along(rotor, np.zeros((1, 1)), np.array([[7.0]]), np.array([[0.5]]))
    assert values == pytest.approx(np.array([[3.5]]))


CURVE = [[0.0, 2.0], [2.0, 2.0], [4.0, 1.0], [5.0, 0.25]]  # rad/s, N m


def test_a_table_of_torques_is_kept_at_each_speed(rotor: mbocp.Robot) -> None:
    """In the least time: dt = J dv / torque(v), exactly between the rows of the table."""
    curve = {"kind": "motor", "frame": "axle", "curve": CURVE}
    s = mbocp.solve(spin(rotor, 4.6, path=[curve], steps=160), check=True)
    speeds = np.linspace(0.0, 4.6, 20_001)
    expected = np.trapezoid(INERTIA / np.interp(speeds, *np.transpose(CURVE)), speeds)
    assert s.duration == pytest.approx(expected, rel=1e-2)
    np.testing.assert_allclose(s.us[:, 0], np.interp(s.vs[1:, 0], *np.transpose(CURVE)), rtol=1e-3)
    (constraint,) = parse_problem(problem_to_toml(s.problem)).path
    assert [label.name for label in constraint.labels] == [f"motor of axle.{n}" for n in (1, 2, 3)]
    np.testing.assert_array_equal(constraint.upper, s.problem.path[0].upper)


def test_rows_of_a_table_take_the_unit_of_each_column(rotor: mbocp.Robot) -> None:
    curve: list[Any] = [[0, "2000 N mm"], ["60 rpm", 1.5], [7, "1 N m"]]
    (constraint,) = spin(rotor, 1.0, path=[{"kind": "motor", "frame": "axle", "curve": curve}]).path
    np.testing.assert_allclose(constraint.number("speeds"), [0.0, 2.0 * np.pi, 7.0])
    np.testing.assert_allclose(constraint.number("values"), [2.0, 1.5, 1.0])


NOT_CONCAVE = "curve: got torques that fall less steeply after 2, expected torques that fall ever faster"


@pytest.mark.parametrize(
    ("curve", "says"),
    [
        ([[0, 2], [2, 1], [4, 0.5]], NOT_CONCAVE),
        ([[0, 2], [2, 2.5]], "none that rises"),
        ([[0, 2], [2, -1]], "none that rises or is below 0"),
        ([[1, 2], [2, 1]], "speeds that rise from 0 on"),
        ([[0, 2], [2, 1], [2, 0.5]], "speeds that rise from 0 on"),
        ([[0, 2]], "two or more rows"),
        ([[0, 2, 1], [2, 1, 1]], "curve"),
        ([[0, 2], [2, float("inf")]], "curve"),
        ([[0, 2], ["1 N m", 1]], "got '1 N m' in row 1, a torque or an energy, expected a number in rad/s"),
        ([[0, "2 rpm"], [2, 1]], "got '2 rpm' in row 0, an angular speed, expected a number in N m"),
    ],
)
def test_what_is_no_table_of_a_motor_is_refused(rotor: mbocp.Robot, curve: Any, says: str) -> None:
    with pytest.raises(ProblemError, match=says):
        spin(rotor, 1.0, path=[{"kind": "motor", "frame": "axle", "curve": curve}])


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ({"curve": CURVE}, "curve and stall; which of the two"),
        ({"stall": -1.0}, "stall: got -1.0, expected above 0"),
        ({"no_load": 0.0}, "no_load: got 0.0, expected above 0"),
        ({"no_load": None}, "no_load: this key is missing"),
        ({"frame": "wheel"}, "no joint with one angle"),
    ],
)
def test_what_is_no_motor_is_refused(rotor: mbocp.Robot, words: dict[str, Any], says: str) -> None:
    table = {key: value for key, value in {**MOTOR, **words}.items() if value is not None}
    with pytest.raises(ProblemError, match=says):
        spin(rotor, 1.0, path=[table])


@pytest.mark.parametrize("kind", ["motor", "motor_speed"])
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            {"elastic": [{"joint": "joint2", "stiffness": 99.0, "motor_inertia": 0.1}]},
            "is elastic; name its motor",
        ),
        ({"actuated": ["joint1"]}, "no motor turns joint 'joint2' by a torque"),
        ({"dynamics": False}, "no motor turns joint 'joint2' by a torque"),
    ],
)
def test_joints_without_motors_of_their_own_are_refused(kind: str, words: Any, says: str) -> None:
    """Rows would see the speed of the link, and no torque."""
    numbers = {"stall": 2.0, "no_load": 5.0} if kind == "motor" else {"max": 2.0}
    path = [{"kind": kind, "frame": "joint2", **numbers}]
    with pytest.raises(ProblemError, match=says):
        Problem.create(mbocp.load_robot("double_pendulum", **words), 1.0, 5, path=path)


@pytest.fixture
def lifting(tmp_path: Any) -> mbocp.Robot:
    """A weight on a lever, which its motor cannot hold."""
    file = tmp_path / "lever.urdf"
    weight = '<inertial><origin xyz="0.5 0 0"/><mass'
    file.write_text(ROTOR.replace("<inertial><mass", weight).replace('xyz="0 0 1"', 'xyz="0 -1 0"'))
    return mbocp.load_robot(file)


def slow_down(lifting: mbocp.Robot, path: dict[str, Any], steps: int, **words: Any) -> Problem:
    """Lift the weight to a height in the least time, which is too heavy for the speed that it begins with."""
    return Problem.create(
        lifting,
        {"min": 0.05, "max": 2.0},
        steps,
        start={"v": [4.5]},
        goal={"q": [1.0]},
        cost={"time": 1.0, "effort": 1e-6},
        path=[path],
        **words,
    )


PATHS = [MOTOR, {"kind": "motor", "frame": "axle", "curve": CURVE}]


@pytest.mark.parametrize("scheme", ["se1", "gauss2"])
@pytest.mark.parametrize("path", PATHS)
def test_a_motor_that_slows_down_is_looked_at_between_nodes(
    lifting: mbocp.Robot, scheme: str, path: dict[str, Any]
) -> None:
    """A torque that is right for the speed at the end of a step is too large for that at its begin."""
    for steps, is_gross in ((3, True), (40, False)):
        s = OneSolve().run(Job.of(slow_down(lifting, path, steps, scheme=scheme)))
        (motor,) = s.problem.frame_constraints
        at_begins = motor.values_along(lifting, s.qs[:-1], s.vs[:-1], s.us)
        at_ends = motor.values_along(lifting, s.qs[1:], s.vs[1:], s.us)
        assert (at_ends <= motor.upper * (1.0 + 1e-5)).all()
        expected = ((at_begins - motor.upper) / motor.upper).max()
        assert s.limit_excess >= expected - 1e-9
        assert s.limit_excess_of.startswith("torque of motor of axle")
        assert (s.limit_excess > 0.05) is is_gross
        assert (str(s.status) == "under_resolved") is is_gross, s.advice


def rows_within(s: mbocp.Solution) -> np.ndarray:
    """A motor's rows over their bounds, on the cubics of the steps, shape (N, places, rows)."""
    (motor,) = s.problem.frame_constraints
    robot, h, found = s.problem.robot, np.diff(s.t)[:, None], []
    means = (s.qs[1:] - s.qs[:-1]) / h
    for share in np.linspace(0.0, 1.0, 41):
        bent = 6.0 * share * (1.0 - share)
        v = (1 - 4 * share + 3 * share**2) * s.vs[:-1] + (3 * share**2 - 2 * share) * s.vs[1:] + bent * means
        us = s.controls_at(s.t[:-1] + share * (1.0 - 1e-12) * h[:, 0])
        found.append(motor.values_along(robot, s.qs[:-1], v, us) / motor.upper)
    return np.stack(found, axis=1)


@pytest.mark.parametrize(
    ("scheme", "controls", "path"),
    [
        ("se1", "constant", PATHS[0]),
        ("midpoint", "constant", PATHS[1]),
        ("rk4", "constant", PATHS[0]),
        ("gauss2", "constant", PATHS[0]),
        ("gauss2", "linear", PATHS[1]),
        ("gauss2", "stages", PATHS[0]),
        ("gauss3", "stages", PATHS[1]),
    ],
)
def test_a_motor_that_would_leave_its_line_far_between_nodes_keeps_it_there(
    lifting: mbocp.Robot, scheme: str, controls: str, path: dict[str, Any]
) -> None:
    problem = slow_down(lifting, path, 3, scheme=scheme, controls=controls)
    at_nodes, s = OneSolve().run(Job.of(problem)), mbocp.solve(problem, check=True)
    fine = mbocp.solve(slow_down(lifting, path, 60, scheme=scheme, controls=controls), check=True)
    within = rows_within(s)[:, [0, -1]] if scheme == "se1" else rows_within(s)
    if controls == "constant" or rows_within(at_nodes).max() > 1.05:
        assert str(at_nodes.status) == "under_resolved"
        assert within.max() <= 1.0 + 1e-5
        assert s.duration > at_nodes.duration
        assert any(limit.name.endswith("at begins of steps") for limit in s.active_limits)
    assert s.duration == pytest.approx(fine.duration, rel=0.06 if scheme == "se1" else 0.01)


@pytest.mark.parametrize("controls", ["constant", "linear", "stages"])
def test_rows_of_motors_within_steps_have_exact_derivatives(lifting: mbocp.Robot, controls: str) -> None:
    problem = slow_down(lifting, PATHS[1], 3, scheme="gauss2", controls=controls)
    check_derivatives(formulate(replace(problem, limits_within="m")), 2, [0, 2])


def test_a_result_that_holds_motors_within_steps_is_a_warm_start(lifting: mbocp.Robot, tmp_path: Any) -> None:
    s = mbocp.solve(slow_down(lifting, MOTOR, 3, scheme="gauss2"), check=True)
    read = mbocp.Solution.load(s.save(tmp_path / "held.h5"))
    assert read.iterate is not None
    assert read.iterate.limits_within == "m"
    again = mbocp.solve(s.problem, warm_start=read, check=True)
    assert again.iterations <= 1
    assert again.duration == pytest.approx(s.duration, rel=1e-9)


def test_rows_of_a_motor_hold_within_the_steps_of_its_span_alone(lifting: mbocp.Robot) -> None:
    path = {**MOTOR, "from": {"share": 0.5}}
    formulation = formulate(replace(slow_down(lifting, path, 4, scheme="gauss2"), limits_within="m"))
    bounds, columns = formulation.programme.bounds, formulation.layout.states["lines_within"]
    assert bounds is not None
    lower, upper = bounds.x_lower[:, columns], bounds.x_upper[:, columns]
    np.testing.assert_array_equal(np.isfinite(upper).all(axis=1), [False, False, True, True])
    np.testing.assert_array_equal(lower, -upper)

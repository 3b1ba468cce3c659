"""Limits that makers publish, by name and from files of one's own."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import ProblemError
from mbocp.problem import Problem, load_problem, parse_problem, problem_to_toml
from mbocp.problem.file.profile import profile_names, profile_of
from mbocp.robot import Payload, Robot, load_parts
from mbocp.solution.sent import compute_motion_sent
from mbocp.solution.sent_checks import controls_along, path_excesses
from mbocp.solution.sent_states import Follower

DOCS = Path(__file__).parents[3] / "docs" / "profiles.md"
TURN = np.pi / 180.0
OWN = """
source = ["measured"]
joints = ["joint1", "joint2"]
velocity = [2.0, 3.0]
acceleration = { payload = [0, 2], values = [[8.0, 16.0], [4.0, 8.0]] }
"""


def problem(robot: Robot | str, limits: Any, **words: Any) -> Problem:
    return Problem.create(robot, 2.0, 20, limits=limits, goal={"v": 0}, **words)


@pytest.fixture
def own(tmp_path: Path) -> Path:
    file = tmp_path / "own.toml"
    file.write_text(OWN)
    return file


@pytest.fixture(scope="module")
def panda() -> Robot:
    return mbocp.load_robot("panda")


@pytest.mark.parametrize("name", profile_names())
def test_every_profile_is_whole(name: str) -> None:
    """It says where its numbers are from, which joints they are of, and is listed in the documentation."""
    profile = profile_of(name, mbocp.load_robot("ur5"), Path())
    assert profile is not None
    table, joints = profile.table, len(profile.table.joints)
    said = {key: value for key, value in dict(table).items() if value is not None}
    sources = " ".join(table.source)
    for key in ("position", "velocity", "acceleration", "effort"):
        assert key not in said or len(np.atleast_1d(said[key])) in (1, joints)
        assert key not in said or key in sources or len(table.source) == 1
    lower, upper = np.array(table.position).T
    assert (lower < upper).all()
    assert name in table.robots
    assert re.search(rf"^\| [^|]*`{name}`[^|]*\|", DOCS.read_text(), re.MULTILINE)


def test_a_robot_finds_its_profile_by_its_name() -> None:
    for limits in ("profile", {"profile": True}, {"profile": "ur5"}):
        bounds = problem("ur5", limits).limits
        np.testing.assert_array_equal(bounds.v_upper, np.full(6, 180.0 * TURN))
        np.testing.assert_array_equal(bounds.u_lower, [-150, -150, -150, -28, -28, -28])
        np.testing.assert_allclose(bounds.q_upper, TURN * np.array([360, 360, 180, 360, 360, 360]))
        assert not bounds.finite("a").any()


def test_joints_may_have_a_prefix_and_companions(panda: Robot) -> None:
    """The fingers are not the maker's seven joints, although their names end alike."""
    bounds = problem(panda, "profile").limits
    np.testing.assert_array_equal(bounds.j_upper[:7], [7500, 3750, 5000, 6250, 7500, 10000, 10000])
    assert bounds.finite("v").tolist() == [True] * 7 + [False] * 2


def test_two_arms_have_the_limits_of_each() -> None:
    arms = [{"name": "left", "robot": "ur5"}, {"name": "right", "robot": "ur5", "position": [0.0, 1.0, 0.0]}]
    bounds = problem(load_parts(arms), {"profile": "ur5"}).limits
    np.testing.assert_array_equal(bounds.v_upper, np.full(12, 180.0 * TURN))


def test_keys_beside_it_take_the_place_of_its_own(panda: Robot) -> None:
    bounds = problem(panda, {"profile": True, "velocity": 0.5, "jerk": {"panda_joint2": 100.0}}).limits
    np.testing.assert_array_equal(bounds.v_upper, np.full(9, 0.5))
    assert bounds.finite("j").sum() == 1
    assert bounds.finite("a").sum() == 7


def test_velocities_of_an_fr3_fall_towards_its_limits(panda: Robot) -> None:
    """The maker's formula, at random states."""
    path = problem(panda, {"profile": "fr3"}, start={"q": [0, 0, 0, -2, 0, 2, 0, 0, 0]}).path
    assert [constraint.kind for constraint in path] == ["braking"] * 7
    table = profile_of("fr3", panda, Path()).table  # type: ignore[union-attr]
    low, high = np.array(table.position).T
    reserve, deceleration = np.array(table.braking.reserve), np.array(table.braking.deceleration)
    rng, seen = np.random.default_rng(4), set()
    for _ in range(200):
        q, v = rng.uniform(low, high), rng.uniform(-3.0, 3.0, 7)
        most = np.maximum(np.sqrt(2.0 * deceleration * (high - q)) - reserve, 0.0)
        least = np.minimum(reserve - np.sqrt(2.0 * deceleration * (q - low)), 0.0)
        state = np.append(q, [0.0, 0.0]), np.append(v, [0.0, 0.0])
        for i, constraint in enumerate(path):
            values = constraint.values(panda, *state)
            is_kept = bool((values <= constraint.upper).all() and (values >= constraint.lower).all())
            if abs(v[i]) > reserve[i]:  # nearer to rest the row asks for the reserve, too
                assert is_kept == (least[i] <= v[i] <= most[i])
                seen.add(is_kept)
    assert seen == {False, True}


def test_one_of_ones_own(own: Path) -> None:
    robot = mbocp.load_robot("double_pendulum")
    bounds = problem(robot, {"profile": str(own)}).limits
    np.testing.assert_array_equal(bounds.v_upper, [2.0, 3.0])
    np.testing.assert_array_equal(bounds.a_upper, [8.0, 16.0])


def over_speed(folder: Path, values: str, speeds: str = "[0, 90, 360]", key: str = "speed") -> str:
    file = folder / "over_speed.toml"
    file.write_text(
        'source = ["x"]\njoints = ["joint1", "joint2"]\ndegrees = true\n'
        f"effort = {{ {key} = {speeds}, values = {values} }}"
    )
    return str(file)


def test_torques_that_fall_with_the_speed_are_a_limit_at_rest_and_lines(tmp_path: Path) -> None:
    """Without the flat part, which the limit at rest is."""
    limits = {"profile": over_speed(tmp_path, "[[6, 3], [6, 2.5], [1, 0]]")}
    one = problem("double_pendulum", limits, controls="linear")
    assert one.limits.u_upper.tolist() == [6.0, 3.0]
    assert [path.name for path in one.path] == [
        "over_speed's motor of joint1",
        "over_speed's motor of joint2",
    ]
    lines = [np.column_stack([path.number("speeds"), path.number("values")]) for path in one.path]
    np.testing.assert_allclose(lines[0], [[0.0, 6.0 + 5.0 / 3.0], [2.0 * np.pi, 1.0]])
    np.testing.assert_allclose(lines[1], [[0.0, 3.0], [np.pi / 2.0, 2.5], [2.0 * np.pi, 0.0]])
    assert not problem("double_pendulum", {"profile": over_speed(tmp_path, "[2, 2, 2]")}).path
    with pytest.raises(ProblemError, match="effort of joint2: got torques that fall less steeply"):
        problem("double_pendulum", {"profile": over_speed(tmp_path, "[[6, 3], [6, 1], [1, 0.5]]")})
    with pytest.raises(ProblemError, match="expected speeds that rise in speed, and a number or list"):
        problem("double_pendulum", {"profile": over_speed(tmp_path, "[[6, 3]]")})


def test_torques_are_those_behind_gears(tmp_path: Path) -> None:
    """The control of a joint with a gear is the torque before it."""
    limits = {"profile": over_speed(tmp_path, "[[6, 3], [6, 2.5], [1, 0]]")}
    geared = mbocp.load_robot("double_pendulum", motor=[{"joint": "joint1", "gear_ratio": 50.0}])
    bare, one = (problem(robot, limits, controls="linear") for robot in ("double_pendulum", geared))
    assert one.limits.u_upper.tolist() == [6.0 / 50.0, 3.0]
    for path, expected, ratio in zip(one.path, bare.path, (50.0, 1.0), strict=True):
        np.testing.assert_allclose(path.number("speeds"), expected.number("speeds") * ratio)
        np.testing.assert_allclose(path.number("values"), expected.number("values") / ratio)


def test_torques_over_payload_and_speed_are_those_between_two_loads(tmp_path: Path) -> None:
    """A table of each load by itself gives the same at that load; halfway, torques are the means."""
    file, robot = tmp_path / "both.toml", mbocp.load_robot("double_pendulum")
    light, heavy = [[6, 3], [6, 2.5], [1, 0]], [["4 N m", 2], [3.5, 2], [0.5, 0.25]]

    def carrying(
        mass: float, values: object, words: str = "payload = [1, 3], speed = [0, 90, 360]"
    ) -> Problem:
        text = 'source = ["x"]\njoints = ["joint1", "joint2"]\ndegrees = true\n'
        file.write_text(f"{text}effort = {{ {words}, values = {json.dumps(values)} }}")
        loaded = robot.with_payload(Payload(frame=robot.frame_names[-1], mass=mass))
        return problem(loaded, {"profile": str(file)})

    for mass, values in ((1.0, light), (3.0, heavy)):
        both, alone = carrying(mass, [light, heavy]), carrying(mass, values, "speed = [0, 90, 360]")
        np.testing.assert_array_equal(both.limits.u_upper, alone.limits.u_upper)
        for one, other in zip(both.path, alone.path, strict=True):
            np.testing.assert_array_equal(one.number("speeds"), other.number("speeds"))
            np.testing.assert_array_equal(one.number("values"), other.number("values"))
    half = carrying(2.0, [light, heavy])
    assert half.limits.u_upper.tolist() == [5.0, 2.5]
    np.testing.assert_allclose(half.path[0].number("values"), [5.0, 4.75, 0.75])
    with pytest.raises(
        ProblemError, match="says effort for payloads of 1 to 3 kg, and the robot carries 4 kg"
    ):
        carrying(4.0, [light, heavy])
    for wrong, says in (
        ([light], "expected masses that rise in payload, and a list over speed for each in values"),
        (
            [light, heavy[:2]],
            r"expected speeds that rise in speed, and a number or list for each in values\[1\]",
        ),
        ([light, 2.0], r"expected speeds that rise in speed, and a number or list for each in values\[1\]"),
        ([light, [[4, 2], [3], [0.5, 0.25]]], "has 1 entries in effort for 2 joints"),
    ):
        with pytest.raises(ProblemError, match=says):
            carrying(2.0, wrong)


def test_tables_of_torques_take_units(tmp_path: Path) -> None:
    values = '["6 N m", ["6 N m", "5500 N mm"], [1, 0]]'
    limits = {"profile": over_speed(tmp_path, values, '[0, "15 rpm", "1 turn/s"]')}
    one = problem("double_pendulum", limits)
    assert one.limits.u_upper.tolist() == [6.0, 6.0]
    np.testing.assert_allclose(one.path[0].number("speeds"), [0.0, 2.0 * np.pi])
    np.testing.assert_allclose(one.path[1].number("speeds"), [0.0, np.pi / 2.0, 2.0 * np.pi])
    np.testing.assert_allclose(one.path[1].number("values"), [6.0, 5.5, 0.0])
    at_payload = over_speed(tmp_path, "[6, 4]", '[0, "500 g"]', "payload")
    robot = mbocp.load_robot("double_pendulum")
    carrying = robot.with_payload(Payload(frame=robot.frame_names[-1], mass=0.25))
    assert problem(carrying, {"profile": at_payload}).limits.u_upper.tolist() == [5.0, 5.0]
    for speeds, texts, says in (
        ('[0, "2 N m"]', "[2, 1]", "'2 N m' at index 1 for 'speed', a torque or an energy, expected"),
        ("[0, 2]", '["2 rad/s", 1]', "got '2 rad/s' at index 0 for 'values', an angular speed, expected"),
        ('[0, "1 m/s"]', "[2, 1]", "effort.speed of 'over_speed': got '1 m/s', a speed, expected .* rad/s"),
    ):
        with pytest.raises(ProblemError, match=says):
            problem("double_pendulum", {"profile": over_speed(tmp_path, texts, speeds)})


def test_torques_over_the_speed_are_kept_as_a_motion_is_sent(tmp_path: Path) -> None:
    table = [[1.1, 0.62], [1.05, 0.6], [0.3, 0.2]]
    limits, goal = {"profile": over_speed(tmp_path, str(table))}, {"q": [1.5, -1.0], "v": 0}
    one = Problem.create(
        "double_pendulum", 0.4, 40, limits=limits, goal=goal, cost={"effort": 1.0}, controls="linear"
    )
    solution = mbocp.solve(one, check=True)
    assert "over_speed's motor of joint1.1" in {limit.name for limit in solution.active_limits}
    sent = compute_motion_sent(solution, 500.0)
    _, _, vs, us = controls_along(Follower.of(sent, one.robot))
    speeds = np.array([0.0, 90.0, 360.0]) * TURN
    most = np.array([np.interp(np.abs(vs[:, k]), speeds, np.array(table)[:, k]) for k in (0, 1)]).T
    drives = us * vs > 0.0
    assert (np.abs(us)[drives] < 1.02 * most[drives]).all()
    assert solution.export(tmp_path / "kept.csv", rate=500.0).exists()
    fast = Follower.of(replace(sent, curves=sent.curves.slow(0.9)), one.robot)
    assert "over_speed's motor of joint1.2" in {excess.name for excess in path_excesses(fast, one)[0]}


def test_limits_follow_the_payload(own: Path) -> None:
    robot = mbocp.load_robot("double_pendulum")
    frame = robot.frame_names[-1]
    carrying = robot.with_payload(Payload(frame=frame, mass=0.5))
    np.testing.assert_array_equal(problem(carrying, {"profile": str(own)}).limits.a_upper, [7.0, 14.0])
    with pytest.raises(ProblemError, match="payloads of 0 to 2 kg, and the robot carries 3 kg"):
        problem(robot.with_payload(Payload(frame=frame, mass=3.0)), {"profile": str(own)})


def test_a_file_is_relative_to_the_problem(own: Path) -> None:
    file = own.parent / "swing.toml"
    lines = ["[horizon]", "duration = 1", "steps = 10", "[goal]", "v = 0", "[limits]", 'profile = "own.toml"']
    file.write_text("\n".join(['robot = "double_pendulum"', *lines]))
    np.testing.assert_array_equal(load_problem(file).limits.v_upper, [2.0, 3.0])


def test_a_result_says_numbers(panda: Robot) -> None:
    """What was solved does not change with the profile."""
    one = problem(panda, {"profile": "fr3"}, start={"q": [0, 0, 0, -2, 0, 2, 0, 0, 0]})
    text = problem_to_toml(one)
    again = parse_problem(text)
    assert "profile" not in again.document.tables["limits"]
    np.testing.assert_array_equal(again.limits.a_upper, one.limits.a_upper)
    assert [path.name for path in again.path] == [path.name for path in one.path]
    for same in (one, again):  # also of numbers of another one
        slow = {"name": "slow", "kind": "speed", "frame": "panda_hand", "max": 0.5}
        for path in ([], [slow], [slow]):  # its rows go with it, whatever else is asked for
            same = same.with_(path=path)
            names = [row.name for row in same.path if row.name != "slow"]
            assert (names, len(same.path)) == ([row.name for row in one.path], 7 + len(path))
        same = same.with_(path=same.path).with_(path=[])
        assert len(same.path) == 7
        other = same.with_(limits={"profile": "panda"})
        assert other.limits.a_upper[0] == 15.0
        assert not other.path
        assert not same.with_(path=same.path).with_(limits={"profile": False}).path
        tools = same.with_(path=[slow]).path[:1]  # as a value, in place of keys
        for with_tool in (same.with_(path=tools), same.with_(path=[slow])):
            assert [row.name for row in with_tool.path] == ["slow", *(row.name for row in one.path)]
            assert [row.name for row in with_tool.with_(limits={"profile": "panda"}).path] == ["slow"]
            renewed = with_tool.with_(limits={"profile": "panda"}).with_(limits={"profile": "fr3"})
            assert len(renewed.path) == len(with_tool.with_(path=tools, limits={"profile": "fr3"}).path) == 8
        assert [path.name for path in same.with_(limits={"profile": "fr3"}).path] == [
            p.name for p in one.path
        ]


@pytest.mark.parametrize(
    ("robot", "limits", "words"),
    [
        (
            "double_pendulum",
            "profile",
            "no profile is for a robot of the name 'double_pendulum'; name one of",
        ),
        ("ur5", {"profile": "ur5f"}, "did you mean 'ur5' or 'ur5e'"),
        ("ur5", {"profile": "panda"}, "is about the joints joint1, .* which robot 'ur5' does not have"),
        ("ur5", "fast", 'expected "profile" or a table'),
        ("ur5", {"profile": 3}, "expected true, a name or a path"),
    ],
)
def test_what_is_refused(robot: str, limits: Any, words: str) -> None:
    with pytest.raises(ProblemError, match=words):
        problem(robot, limits)


def test_degrees_are_of_joints_that_turn(tmp_path: Path) -> None:
    robot = mbocp.load_robot("cart_pendulum_elastic")
    name = next(label.name for label in robot.v_labels if label.unit == "m/s")
    (tmp_path / "cart.toml").write_text(f'source = ["x"]\njoints = ["{name}"]\ndegrees = true\nvelocity = 90')
    with pytest.raises(ProblemError, match=f"is in degrees, but '{name}' slides"):
        problem(robot, {"profile": str(tmp_path / "cart.toml")})


def test_phases_have_none() -> None:
    phases = [{"name": "a", "duration": 1.0, "steps": 5, "limits": {"profile": True}}]
    with pytest.raises(ProblemError, match="belongs into"):
        Problem.create("ur5", phase=phases)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("joints = []", "source: this key is missing"),
        (
            'source = ["x"]\njoints = ["joint1", "joint2"]\nvelocity = [1.0]',
            "1 entries in velocity for 2 joints",
        ),
        ('source = ["x"]\njoints = ["joint1"]\nspeed = 1.0', "speed"),
        ('source = ["x"]\njoints = ["joint1"]\nvelocity = "fast"', "velocity"),
        (
            'source = ["x"]\njoints = ["joint1"]\njerk = { payload = [1, 0], values = [1, 2] }',
            "masses that rise",
        ),
        ('source = ["x"]\njoints = ["joint1"]\njerk = { mass = [1], values = [1] }', "payload and values"),
        ('source = ["x"]\njoints = ["joint1"]\njerk = { payload = 1, values = [1] }', "expected lists"),
        ('source = ["x"]\njoints = ["joint1"]\nposition = [[1.0, -1.0]]', "position"),
        ("source =", "TOML"),
    ],
)
def test_files_that_are_wrong(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "own.toml").write_text(text)
    with pytest.raises(ProblemError, match=words):
        problem("double_pendulum", {"profile": str(tmp_path / "own.toml")})


def test_its_numbers_may_have_units(tmp_path: Path) -> None:
    """Whether those without one are degrees or not."""
    units = 'velocity = ["90 deg/s", %s]\nposition = [["-1 turn", "1 turn"], [-inf, inf]]\neffort = "5 kN mm"'
    for number, more in (("3.0", ""), (f"{3.0 / TURN!r}", "degrees = true\n")):
        file = tmp_path / "units.toml"
        file.write_text(f'source = ["measured"]\njoints = ["joint1", "joint2"]\n{more}{units % number}\n')
        bounds = problem("double_pendulum", {"profile": str(file)}).limits
        np.testing.assert_allclose(bounds.v_upper, [np.pi / 2.0, 3.0], rtol=1e-15)
        np.testing.assert_allclose(bounds.q_upper, [2.0 * np.pi, np.inf])
        np.testing.assert_allclose(bounds.u_upper, 5.0)
    file.write_text(file.read_text().replace("90 deg/s", "90 mm/s"))
    with pytest.raises(ProblemError, match=r"velocity of 'units': got '90 mm/s', a speed, .* in rad/s"):
        problem("double_pendulum", {"profile": str(file)})

"""Path constraints: how they are written, what they mean, and what is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.exceptions import DimensionMismatch, InvalidValue, MbocpError, ProblemError, UnknownFrame
from mbocp.problem import PathConstraint, Problem, parse_problem, problem_to_toml
from mbocp.robot import Robot

Loader = Callable[..., Problem]

FLOOR = '{name="floor", kind="position", frame="tool0", z=[-0.5, inf]}'
CLEAR = '{kind="distance", frame="tool0", point=[0, 0, 0.1], min=0.2, max=2}'
FOLDED = '{name="folded", kind="distance", frame="tool0", frame_b="base_link", max=1.5}'
SLOW = '{name="slow", kind="speed", frame="wrist_3_link", max=3}'


def test_what_is_written_is_what_holds(load: Loader, ur5: Robot) -> None:
    floor, clear, folded, slow = load(f"path=[{FLOOR},{CLEAR},{FOLDED},{SLOW}]").path
    assert (floor.kind, floor.frame, floor.axes) == ("position", ur5.frame_id("tool0"), (2,))
    assert [label.name for label in floor.labels] == ["floor.z"]
    np.testing.assert_array_equal([floor.lower, floor.upper], [[-0.5], [np.inf]])
    assert clear.name == "distance of tool0"
    assert clear.other is None
    np.testing.assert_array_equal([*clear.point, *clear.lower, *clear.upper], [0, 0, 0.1, 0.2, 2])
    assert folded.other == ur5.frame_id("base_link")
    np.testing.assert_array_equal([folded.lower, folded.upper], [[-np.inf], [1.5]])
    assert [(label.name, label.unit) for label in slow.labels] == [("slow", "m/s")]


def test_values_are_those_of_the_kinematics(load: Loader, ur5: Robot) -> None:
    box = '{name="box", kind="position", frame="tool0", x=[-9, 9], z=[-9, 9]}'
    path = load(f"path=[{box},{CLEAR},{FOLDED},{SLOW}]").path
    rng = np.random.default_rng(3)
    q, v = ur5.integrate(ur5.q0, rng.standard_normal(6)), rng.standard_normal(6)
    data = ur5.model.createData()
    pin.framesForwardKinematics(ur5.model, data, q)
    tool, base = (data.oMf[ur5.frame_id(name)].translation for name in ("tool0", "base_link"))
    expected = [tool[0], tool[2], np.linalg.norm(tool - [0, 0, 0.1]), np.linalg.norm(tool - base)]
    found = np.concatenate([constraint.values(ur5, q, v) for constraint in path])
    np.testing.assert_allclose(found[:4], expected, atol=1e-14)
    step = 1e-6  # central differences of the position along the motion
    ends = []
    for sign in (1, -1):
        pin.framesForwardKinematics(ur5.model, data, ur5.integrate(q, sign * step * v))
        ends.append(data.oMf[ur5.frame_id("wrist_3_link")].translation.copy())
    assert found[4] == pytest.approx(np.linalg.norm(ends[0] - ends[1]) / (2 * step), rel=1e-8)


def test_there_is_none_by_default_and_all_read_back(load: Loader) -> None:
    assert load().path == ()
    written = load(f"path=[{FLOOR},{CLEAR},{FOLDED},{SLOW}]")
    again = parse_problem(problem_to_toml(written))
    assert len(again.path) == 4
    for a, b in zip(written.path, again.path, strict=True):
        assert (a.name, a.kind, a.frame, a.other, a.axes) == (b.name, b.kind, b.frame, b.other, b.axes)
        for key in ("point", "lower", "upper"):
            np.testing.assert_array_equal(getattr(a, key), getattr(b, key))


def test_tables_of_a_file(load: Loader) -> None:
    extra = '[[path]]\nkind = "position"\nframe = "tool0"\nz = [0, 3]\nx = [-2, 2]\n'
    (constraint,) = load(extra=extra).path
    assert constraint.axes == (0, 2)
    np.testing.assert_array_equal(constraint.lower, [-2, 0])


@pytest.mark.parametrize(
    ("table", "key", "reason"),
    [
        (
            "{kind='place', frame='tool0'}",
            "path.0.kind",
            """got 'place', expected "position" | "distance" """,
        ),
        ("{frame='tool0'}", "path.0.kind", "this key is missing"),
        ("{kind='position'}", "path.0.frame", "this key is missing"),
        ("{kind='speed', frame='tool', max=1}", "path.0", "has no frame 'tool': did you mean 'tool0'?"),
        ("{kind='position', frame='tool0'}", "path.0", "bounds nothing; give x, y or z as [lower, upper]"),
        ("{kind='position', frame='tool0', x=3}", "path.0.x", "got 3, expected [lower, upper]"),
        ("{kind='position', frame='tool0', x=[3, nan]}", "path.0.x", "got nan, expected a number"),
        ("{kind='position', frame='tool0', max=3}", "path.0.max", 'kind = "position" does not use it, but x'),
        ("{kind='position', frame='tool0', w=3}", "path.0.w", "unknown key (allowed in [path]: name, kind, "),
        ("{kind='distance', frame='tool0', max=3}", "path.0", "give frame_b or point"),
        (
            "{kind='distance', frame='tool0', frame_b='base', point=[0,0,0], max=3}",
            "path.0",
            "a distance is between two things",
        ),
        ("{kind='distance', frame='tool0', point=[0,0], max=3}", "path.0.point", "expected a list of 3"),
        ("{kind='distance', frame='tool0', point=[0,0,0]}", "path.0", "bounds nothing; give min or max"),
        (
            "{kind='speed', frame='tool0', x=[0,1]}",
            "path.0.x",
            'kind = "speed" does not use it, but min, max',
        ),
        ("{kind='speed', frame='tool0'}", "path.0", "bounds nothing; give min or max"),
        ("3", "path.0", "got 3, expected a table"),
    ],
)
def test_wrong_tables_name_file_key_got_and_allowed(load: Loader, table: str, key: str, reason: str) -> None:
    with pytest.raises(MbocpError) as caught:
        load(f"path=[{table}]".replace("'", '"'))
    assert f"arm.toml: {key}: " in str(caught.value)
    assert reason in str(caught.value)


def test_an_unknown_frame_keeps_its_class(load: Loader) -> None:
    with pytest.raises(UnknownFrame, match=r"arm\.toml: path\.0: robot 'ur5' has no frame 'tool'"):
        load('path=[{kind="speed", frame="tool", max=1}]')


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        (
            '{name="a", kind="position", frame="tool0", z=[2, 3]}',
            r"path 'a': at the start a\.z is .* below its",
        ),
        (
            '{name="b", kind="distance", frame="tool0", point=[0,0,0], max=0.1}',
            "path 'b': at the start b is .*",
        ),
        (
            '{name="c", kind="position", frame="tool0", x=[-9, 0.3]}',
            r"path 'c': at the goal c\.x is .* above i",
        ),
    ],
)
def test_what_excludes_start_or_goal_is_refused(load: Loader, table: str, reason: str) -> None:
    with pytest.raises(ProblemError, match=reason):
        load(f"path=[{table}]")


def test_speed_at_start_and_goal(load: Loader) -> None:
    with pytest.raises(
        ProblemError, match=r"path 'slow': at the start slow is .* m/s, above its bound 3; move"
    ):
        load(f"path=[{SLOW}]", "start.v=[0, 9, 0, 0, 0, 0]")
    with pytest.raises(ProblemError, match="path 'slow': at the goal slow"):
        load(f"path=[{SLOW}]", "goal.v=[0, 9, 0, 0, 0, 0]")
    load(f"path=[{SLOW}]", "goal.v={elbow_joint=9}")  # the other joints are free


def test_names_are_told_apart(load: Loader) -> None:
    with pytest.raises(ProblemError, match="path 'floor': there are several of this name"):
        load(f"path=[{FLOOR}, {FLOOR}]")


def test_other_methods_cannot_keep_paths(load: Loader) -> None:
    with pytest.raises(ProblemError, match=r'solver\.method: got "fbsm_newton", which cannot keep \[path\]'):
        load(f"path=[{FLOOR}]", "solver=fbsm_newton")
    assert all(load(f"path=[{FLOOR}]", f"solver={method}").path for method in ("monolithic", "fatrop"))


def made(**changes: Any) -> PathConstraint:
    words = {"name": "p", "kind": "speed", "frame": 1, "lower": [-np.inf], "upper": [1.0]}
    return PathConstraint(**{**words, **changes})


def test_python_is_checked_too(load: Loader) -> None:
    for changes, error, reason in (
        ({"kind": "place"}, InvalidValue, "path 'p': kind: got 'place'"),
        ({"axes": (0,)}, ProblemError, "path 'p': axes belong to a position"),
        ({"kind": "position"}, ProblemError, "path 'p': bounds nothing"),
        ({"lower": [0, 1]}, DimensionMismatch, r"path 'p': lower: got shape \(2,\), expected \(1,\)"),
        ({"upper": [np.inf]}, InvalidValue, r"path 'p': got \[-inf, inf\], expected a finite bound"),
        ({"lower": [2.0]}, InvalidValue, "the lower not above the upper"),
        ({"point": [0.0]}, DimensionMismatch, "path 'p': point"),
    ):
        with pytest.raises(error, match=reason):
            made(**changes)
    with pytest.raises(DimensionMismatch, match="path 'p': frame 999"):
        load().with_(path=[made(frame=999)])


def part(load: Loader, times: str = "", *settings: str) -> Problem:
    return load(f'path=[{{frame="tool0", kind="speed", max=0.5{times}}}]', *settings)


def test_a_part_of_the_horizon_has_its_nodes(load: Loader) -> None:
    problem = part(load, ", from=0.21, until=0.5")
    N, dt = problem.num_steps, problem.dt
    times = dt * np.arange(1, N + 1)
    nodes = problem.path[0].span.nodes(N, dt)
    assert np.array_equal(nodes, (times >= 0.21 - 1e-9) & (times <= 0.5 + 1e-9))
    assert part(load).path[0].span.nodes(N, dt).all()
    last = part(load, f", from={problem.duration}").path[0].span
    assert np.flatnonzero(last.nodes(N, dt)).tolist() == [N - 1]
    assert not last.has_start
    assert last.has_end(N, dt)


@pytest.mark.parametrize(
    ("times", "message"),
    [
        ("from=-0.1", "from: got -0.1, expected a time from the start on"),
        ("from=0.5, until=0.4", "until: got 0.4, expected a time not before from = 0.5"),
        ("until=99.0", "until: got 99.*within the horizon"),
        ("from=99.0", "from: got 99.*within the horizon"),
        ("until=0.0", "no node after the start is between from = 0 s and until = 0 s"),
        ('from="soon"', "from: no via point or phase 'soon'; there are none"),
        ("from=true", "from: .*number"),
    ],
)
def test_times_outside_the_horizon_are_refused(load: Loader, times: str, message: str) -> None:
    with pytest.raises(MbocpError, match=message):
        part(load, f", {times}")


def test_a_part_of_a_free_duration_is_refused(load: Loader) -> None:
    with pytest.raises(MbocpError, match="from: a time of given steps"):
        part(load, ", from=0.2", "horizon.duration={min=0.5, max=2.0}")


def test_times_survive_the_text(load: Loader) -> None:
    problem = part(load, ", from=0.25, until=0.5")
    text = problem_to_toml(problem)
    assert "from = 0.25" in text
    assert parse_problem(text).path[0].span == problem.path[0].span
    assert "until = " not in problem_to_toml(part(load))


def test_a_constraint_away_from_start_and_goal_may_exclude_both(load: Loader) -> None:
    far = 'path=[{{frame="tool0", kind="position", x=[5, 6], from={}, until=0.4}}]'
    assert load(far.format(0.3)).path[0].rows == 1
    with pytest.raises(MbocpError, match="at the start"):
        load(far.format(0.0))


def test_equal_bounds_are_an_equation(load: Loader) -> None:
    problem = load('path=[{frame="tool0", kind="position", x=[5, 5], from=0.3, until=0.4}]')
    lower, upper = problem.path[0].inner_bounds
    assert lower == upper == 5.0


def test_a_tool_moves_at_a_constant_speed_between_lead_in_and_lead_out() -> None:
    """Along a line, from a start at rest and to an end at rest."""
    speed = {"kind": "speed", "min": 0.2, "max": 0.2, "from": {"share": 0.3}, "until": {"share": 0.7}}
    line = {"kind": "line", "tolerance": 0.002}
    problem = Problem.create(
        "ur5",
        4.0,
        60,
        start={"q": [0, -1.57, 1.57, -1.57, -1.57, 0]},
        goal={"frame": {"name": "tool0", "position": [0.35, -0.35, 0.25]}, "v": 0},
        path=[{"frame": "tool0", **speed}, {"frame": "tool0", **line}],
    )
    s = mbocp.solve(problem, check=True)
    still = np.zeros((len(s.qs), problem.robot.nu))
    speeds = problem.path[0].values_along(problem.robot, s.qs, s.vs, still)[:, 0]
    share = s.t / s.t[-1]
    held = (share > 0.3 - 1e-9) & (share < 0.7 + 1e-9)
    assert held.sum() == 25
    np.testing.assert_allclose(speeds[held], 0.2, atol=1e-7)
    assert speeds[[0, -1]] == pytest.approx(np.zeros(2), abs=1e-6)


def test_a_speed_along_a_direction_has_a_sign(load: Loader) -> None:
    along = '{kind="speed", frame="tool0", direction=[0,-2,0], min=-0.3, max=0.2}'
    problem = load(f"path=[{along}]")
    (row,), robot, q = problem.path, problem.robot, problem.q_start
    v = np.linspace(0.1, 0.6, robot.nv)
    pin.forwardKinematics(robot.model, data := robot.model.createData(), q, v)
    velocity = pin.getFrameVelocity(
        robot.model, data, robot.frame_id("tool0"), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    )
    for sign in (1.0, -1.0):
        np.testing.assert_allclose(row.values(robot, q, sign * v), [-sign * velocity.linear[1]], atol=1e-12)
    again = parse_problem(problem_to_toml(problem))
    np.testing.assert_array_equal(again.path[0].number("direction"), [0, -2, 0])
    with pytest.raises(ProblemError, match="a direction"):
        load(f"path=[{along.replace('-2', '0')}]")


def test_a_least_speed_all_the_way_is_refused_where_a_motion_rests(load: Loader) -> None:
    with pytest.raises(ProblemError, match=r"below its bound 0\.1"):
        load("path=[{kind='speed', frame='tool0', min=0.1}]".replace("'", '"'))

"""A frame follows a path at its own pace: on it or in a tube, turned as it says, from begin to end."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.exceptions import MbocpError, ProblemError
from mbocp.formulation import formulate
from mbocp.formulation.features.path_progress import advances
from mbocp.problem import Problem, load_problem, parse_problem, problem_to_toml
from mbocp.robot import load_robot
from mbocp.solution import Solution
from mbocp.view.marks import marks_of, marks_of_result

EXAMPLES = Path(__file__).parents[2] / "examples"
START = {"q": [0, -1.57, 1.57, -1.57, -1.57, 0]}
N = 12
ANGLE = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
CIRCLE = (0.1 * np.column_stack([0 * ANGLE, np.cos(ANGLE) - 1, np.sin(ANGLE)])).tolist()
EIGHT = [[0, 0, 0], [0.04, 0.1, 0], [0.12, 0.12, 0], [0, 0, 0], [-0.04, -0.1, 0], [-0.12, -0.12, 0]]
ROUND = {"points": CIRCLE, "closed": True, "relative": True}
HALF = {"points": CIRCLE[:5], "relative": True}


def turning(amount: float = 0.3) -> list[list[float]]:
    """Orientations along the circle that swing to and fro."""
    R = load_robot("ur5").frame_placement("tool0", START["q"]).rotation
    turns = [R @ pin.exp3(np.array([amount * np.sin(a), 0, 0])) for a in ANGLE]
    return [pin.Quaternion(turn).coeffs().tolist() for turn in turns]


def arm(*paths: dict[str, Any], **words: Any) -> Problem:
    given = {"goal": {"v": 0}, "cost": {"effort": 1.0, "velocity": 100.0}, **words}
    path = [{"kind": "follow", "frame": "tool0", **table} for table in paths]
    return Problem.create(
        "ur5",
        given.pop("duration", 2.0),
        given.pop("steps", N),
        start=START,
        path=path,
        **{"integrator": {"scheme": "se1"}, **given},
    )


def solved(problem: Problem, method: str = "monolithic") -> Solution:
    solution = mbocp.solve(problem.with_(solver={"method": method}))
    assert solution.converged, solution.advice
    assert solution.limit_violation <= 1e-8
    return solution


def along(problem: Problem, solution: Solution, k: int = 0) -> tuple[Any, Any]:
    """Progress, and distance of the frame from where it is to be."""
    constraint = problem.path[k]
    assert isinstance(constraint, mbocp.problem.PathConstraint)
    name = problem.robot.frame_names[constraint.frame]
    places = np.array([problem.robot.frame_placement(name, q).translation for q in solution.qs])
    s = constraint.progress(problem.robot, solution.qs)
    curve = constraint.term.curve(constraint)  # type: ignore[attr-defined]
    return s, np.linalg.norm(places - curve.at(s)[:, :3], axis=1)


@pytest.mark.parametrize(
    ("path", "scheme"),
    [
        (ROUND, "se1"),
        (HALF, "se2"),
        (HALF, "euler"),
        ({**ROUND, "tolerance": 0.01}, "se1"),
        ({**ROUND, "tolerance": 0.01}, "midpoint"),
    ],
    ids=["closed", "open", "explicit", "tube", "tube by midpoint"],
)
def test_the_tool_is_on_the_path_from_its_begin_to_its_end(path: dict[str, Any], scheme: str) -> None:
    problem = arm(path, scheme=scheme)
    own = solved(problem)
    s, away = along(problem, own)
    tolerance = path.get("tolerance", 0.0)
    assert away.max() == pytest.approx(tolerance, abs=1e-8)
    assert s[0] == pytest.approx(0.0, abs=1e-6)
    assert s[-1] == pytest.approx(1.0, abs=1e-6)
    assert np.diff(s).max() < 8.0 / N
    assert own.cost == pytest.approx(solved(problem, "ipopt").cost, rel=1e-7)


def test_a_wider_tube_costs_less() -> None:
    costs = [solved(arm({**ROUND, "tolerance": tolerance})).cost for tolerance in (0.02, 0.01, 0.0)]
    assert costs == sorted(costs)
    assert costs[0] < 0.97 * costs[2]


@pytest.mark.parametrize("tolerance", [0.0, 0.1])
def test_it_turns_as_the_path_says(tolerance: float) -> None:
    problem = arm({**ROUND, "orientations": turning(), "orientation_tolerance": tolerance})
    solution = solved(problem)
    s, away = along(problem, solution)
    assert away.max() < 1e-8
    (constraint,) = problem.frame_constraints
    asked = constraint.term.curve(constraint).at(s)[:, 3:]  # type: ignore[attr-defined]
    asked /= np.linalg.norm(asked, axis=1)[:, None]
    turns = [problem.robot.frame_placement("tool0", q).rotation for q in solution.qs]
    angles = [
        np.linalg.norm(pin.log3(pin.Quaternion(*x).matrix().T @ R))
        for x, R in zip(asked[:, [3, 0, 1, 2]], turns, strict=True)
    ]
    assert max(angles) == pytest.approx(tolerance, abs=1e-6)
    assert solution.cost == pytest.approx(solved(problem, "ipopt").cost, rel=1e-7)


def test_the_pace_is_the_best_of_all() -> None:
    """The same motion at a given pace costs more, unless the pace is the one that was found."""
    problem = arm(HALF)
    best = solved(problem)
    s, _ = along(problem, best)
    curve = problem.path[0].term.curve(problem.path[0])  # type: ignore[union-attr]

    def at_pace(shares: Any) -> float:
        places = curve.at(shares)[1:]
        boxes = [
            {
                "kind": "position",
                "frame": "tool0",
                "name": f"n{n}",
                "from": 2.0 * n / N,
                "until": 2.0 * n / N,
                **{axis: [value, value] for axis, value in zip("xyz", place, strict=True)},
            }
            for n, place in enumerate(places, start=1)
        ]
        words = {"goal": {"v": 0}, "cost": {"effort": 1.0, "velocity": 100.0}}
        timed = Problem.create(
            "ur5", 2.0, N, start=START, path=boxes, **{"integrator": {"scheme": "se1"}, **words}
        )
        return mbocp.solve(timed, warm_start=best).cost

    assert at_pace(s) == pytest.approx(best.cost, rel=1e-6)
    even = np.linspace(0.0, 1.0, N + 1)
    smooth = even**2 * (3 - 2 * even)
    assert at_pace(0.5 * s + 0.5 * smooth) > best.cost * (1 + 1e-6)


def test_for_a_part_of_the_time() -> None:
    start = load_robot("ur5").frame_placement("tool0", START["q"]).translation
    points = (np.array(CIRCLE[:5]) + start + [0.05, 0.1, 0.0]).tolist()
    problem = arm({"points": points, "from": 0.5, "until": 1.5})
    e, first, last = advances(problem)[:, 0], N // 4, 3 * N // 4
    assert np.flatnonzero(e).tolist() == list(range(first, last))
    assert e.sum() == pytest.approx(1.0)
    solution = solved(problem)
    robot = problem.robot
    places = np.array([robot.frame_placement("tool0", q).translation for q in solution.qs])
    assert places[first] == pytest.approx(points[0], abs=1e-9)
    assert places[last] == pytest.approx(points[-1], abs=1e-9)
    assert np.linalg.norm(places[0] - points[0]) > 0.05
    assert solution.cost == pytest.approx(solved(problem, "ipopt").cost, rel=1e-7)


def test_with_a_free_duration() -> None:
    words = {"duration": {"min": 0.2, "max": 5.0}, "cost": {"time": 1.0, "effort": 1e-4, "velocity": 0.0}}
    problem = arm(HALF, steps=16, limits={"effort": True, "velocity": 2.0}, **words)
    own, other = solved(problem), solved(problem, "ipopt")
    assert own.duration == pytest.approx(other.duration, rel=1e-5)
    assert along(problem, own)[1].max() < 1e-8


@pytest.mark.parametrize("tolerance", [0.0, 0.01])
def test_a_torch_keeps_its_angle_to_the_path(tolerance: float) -> None:
    """An axis that is 0.5 rad from the path at the start, along a quarter of a circle."""
    R = load_robot("ur5").frame_placement("tool0", START["q"]).rotation
    path = {"points": CIRCLE[:3], "relative": True, "tolerance": tolerance}
    tangent = arm(path).path[0].term.curve(arm(path).path[0]).at(np.zeros(1), 1)[0]
    tangent /= np.linalg.norm(tangent)
    across = np.cross(tangent, [1.0, 0.0, 0.0])
    axis = R.T @ (np.cos(0.5) * tangent + np.sin(0.5) * across)
    problem = arm({**path, "axis": axis, "min": 0.3, "max": 0.7}, duration=1.0)
    solution = solved(problem)
    s, away = along(problem, solution)
    (constraint,) = problem.frame_constraints
    tangents = constraint.term.curve(constraint).at(s, 1)[:, :3]
    axes = np.array([problem.robot.frame_placement("tool0", q).rotation @ axis for q in solution.qs])
    cosines = (tangents * axes).sum(axis=1) / np.linalg.norm(tangents, axis=1)
    lean = np.arccos(cosines)
    assert 0.3 - 1e-6 <= lean.min() <= lean.max() <= 0.7 + 1e-6
    assert away.max() <= tolerance + 1e-8
    free = solved(arm(path, duration=1.0))
    assert free.cost < 0.9999 * solution.cost
    again = parse_problem(problem_to_toml(problem))
    np.testing.assert_allclose(again.path[0].inner_bounds, constraint.inner_bounds)
    np.testing.assert_array_equal(again.path[0].number("axis"), axis)
    assert {label.name for label in constraint.labels} >= {"follow of tool0.lean", "follow of tool0.end"}


def test_what_is_no_angle_to_a_path_is_refused() -> None:
    with pytest.raises(ProblemError, match=r"axis: how far from the direction of the path\? Give min or max"):
        arm({**HALF, "axis": [0, 0, 1]})
    with pytest.raises(ProblemError, match=r"axis: got .* expected a direction"):
        arm({**HALF, "axis": [0, 0, 0], "max": 0.5})
    with pytest.raises(ProblemError, match=r"max: got 4\.0, expected an angle between 0 and pi"):
        arm({**HALF, "max": 4.0})
    with pytest.raises(ProblemError, match=r"start follow of tool0.lean is .* rad, above its bound 0.1"):
        arm({**HALF, "axis": [0, 1, 0], "max": 0.1})


def test_two_frames_follow_two_paths() -> None:
    arms = {"part": [{"name": "a", "robot": "ur5"}, {"name": "b", "robot": "ur5", "position": [0, 1, 0]}]}
    pair = Problem.create(arms, 1.0, 4, goal={"v": 0}, scheme="se1")
    frames = [name for name in pair.robot.frame_names if name.endswith("tool0")]
    q = np.tile(START["q"], 2)
    tables = [
        {"kind": "follow", "frame": frame, **path} for frame, path in zip(frames, (HALF, ROUND), strict=True)
    ]
    problem = Problem.create(arms, 2.0, 16, start={"q": q}, goal={"v": 0}, path=tables, scheme="se1")
    assert [term.index for term in _terms(problem)] == [0, 1]
    solution = solved(problem)
    for k in range(2):
        s, away = along(problem, solution, k)
        assert away.max() < 1e-8
        assert s[[0, -1]] == pytest.approx([0.0, 1.0], abs=1e-6)


def _terms(problem: Problem) -> list[Any]:
    from mbocp.formulation.build import _structures

    return list(_structures(problem, "quaternion"))


@pytest.mark.parametrize("scheme", ["se1", "heun"])
@pytest.mark.parametrize(
    "path",
    [ROUND, {**ROUND, "tolerance": 0.01, "orientations": turning(), "orientation_tolerance": 0.1}],
    ids=["exact", "tube"],
)
def test_derivatives_of_steps_and_rows(path: dict[str, Any], scheme: str) -> None:
    programme = formulate(arm({**path, "until": 1.0}, scheme=scheme)).programme
    rng, kind = np.random.default_rng(3), programme.kind
    x0 = np.asarray(programme.x_start) + 0.1 * rng.standard_normal(kind.nx)
    x1 = x0 + 0.1 * rng.standard_normal(kind.nx)
    u, theta = rng.standard_normal(kind.nu), programme.theta
    step, h = 1e-6, 1e-5
    for stage in (2, N - 1):  # on the path, and after it
        rho = programme.rho.reshape(N, -1)[stage]

        def values(z: Any, rho: Any = rho) -> Any:
            b, a, w = np.split(z, [kind.nx, 2 * kind.nx])
            c, cost = programme.functions.function("values")(a, b, [], w, theta, rho)
            return np.append(np.asarray(c).ravel(), float(cost))

        z, d = np.concatenate([x1, x0, u]), rng.standard_normal(2 * kind.nx + kind.nu)
        out = programme.functions.function("jacobian")(x0, x1, [], u, theta, rho)
        slopes = np.vstack([np.asarray(ca.DM(out[2])), np.asarray(ca.DM(out[3]))])
        difference = (values(z + step * d) - values(z - step * d)) / (2 * step)
        assert np.allclose(slopes @ d, difference, rtol=1e-5, atol=1e-5 * (1 + np.abs(slopes).max()))
    function = programme.functions.function("path")
    m = rng.standard_normal(function.size1_out(0))

    def rows(x: Any) -> list[Any]:
        return [np.asarray(ca.DM(o)) for o in function(x, m, u, theta)]

    x1[-1] = 0.4321  # between two knots: third derivatives jump there
    _, slopes, upper = rows(x1)
    curvature, d = np.triu(upper) + np.triu(upper, 1).T, rng.standard_normal(kind.nx)
    ahead, back = rows(x1 + h * d), rows(x1 - h * d)
    assert np.allclose(slopes @ d, (ahead[0] - back[0]).ravel() / (2 * h), atol=1e-6 * np.abs(slopes).max())
    turned = (ahead[1] - back[1]).T @ m / (2 * h)
    assert np.allclose(curvature @ d, turned, atol=1e-5 * np.abs(curvature).max())


def test_new_points_of_the_same_number_compile_nothing() -> None:
    moved = [[x + 0.1 * y, 1.3 * y, z] for x, y, z in CIRCLE]
    one, other = (formulate(arm({**ROUND, "points": points})).programme for points in (CIRCLE, moved))
    assert one.functions.tapes.held == other.functions.tapes.held
    assert one.functions.library == other.functions.library
    assert not np.array_equal(one.theta, other.theta)


def test_points_from_files(tmp_path: Path) -> None:
    table = np.hstack([CIRCLE, turning()])
    np.savetxt(tmp_path / "named.csv", table, delimiter=",", header="x,y,z,qx,qy,qz,qw", comments="")
    np.savetxt(tmp_path / "plain.csv", table[:, :3], delimiter=",")
    np.save(tmp_path / "path.npy", table)
    text = problem_to_toml(arm())
    for name, has_turns in (("named.csv", True), ("plain.csv", False), ("path.npy", True)):
        path = (
            f'\n[[path]]\nkind = "follow"\nframe = "tool0"\nfile = "{name}"\nclosed = true\nrelative = true\n'
        )
        file = tmp_path / "problem.toml"
        file.write_text(text + path)
        (found,) = load_problem(file).path
        given = {**ROUND, "orientations": turning()} if has_turns else ROUND
        (expected,) = arm(given).path
        assert found.term == expected.term  # type: ignore[union-attr]
        for key, value in expected.numbers_in("quaternion").items():
            assert found.numbers_in("quaternion")[key] == pytest.approx(value, abs=1e-12)


@pytest.mark.parametrize(
    "path",
    [
        ROUND,
        {"points": EIGHT, "closed": True, "relative": True},
        {**HALF, "tolerance": 0.02},
        {**ROUND, "orientations": turning(), "orientation_tolerance": 0.2, "name": "weld"},
        {**HALF, "orientations": turning()[:5], "tolerance": 0.01, "until": 1.0},
    ],
)
def test_it_is_written_and_read_back(path: dict[str, Any]) -> None:
    (old,) = (problem := arm(path)).path
    (new,) = parse_problem(problem_to_toml(problem)).path
    assert old.term == new.term  # type: ignore[union-attr]
    assert new.name == old.name
    assert old.span == new.span
    assert old.upper == pytest.approx(new.upper)
    for key, value in old.numbers_in("quaternion").items():
        assert new.numbers_in("quaternion")[key] == pytest.approx(value, rel=1e-9, abs=1e-9)


def test_replays_show_the_path(tmp_path: Path) -> None:
    problem = arm(ROUND, duration=2.0)
    (line,) = marks_of(problem).lines
    assert line.shape == (65, 3)
    radius = np.linalg.norm(line - line.mean(axis=0), axis=1)
    assert radius == pytest.approx(0.1, abs=0.01)
    solution = mbocp.solve(problem.with_(solver={"max_iterations": 1}))
    saved = Solution.load(solution.save(tmp_path / "result.h5"))
    (drawn,) = marks_of_result(saved, problem.robot).lines
    assert drawn == pytest.approx(line, abs=1e-9)


@pytest.mark.parametrize(
    ("path", "match"),
    [
        ({}, "which path"),
        ({"points": CIRCLE, "file": "a.csv"}, "which of the two"),
        ({"file": "nowhere.csv"}, "no such file"),
        ({"points": CIRCLE}, "at the start follow of tool0"),
        ({"points": [[0, 0, 0]], "relative": True}, "1 points"),
        ({"points": [[0, 0, 0], [0, 0, 0]], "relative": True}, "at the same place"),
        ({"points": [[0, 0, 0], [0, 0, 1e-3], [0, 0, 9e18]], "relative": True}, "0 and 1 at the same place"),
        ({"points": [*CIRCLE, CIRCLE[0]], "closed": True, "relative": True}, "does not repeat its first"),
        ({**ROUND, "tolerance": -1.0}, "a number >= 0"),
        ({**ROUND, "orientation_tolerance": 0.1}, "of what"),
        ({**ROUND, "orientations": turning()[:3]}, "one for each of 8 points"),
        ({**ROUND, "orientations": turning(3.0)}, "give points between"),
        ({**ROUND, "orientations": [[0, 0, 0, 0]] * 8}, "unit quaternions"),
        ({**ROUND, "orientations": turning(), "orientation_tolerance": 4.0}, "below pi"),
        ({**ROUND, "from": 1.0, "until": 1.0}, "no time to follow"),
        ({**ROUND, "a": [0, 0, 0]}, "does not use it"),
    ],
)
def test_refusals_say_which_and_why(path: dict[str, Any], match: str) -> None:
    with pytest.raises(MbocpError, match=match):
        arm(path)


def test_a_goal_elsewhere_is_refused() -> None:
    away = {"v": 0, "frame": {"name": "tool0", "position": [0.4, 0.2, 0.4]}}
    with pytest.raises(ProblemError, match="the path ends at"):
        arm(HALF, goal=away)
    with pytest.raises(ProblemError, match="at the goal follow of tool0"):
        arm(HALF, goal={"q": [0.3, -1.57, 1.57, -1.57, -1.57, 0], "v": 0})
    with pytest.raises(ProblemError, match='progress is for kind = "follow"'):
        arm({"kind": "orientation_kept"}).frame_constraints[0].progress(load_robot("ur5"), np.zeros((1, 6)))


def test_the_example_goes_all_the_way() -> None:
    problem = load_problem(EXAMPLES / "arms" / "follow_path.toml")
    solution = solved(problem)
    s, away = along(problem, solution)
    assert away.max() < 1e-8
    assert s[[0, -1]] == pytest.approx([0.0, 1.0], abs=1e-6)
    assert solution.duration < 1.1
    assert not {limit.name for limit in solution.active_limits} & {"follow of tool0.x", "follow of tool0.end"}

"""A frame on a straight line, and its orientation kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.exceptions import MbocpError, ProblemError
from mbocp.problem import Problem, ProblemWarning, load_problem, parse_problem, problem_to_toml
from mbocp.robot import Robot, load_robot
from mbocp.solution import Solution
from mbocp.view.marks import marks_of

EXAMPLES = Path(__file__).parents[2] / "examples"
START = {"q": [0, -1.57, 1.57, -1.57, -1.57, 0]}
GOAL = {"v": 0, "frame": {"name": "tool0", "position": [0.45, -0.2, 0.4]}}


def arm(*path: dict[str, Any], **words: Any) -> Problem:
    cost = {"effort": 1.0, "velocity": 100.0}
    kept = [{"frame": "tool0", **table} for table in path]
    return Problem.create(
        "ur5",
        1.5,
        24,
        start=START,
        path=kept,
        **{"integrator": {"scheme": "se1"}, "goal": GOAL, "cost": cost, **words},
    )


def solved(problem: Problem, method: str = "auto") -> Solution:
    solution = mbocp.solve(problem.with_(solver={"method": method}))
    assert solution.converged, solution.advice
    return solution


def aside(problem: Problem, solution: Solution) -> Any:
    """Distance of the tool from the line between its start and its goal at each node [m]."""
    places = [problem.robot.frame_placement("tool0", q).translation for q in solution.qs]
    along = np.array(GOAL["frame"]["position"]) - places[0]  # type: ignore[index]
    along /= np.linalg.norm(along)
    return np.array([np.linalg.norm(np.cross(along, p - places[0])) for p in places])


@pytest.mark.parametrize("tolerance", [0.0, 0.01])
def test_the_tool_stays_on_the_line(tolerance: float) -> None:
    free, problem = arm(), arm({"kind": "line", "tolerance": tolerance})
    assert aside(free, solved(free)).max() > 0.03
    solution = solved(problem)
    assert aside(problem, solution).max() == pytest.approx(tolerance, abs=1e-8)
    assert solution.cost == pytest.approx(solved(problem, "ipopt").cost, rel=1e-8)


@pytest.mark.parametrize("tolerance", [0.0, 0.05])
def test_the_tool_stays_between_the_ends_of_a_segment(tolerance: float) -> None:
    """It comes back at the end, beyond the point where it has to turn unless it is told to stay before."""
    a = load_robot("ur5").frame_placement("tool0", START["q"]).translation
    ahead = np.array(GOAL["frame"]["position"]) - a  # type: ignore[index]
    length = float(np.linalg.norm(ahead))
    goal = {"v": 0, "frame": {**GOAL["frame"], "velocity": -0.6 * ahead / length}}  # type: ignore[dict-item]
    del goal["v"]
    line = {"kind": "line", "tolerance": tolerance, "a": a, "b": a + 1.02 * ahead}
    free = arm(line, goal=goal).with_(num_steps=36)
    problem = arm({**line, "segment": True}, goal=goal).with_(num_steps=36)
    own, other = solved(problem), solved(problem, "ipopt")

    def furthest(solution: Solution) -> float:
        places = np.array([problem.robot.frame_placement("tool0", q).translation for q in solution.qs])
        return float(((places - a) @ ahead).max() / length)

    assert furthest(solved(free)) > 1.03 * length
    assert furthest(own) == pytest.approx(1.02 * length * 1.001, rel=1e-6)
    assert own.cost == pytest.approx(other.cost, rel=1e-7)
    assert {limit.name for limit in own.active_limits} >= {"line of tool0.along"}
    assert own.limit_violation <= 1e-8


@pytest.mark.parametrize("tolerance", [0.0, 0.1])
def test_the_tool_keeps_its_orientation(tolerance: float) -> None:
    problem = arm({"kind": "orientation_kept", "tolerance": tolerance})
    solution = solved(problem)
    turns = [problem.robot.frame_placement("tool0", q).rotation for q in solution.qs]
    angles = [float(np.linalg.norm(pin.log3(turns[0].T @ R))) for R in turns]
    assert max(angles) == pytest.approx(tolerance, abs=1e-7)


def test_they_are_written_and_read_back() -> None:
    problem = arm(
        {"kind": "line"},
        {"kind": "line", "name": "tube", "tolerance": 0.1, "segment": True},
        {"kind": "line", "name": "rod", "segment": True},
        {"kind": "orientation_kept", "tolerance": 0.2},
    )
    again = parse_problem(problem_to_toml(problem))
    for old, new in zip(problem.path, again.path, strict=True):
        assert old.term == new.term
        assert old.upper == pytest.approx(new.upper)
        for name, value in old.numbers_in("quaternion").items():
            assert new.numbers_in("quaternion")[name] == pytest.approx(value, abs=1e-12)


@pytest.mark.parametrize("scheme", ["midpoint", "heun", "rk4"])
def test_schemes_of_mean_velocities_are_told_of(scheme: str) -> None:
    """With what they say, problems are as easy as ever."""
    with pytest.warns(ProblemWarning, match='line of tool0.*"se1", or a tolerance'):
        arm({"kind": "line"}, scheme=scheme)
    arm({"kind": "line", "tolerance": 0.01}, scheme=scheme)
    arm({"kind": "line", "until": 1.0}, scheme=scheme)
    arm({"kind": "line"}, scheme=scheme, goal={"frame": GOAL["frame"]})
    arm({"kind": "line"}, scheme="se2")


def test_refusals_say_which_and_why() -> None:
    with pytest.raises(ProblemError, match="where does the line end"):
        arm({"kind": "line"}, goal={"q": {"elbow_joint": 1.0}, "v": 0})
    with pytest.raises(MbocpError, match="another point than a"):
        arm({"kind": "line", "a": [0.1, 0, 0], "b": [0.1, 0, 0]})
    with pytest.raises(MbocpError, match="tolerance: got -1"):
        arm({"kind": "line", "tolerance": -1.0})
    with pytest.raises(MbocpError, match="an angle below pi"):
        arm({"kind": "orientation_kept", "tolerance": 4.0})
    with pytest.raises(ProblemError, match="at the start line of tool0"):
        arm({"kind": "line", "a": [0.0, 0.3, 0.3]})


@pytest.mark.parametrize(
    ("file", "balls", "lines"),
    [("arms/straight_line", 0, 1), ("arms/via_points", 2, 0), ("free_flyer/gates", 3, 0)],
)
def test_examples_converge_from_their_default_guess(file: str, balls: int, lines: int) -> None:
    problem = load_problem(EXAMPLES / f"{file}.toml")
    marks = marks_of(problem)
    assert (len(marks.via), len(marks.lines)) == (balls, lines)
    solution = solved(problem)
    assert solution.limit_violation <= 1e-8
    equations = {name for name in solution.path_names if name.startswith("lift")}
    assert not equations & {limit.name for limit in solution.active_limits}


def test_the_tool_turns_no_faster_than_its_limit() -> None:
    """Four fifths of what it does without; solvers agree, and the limit is active."""

    def turning(problem: Problem, solution: Solution) -> Any:
        robot = problem.robot
        return np.array([_angular_speed(robot, q, v) for q, v in zip(solution.qs, solution.vs, strict=True)])

    plain = arm()
    most = float(turning(plain, solved(plain)).max())
    problem = arm({"kind": "angular_speed", "max": 0.8 * most})
    own, other = solved(problem), solved(problem, "ipopt")
    assert turning(problem, own).max() == pytest.approx(0.8 * most, rel=1e-7)
    assert own.cost == pytest.approx(other.cost, rel=1e-7)
    assert own.cost > solved(plain).cost
    assert [limit.kind for limit in own.active_limits] == ["path"]


def _angular_speed(robot: Robot, q: Any, v: Any) -> float:
    """By Pinocchio's own kinematics [rad/s]."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q, v)
    return float(np.linalg.norm(pin.getFrameVelocity(robot.model, data, robot.frame_id("tool0")).angular))

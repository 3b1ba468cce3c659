"""Via points: the motion goes through them at their node, and nothing holds elsewhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp.exceptions import MbocpError, ProblemError, UnknownFrame, UnreachablePose
from mbocp.mechanics import JointMechanics
from mbocp.problem import Problem, ProblemWarning, ViaPoint, load_problem, parse_problem, problem_to_toml
from mbocp.problem.timeline.via import ViaConstraint
from mbocp.robot import load_robot
from mbocp.solution import Solution
from mbocp.terms.point import Point

EXAMPLES = Path(__file__).parents[2] / "examples"
PANDA = {"name": "panda", "lock": ["panda_finger_joint1", "panda_finger_joint2"]}
DRONE = {"name": "hector", "actuated": ["root_joint"]}
REST = {"q": [0.5, -1.2, 0.5, -0.3, 0.4, 0.2], "v": 0}
STEADY = {"effort": 1.0, "velocity": 10.0}


def arm(via: list[dict[str, Any]], steps: int = 20, **words: Any) -> Problem:
    return Problem.create(
        "ur5", 1.0, steps, goal=REST, via=via, **{"integrator": {"scheme": "se1"}, "cost": STEADY, **words}
    )


def solved(problem: Problem, method: str = "auto") -> Solution:
    solution = mbocp.solve(problem.with_(solver={"method": method}))
    assert solution.converged, solution.advice
    assert solution.limit_violation <= 1e-9
    return solution


def errors(constraint: ViaConstraint, solution: Solution, node: int) -> Any:
    values = constraint.values(constraint.robot, solution.qs[node], solution.vs[node])
    return np.maximum(0.0, np.maximum(constraint.lower - values, values - constraint.upper))


POSE = {"name": "tool0", "position": [0.3, 0.35, 0.5], "rpy": [3.0, 0.2, 0.4]}
PROBLEMS: dict[str, dict[str, Any]] = {
    "pose": {"frame": POSE},
    "position and velocity": {"frame": {"name": "tool0", "z": 0.5, "velocity": [0.1, 0.2, 0.0]}},
    "axis": {"frame": {"name": "tool0", "axis": [0, 0, 1], "direction": [0, 0, -1]}},
    "joints": {"q": {"shoulder_pan_joint": 0.6}, "v": {"elbow_joint": 0.3}},
    "box and cone": {
        "frame": {**POSE, "position_tolerance": [0.01, 0.02, 0.03], "orientation_tolerance": 0.1}
    },
}


@pytest.mark.parametrize("words", PROBLEMS.values(), ids=PROBLEMS)
def test_it_holds_at_its_node_and_only_there(words: dict[str, Any]) -> None:
    problem = arm([{"time": 0.45, **words}])
    (constraint,) = problem.timeline.waypoints
    assert constraint.node == 9
    solution = solved(problem)
    assert errors(constraint, solution, 9).max() <= 1e-9
    assert max(errors(constraint, solution, n).max() for n in (7, 11)) > 1e-3
    assert np.isfinite(problem.path[0].lower).any()


def test_a_pose_is_where_pinocchio_says() -> None:
    solution = solved(arm([{"share": 0.45, "frame": POSE}]))
    placed = load_robot("ur5").frame_placement("tool0", solution.qs[9])
    assert placed.translation == pytest.approx(POSE["position"], abs=1e-9)
    assert pin.log3(placed.rotation.T @ pin.rpy.rpyToMatrix(*POSE["rpy"])) == pytest.approx(
        np.zeros(3), abs=1e-9
    )


def test_solvers_agree() -> None:
    problem = arm(
        [
            {"time": 0.3, "frame": {**POSE, "position_tolerance": 0.02}},
            {"time": 0.6, "q": [0.4, -1.0, 0.4, -0.4, 0.3, 0.1]},
        ]
    )
    costs = [solved(problem, method).cost for method in ("monolithic", "ipopt", "fatrop")]
    assert costs[1:] == pytest.approx([costs[0]] * 2, rel=1e-8)


def test_a_via_point_on_the_optimum_changes_nothing() -> None:
    plain = solved(arm([]))
    through = solved(arm([{"time": 0.5, "q": plain.qs[10].tolist(), "v": plain.vs[10].tolist()}]))
    assert through.cost == pytest.approx(plain.cost, rel=1e-10)
    assert through.qs == pytest.approx(plain.qs, abs=1e-6)


def test_an_arm_of_seven_joints_with_a_hand_turned_by_half_a_turn() -> None:
    hand = {"name": "panda_hand", "position": [0.3, 0.4, 0.4]}
    there = {"name": "panda_hand", "position": [0.5, 0.0, 0.6], "rpy": [np.pi, 0.0, 0.0]}
    problem = Problem.create(
        PANDA,
        1.5,
        16,
        goal={"v": 0, "frame": hand},
        via=[{"share": 0.5, "frame": there}],
        cost=STEADY,
        scheme="se1",
    )
    assert errors(problem.timeline.waypoints[0], solved(problem), 8).max() <= 1e-9


@pytest.mark.parametrize("scheme", ["se1", "midpoint", "euler"])
def test_a_drone_through_an_attitude(scheme: str) -> None:
    attitude = [0.3, 0.6, 0.5, 0.5, 0.0, 0.5, np.sqrt(0.5)]
    gate = {"name": "base_link", "position": [0.3, 0.0, 0.2], "position_tolerance": [0.05, 0.05, 0.1]}
    problem = Problem.create(
        DRONE,
        1.5,
        40,
        start={"q": [0, 0, 0, 0, 0, 0, 1]},
        goal={"q": [1.0, 0.5, 1.5, 0, 0, 0, 1], "v": 0},
        via=[{"time": 0.75, "q": attitude}, {"time": 0.3, "frame": gate}],
        cost={"effort": 1.0, "velocity": 1.0},
        scheme=scheme,
    )
    assert [point.node for point in problem.timeline.waypoints] == [8, 20]
    solution = solved(problem)
    q = solution.qs[20]
    assert q[:3] == pytest.approx(attitude[:3], abs=1e-9)
    assert abs(q[3:] @ attitude[3:]) == pytest.approx(1.0, abs=1e-9)
    assert errors(problem.timeline.waypoints[0], solution, 8).max() <= 1e-9


def test_a_closed_loop_keeps_one_equation_for_its_one_degree_of_freedom() -> None:
    problem = load_problem(EXAMPLES / "loops" / "four_bar.toml", {"horizon.steps": 50})
    plain = solved(problem)
    q = plain.qs[20] + 0.3 * (plain.qs[21] - plain.qs[20])
    q = problem.robot.assemble(q)
    moved = problem.with_(via=[{"share": 0.4, "q": q.tolist()}])
    (constraint,) = moved.timeline.waypoints
    assert constraint.num_equations == problem.robot.nv - problem.robot.nc
    solution = solved(moved)
    assert solution.qs[20] == pytest.approx(q, abs=1e-8)


def test_rows_have_the_derivatives_of_pinocchio() -> None:
    problem = arm([{"share": 0.5, "frame": POSE}])
    (constraint,), robot = problem.timeline.waypoints, problem.robot
    q, v = ca.SX.sym("q", 6), ca.SX.sym("v", 6)
    numbers = {name: ca.SX(ca.DM(value)) for name, value in constraint.numbers_in("quaternion").items()}
    h = constraint.term.expression(Point(JointMechanics(robot), q, v), numbers)
    found = np.asarray(ca.Function("J", [q, v], [ca.jacobian(h, q)])(constraint.via.goal.q, np.zeros(6)))
    data, frame = robot.model.createData(), robot.frame_id("tool0")
    expected = pin.computeFrameJacobian(robot.model, data, np.array(constraint.via.goal.q), frame, pin.LOCAL)
    R = pin.rpy.rpyToMatrix(*POSE["rpy"])
    assert found[:3] == pytest.approx(R @ expected[:3], abs=1e-9)
    assert found[3:6] == pytest.approx(expected[3:], abs=1e-9)
    assert found[6] == pytest.approx(np.zeros(6), abs=1e-9)  # a cosine at its largest


def test_other_numbers_need_no_other_functions() -> None:
    def texts(via: list[dict[str, Any]]) -> Any:
        problem = arm(via)
        return [constraint.structure("quaternion").signature for constraint in problem.timeline.waypoints]

    first = [{"time": 0.3, "frame": {"name": "tool0", "position": [0.3, 0.35, 0.5]}}]
    other = [{"share": 0.7, "name": "b", "frame": {"name": "tool0", "position": [0.2, 0.45, 0.4]}}]
    assert texts(first) == texts(other)


def test_a_free_duration_takes_shares() -> None:
    problem = Problem.create(
        "ur5",
        {"min": 0.3, "max": 3.0},
        20,
        goal=REST,
        via=[{"share": 0.5, "q": {"shoulder_pan_joint": 0.8}}],
        cost={"time": 100.0, "effort": 1e-2, "velocity": 10.0},
        scheme="se1",
    )
    solution = solved(problem)
    assert solution.qs[10, 0] == pytest.approx(0.8, abs=1e-9)


def test_without_a_goal_the_guess_ends_at_the_last_via_point() -> None:
    problem = Problem.create("ur5", 1.0, 12, via=[{"time": 0.5, "q": [0.3] * 6}], cost=STEADY, scheme="se1")
    assert solved(problem).qs[6] == pytest.approx([0.3] * 6, abs=1e-9)


def test_problems_are_written_and_read_back() -> None:
    via = [
        {"name": "a", "time": 0.3, "frame": [{**POSE, "position_tolerance": [0.1, 0.2, 0.3]}]},
        {"name": "b", "share": 0.5, "q": {"elbow_joint": 0.4}, "v": 0},
        {
            "time": 0.7,
            "frame": {
                "name": "tool0",
                "axis": [1, 0, 0],
                "direction": [0, 0, 1],
                "orientation_tolerance": 0.2,
            },
        },
    ]
    problem = arm(via)
    text = problem_to_toml(problem)
    again = parse_problem(text)
    assert [point.share for point in again.via] == [None, 0.5, None]
    for old, new in zip(problem.timeline.waypoints, again.timeline.waypoints, strict=True):
        assert (old.node, old.labels) == (new.node, new.labels)
        assert old.upper == pytest.approx(new.upper)
        assert old.via.goal.q == pytest.approx(new.via.goal.q, abs=1e-7)
    assert {label.unit for label in again.timeline.waypoints[1].labels} == {"rad", "rad/s"}
    assert problem.with_(via=[]).timeline.waypoints == ()
    assert [p.node for p in problem.with_(steps=40).timeline.waypoints] == [12, 20, 28]


REFUSED: dict[str, tuple[dict[str, Any], type[MbocpError], str]] = {
    "after the end": (
        {"time": 1.2, "q": [0.1] * 6},
        MbocpError,
        "via '1': time: got 1.2.*within the horizon",
    ),
    "before the start": ({"time": -0.2, "q": [0.1] * 6}, MbocpError, "time: got -0.2"),
    "share": ({"share": 1.0, "q": [0.1] * 6}, MbocpError, "share: got 1.0"),
    "at the start": ({"time": 0.01, "q": [0.1] * 6}, ProblemError, "is the start of the motion"),
    "at the end": ({"time": 0.99, "q": [0.1] * 6}, ProblemError, "is the end of the motion"),
    "no time": ({"q": [0.1] * 6}, ProblemError, "time or share"),
    "both times": ({"time": 0.5, "share": 0.5, "q": [0.1] * 6}, ProblemError, "time or share, not both"),
    "nothing": ({"time": 0.5}, ProblemError, r"via\.0: nothing holds there; give q, v or frame$"),
    "unknown frame": ({"time": 0.5, "frame": {"name": "tol0", "x": 0.1}}, UnknownFrame, "tol0"),
    "out of reach": (
        {"time": 0.5, "name": "far", "frame": {"name": "tool0", "x": 1.5, "rpy": [3.14, 0, 0]}},
        UnreachablePose,
        r"via 'far': out of reach .* x = 1\.5 m, rpy \[3\.14, 0\.0, 0\.0\] rad; the nearest",
    ),
    "tolerance of nothing": (
        {
            "time": 0.5,
            "frame": {"name": "tool0", "axis": [0, 0, 1], "direction": [0, 0, 1], "position_tolerance": 0.1},
        },
        MbocpError,
        "no position beside it",
    ),
    "tolerance zero": (
        {"time": 0.5, "frame": {"name": "tool0", "x": 0.1, "position_tolerance": 0.0}},
        MbocpError,
        "lengths above 0",
    ),
    "weight": ({"time": 0.5, "frame": {"name": "tool0", "x": 0.1, "weight": 2.0}}, ProblemError, "weight"),
    "too early": ({"time": 0.05, "q": [0.1] * 6, "v": 0}, MbocpError, "12 equations at node 1"),
}


@pytest.mark.parametrize(("words", "error", "message"), REFUSED.values(), ids=REFUSED)
def test_refusals_say_which_and_why(words: dict[str, Any], error: type[MbocpError], message: str) -> None:
    with pytest.raises(error, match=message):
        arm([words])


def test_two_at_one_node_are_refused() -> None:
    with pytest.raises(ProblemError, match="at node 10, as via '1'"):
        arm([{"time": 0.5, "q": [0.1] * 6}, {"share": 0.5, "q": [0.2] * 6}])


def test_limits_exclude_a_via_point() -> None:
    with pytest.raises(ProblemError, match=r"via '1'.*above its limit"):
        arm([{"time": 0.5, "q": [0.9] * 6}], limits={"position": [[-3.0, 0.8]] * 6})


def test_a_box_that_the_tool_reaches_at_its_rim_is_kept() -> None:
    frame = {"name": "tool0", "position": [1.0, 0.0, 0.2], "position_tolerance": 0.2}
    problem = arm([{"time": 0.5, "frame": frame}])
    assert errors(problem.timeline.waypoints[0], solved(problem), 10).max() <= 1e-9


def test_between_two_nodes_the_nearest_is_taken_and_said() -> None:
    with pytest.warns(ProblemWarning, match=r"via '1': between two nodes.*t = 0.35 s"):
        problem = arm([{"time": 0.36, "q": [0.1] * 6}])
    assert problem.timeline.waypoints[0].node == 7


def test_a_free_duration_takes_times() -> None:
    duration = {"min": 0.3, "max": 3.0}
    cost = {"time": 100.0, "effort": 1e-2, "velocity": 10.0}
    via = [{"name": "a", "time": 0.6, "q": {"shoulder_pan_joint": 0.3}}]
    problem = Problem.create("ur5", duration, 20, goal=REST, via=via, cost=cost, scheme="se1")
    solution = solved(problem)
    assert solution.via_times["a"] == pytest.approx(0.6, abs=1e-9)
    assert solution.qs[problem.timeline.waypoints[0].node, 0] == pytest.approx(0.3, abs=1e-9)
    assert abs(solution.duration - problem.duration) > 0.05


def test_pure_values_check_themselves() -> None:
    point = arm([{"time": 0.5, "frame": POSE}]).via[0]
    with pytest.raises(ProblemError, match="no momentum"):
        ViaPoint(name="a", goal=replace(point.goal, enforce="none"))


def test_natural_coordinates_keep_poses_and_refuse_joints() -> None:
    words: dict[str, Any] = {"steps": 16, "coordinates": "natural"}
    problem = arm([{"share": 0.5, "frame": {**POSE, "position_tolerance": 0.01}}], **words)
    assert errors(problem.timeline.waypoints[0], solved(problem), 8).max() <= 1e-9
    with pytest.raises(ProblemError, match="via '1': natural coordinates have no joint"):
        arm([{"share": 0.5, "q": [0.1] * 6}], **words)

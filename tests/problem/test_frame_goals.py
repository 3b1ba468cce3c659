"""Goals of frames: the tool ends where it is to be, in every choice of coordinates and schemes."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import (
    InconsistentStart,
    InvalidValue,
    OverdeterminedGoal,
    ProblemError,
    ProblemFileError,
    UnknownFrame,
    UnreachableGoal,
    UnreachablePose,
)
from mbocp.formulation import formulate
from mbocp.problem import FrameGoal, Problem, load_problem, parse_problem, problem_to_toml
from mbocp.problem.goals.frames import pose_errors
from mbocp.robot import FrameTarget, InverseKinematics, Robot, load_robot, robot_from_spec
from mbocp.solution import Solution

PANDA = {"name": "panda", "lock": ["panda_finger_joint1", "panda_finger_joint2"]}
DRONE = {"name": "hector", "actuated": ["root_joint"]}
STEADY = {"effort": 1.0, "velocity": 10.0}


def solved(problem: Problem) -> Solution:
    solution = mbocp.solve(problem)
    assert solution.converged, solution.advice
    return solution


def velocity(robot: Robot, frame: str, solution: Solution) -> Array:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, solution.q_final, solution.vs[-1])
    moved = pin.getFrameVelocity(robot.model, data, robot.frame_id(frame), pin.LOCAL_WORLD_ALIGNED)
    return np.array(moved.vector)


def rotation_vector(a: Array, b: Array) -> Array:
    return np.array(pin.log3(a.T @ b))


SCHEMES: dict[str, dict[str, Any]] = {
    "se1": {},
    "midpoint": {"scheme": "midpoint"},
    "euler": {"scheme": "euler"},
    "natural": {"coordinates": "natural"},
}


@pytest.mark.parametrize("words", SCHEMES.values(), ids=SCHEMES)
def test_a_full_pose_at_rest(words: dict[str, Any]) -> None:
    position, rpy = [0.45, 0.25, 0.35], [3.0, 0.2, 0.4]
    goal = {"v": 0, "frame": {"name": "tool0", "position": position, "rpy": rpy}}
    problem = Problem.create(
        "ur5", 1.0, 12, goal=goal, cost={"velocity": 100.0}, **{"integrator": {"scheme": "se1"}, **words}
    )
    solution = solved(problem)
    assert solution.eta.size == 12
    reached = problem.robot.frame_placement("tool0", solution.q_final)
    assert reached.translation == pytest.approx(position, abs=1e-9)
    assert rotation_vector(reached.rotation, pin.rpy.rpyToMatrix(*rpy)) == pytest.approx(
        np.zeros(3), abs=1e-8
    )
    assert solution.vs[-1] == pytest.approx(np.zeros(6), abs=1e-8)


@pytest.mark.parametrize("name", SCHEMES)
def test_the_velocity_of_a_frame(name: str) -> None:
    """Both velocities, and of the pose only the height: joints are free in what is left."""
    robot = load_robot("ur5")
    speed, turning = ([0.1, -0.2, 0.3], [0.0, 0.4, 0.1]) if name != "natural" else ([0.0] * 3, [0.0] * 3)
    frame = {"name": "tool0", "z": 0.5, "velocity": speed, "angular_velocity": turning}
    start = {"q": [0.1, -1.0, 1.2, -1.0, -1.3, 0.2]}
    problem = Problem.create(
        robot,
        1.0,
        12,
        start=start,
        goal={"frame": frame},
        cost={"velocity": 100.0},
        **{"integrator": {"scheme": "se1"}, **SCHEMES[name]},
    )
    solution = solved(problem)
    assert solution.eta.size == 7
    assert robot.frame_placement("tool0", solution.q_final).translation[2] == pytest.approx(0.5, abs=1e-9)
    assert velocity(robot, "tool0", solution) == pytest.approx([*speed, *turning], abs=1e-8)


def test_an_axis_along_a_direction_leaves_the_turn_about_it_free() -> None:
    frame = {"name": "panda_hand", "position": [0.5, 0.1, 0.4], "axis": [0, 0, 1], "direction": [0, 0, -2]}
    limits = {"position": True, "velocity": True, "effort": True}
    start = {"q": [0, 0, 0, -1.5, 0, 1.5, 0]}
    problem = Problem.create(
        PANDA, 1.5, 15, start=start, goal={"v": 0, "frame": frame}, cost=STEADY, limits=limits, scheme="se1"
    )
    solution = solved(problem)
    assert solution.eta.size == 12
    assert solution.limit_violation <= 1e-9
    reached = problem.robot.frame_placement("panda_hand", solution.q_final)
    assert reached.translation == pytest.approx([0.5, 0.1, 0.4], abs=1e-9)
    assert reached.rotation[:, 2] == pytest.approx([0, 0, -1], abs=1e-9)


@pytest.mark.parametrize("words", [{}, {"scheme": "euler"}, {"coordinates": "natural"}])
def test_a_free_flyer(words: dict[str, Any]) -> None:
    goal = {"v": 0, "frame": {"name": "base_link", "position": [0.5, 0.2, 1.0], "rpy": [0, 0, 1.0]}}
    problem = Problem.create(
        DRONE, 1.0, 20, goal=goal, cost=STEADY, **{"integrator": {"scheme": "se1"}, **words}
    )
    solution = solved(problem)
    reached = problem.robot.frame_placement("base_link", solution.q_final)
    assert reached.translation == pytest.approx([0.5, 0.2, 1.0], abs=1e-9)
    assert rotation_vector(reached.rotation, pin.rpy.rpyToMatrix(0, 0, 1.0)) == pytest.approx(
        np.zeros(3), abs=1e-8
    )


LOOPS = [("parallelogram_arm", "joint"), ("parallelogram_arm", "natural"), ("delta", "joint")]


@pytest.mark.parametrize(("name", "coordinates"), LOOPS)
def test_closed_loops_decide_some_rows(name: str, coordinates: str) -> None:
    """Of the full pose of a mechanism with two or three freedoms as many rows are conditions."""
    robot, frame = load_robot(name), "tool"
    mobility = robot.nv - robot.nc
    away = 0.1 * np.random.default_rng(1).normal(size=robot.nv)
    wanted = robot.frame_placement(frame, robot.assemble(robot.integrate(robot.q0, away)))
    target = FrameTarget.at(frame, wanted)
    words = {"name": frame, "position": target.position, "orientation": target.orientation}
    problem = Problem.create(
        robot, 1.0, 12, goal={"v": 0, "frame": words}, coordinates=coordinates, scheme="se1"
    )
    solution = solved(problem)
    assert solution.eta.size == 2 * mobility
    reached = robot.frame_placement(frame, solution.q_final)
    assert reached.translation == pytest.approx(wanted.translation, abs=1e-7)
    assert rotation_vector(reached.rotation, wanted.rotation) == pytest.approx(np.zeros(3), abs=1e-7)


def test_relative_to_a_frame_that_moves_and_beside_joints() -> None:
    robot = load_robot("ur5")
    q = np.array([0.4, -1.1, 1.3, -0.9, -1.2, 0.3])
    away = robot.frame_placement("tool0", q, "upper_arm_link").translation
    height = robot.frame_placement("forearm_link", q).translation[2]
    frames = [
        {"name": "tool0", "position": away, "relative_to": "upper_arm_link"},
        {"name": "forearm_link", "z": height},
    ]
    goal = {"v": 0, "q": {"wrist_3_joint": 0.3}, "frame": frames}
    problem = Problem.create(robot, 1.0, 15, goal=goal, cost={"velocity": 100.0}, scheme="se1")
    solution = solved(problem)
    assert solution.eta.size == 6 + 5
    assert robot.frame_placement("tool0", solution.q_final, "upper_arm_link").translation == pytest.approx(
        away, abs=1e-9
    )
    assert robot.frame_placement("forearm_link", solution.q_final).translation[2] == pytest.approx(height)
    assert solution.q_final[5] == pytest.approx(0.3, abs=1e-9)
    assert problem.goal.q[5] == 0.3


def test_the_numbers_of_a_pose_are_parameters() -> None:
    def formulated(position: list[float], angle: float) -> Any:
        frame = {"name": "tool0", "position": position, "rpy": [angle, 0, 0], "velocity": [angle, 0, 0]}
        return formulate(Problem.create("ur5", 1.0, 10, goal={"frame": frame}, scheme="se1")).programme

    first, second = formulated([0.4, 0.2, 0.4], 3.0), formulated([0.3, 0.3, 0.5], 2.0)
    assert (first.rho_terminal != second.rho_terminal).any()
    assert first.end_functions.identity == second.end_functions.identity


NAMES = {
    "implicit": ({"name": "ur5"}, "tool0", {}),
    "group": (DRONE, "base_link", {}),
    "natural": ({"name": "double_pendulum"}, "link2", {"coordinates": "natural"}),
    "explicit": ({"name": "double_pendulum"}, "link2", {"scheme": "heun"}),
    "loop": ({"name": "five_bar"}, "right_tip", {}),
    "matrices": ({**DRONE, "rotations": "dcm"}, "base_link", {"scheme": "euler"}),
}


@pytest.mark.parametrize("enforce", ["exact", "penalty"])
@pytest.mark.parametrize("kind", ["orientation", "axis"])
@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_exact_in_second_order(name: str, kind: str, enforce: str) -> None:
    """Against central differences of fourth order along the manifold."""
    spec, frame, others = NAMES[name]
    robot, rng = robot_from_spec(spec), np.random.default_rng(5)
    goal_q = robot.assemble(robot.integrate(robot.q0, 0.1 * rng.normal(size=robot.nv)))
    at = robot.frame_placement(frame, goal_q)
    turn = {
        "orientation": {"orientation": FrameTarget.at(frame, at).orientation},
        "axis": {"axis": [0.2, -0.3, 1], "direction": at.rotation @ [0.2, -0.3, 1]},
    }[kind]
    words = {"name": frame, "position": at.translation, "velocity": 0, "angular_velocity": 0, **turn}
    goal = {"frame": words, "enforce": enforce}
    cost = {"terminal": 3.0} if enforce == "penalty" else {}
    formulation = formulate(
        Problem.create(robot, 1.0, 4, goal=goal, cost=cost, **{"integrator": {"scheme": "se1"}, **others})
    )
    programme, layout = formulation.programme, formulation.layout
    q = robot.integrate(goal_q, 0.2 * rng.normal(size=robot.nv))
    x = np.concatenate(
        [formulation.space.coordinates(q[None])[0], 0.3 * rng.normal(size=layout.nx - layout.nz)]
    )
    eta, rho = rng.normal(size=programme.ng), programme.rho_terminal
    out = programme.end_functions.function("terminal_complete")(x, eta, rho)
    _, _, dg_dx, dpsi_dx, upper = (np.asarray(ca.DM(value)) for value in out)
    hessian = np.triu(upper) + np.triu(upper, 1).T
    moved = programme.functions.function("retract")
    for _ in range(3):
        d = rng.normal(size=layout.ndx)
        d /= np.linalg.norm(d)

        def lagrangian(t: float, d: Array = d) -> float:
            psi, g = programme.end_functions.function("terminal_values")(moved(x, t * d), rho)
            return float(psi) + float(eta @ np.asarray(g).ravel())

        h = 2e-3
        a, b, c, e = (lagrangian(t) for t in (h, -h, 2 * h, -2 * h))
        scale = 1.0 + max(map(abs, (a, b, c, e)))
        slope = (dpsi_dx.ravel() + eta @ dg_dx) @ d
        assert abs((8 * (a - b) - (c - e)) / (12 * h) - slope) < 5e-7 * scale
        curvature = (16 * (a + b) - (c + e) - 30 * lagrangian(0.0)) / (12 * h * h)
        assert abs(curvature - d @ hessian @ d) < 1e-5 * scale


def test_rows_are_the_half_angle_vector() -> None:
    """2 tan(theta/2) about the axis, in the axes of the target: no other root below a half-turn."""
    robot = load_robot("ur5")
    q = np.array([0.3, -1.0, 1.2, -0.6, -1.3, 0.2])
    target = FrameTarget.at("tool0", robot.frame_placement("tool0", q))
    goal = {"frame": {"name": "tool0", "orientation": target.orientation}}
    formulation = formulate(Problem.create(robot, 1.0, 5, start={"q": q}, goal=goal, scheme="se1"))
    values = formulation.programme.end_functions.function("terminal_values")
    for angle in (1e-9, 1e-3, 1.0, 2.5, 3.1):
        turned = q + np.array([0, 0, 0, 0, 0, angle])  # about the last axis
        g = np.asarray(values(np.concatenate([turned, np.zeros(6)]), formulation.programme.rho_terminal)[1])
        vector = rotation_vector(target.rotation, robot.frame_placement("tool0", turned).rotation)
        expected = vector * 2 * np.tan(angle / 2) / angle
        assert g.ravel() == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_the_goal_configuration_is_a_branch_near_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = {"name": "tool0", "position": [0.4, 0.3, 0.4], "rpy": [3.0, 0.1, 0.2]}
    start = {"q": [0.1, -1.0, 1.2, -1.0, -1.3, 0.2]}
    searches: list[InverseKinematics] = []
    search = Robot.inverse_kinematics

    def counted(*args: Any, **options: Any) -> InverseKinematics:
        searches.append(search(*args, **options))
        return searches[-1]

    monkeypatch.setattr(Robot, "inverse_kinematics", counted)
    problem = Problem.create("ur5", 1.0, 10, start=start, goal={"v": 0, "frame": frame}, scheme="se1")
    assert len(searches) == 1  # a short one
    assert searches[0].attempts <= 11
    assert (problem.goal.q == searches[0].branches[0]).all()
    branches = problem.goal_branches()
    assert len(branches.branches) == 8
    assert min(np.abs(problem.goal.q - q).max() for q in branches.branches[:3]) < 1e-7
    other = problem.with_(goal=replace(problem.goal, q=branches.branches[3]))
    assert (other.goal.q == branches.branches[3]).all()


def test_limits_choose_the_branch() -> None:
    frame = {"name": "tool0", "position": [0.4, 0.3, 0.4], "rpy": [3.0, 0.1, 0.2]}
    start = {"q": [0.1, -1.0, 1.2, -1.0, -1.3, 0.2]}
    free = Problem.create("ur5", 1.0, 10, start=start, goal={"v": 0, "frame": frame}, scheme="se1")
    elbow = free.goal.q[2]
    limits = {"position": {"elbow_joint": [-3.0, elbow - 0.1] if elbow > 1.3 else [elbow + 0.01, 3.0]}}
    bounded = Problem.create(
        "ur5", 1.0, 10, start=start, goal={"v": 0, "frame": frame}, limits=limits, scheme="se1"
    )
    low, high = limits["position"]["elbow_joint"]
    assert low <= bounded.goal.q[2] <= high
    errors = pose_errors(bounded.robot, bounded.goal, bounded.goal.q)
    assert max(errors.positions[0], errors.angles[0]) < 1e-8


def test_a_pose_out_of_reach_is_refused_with_what_is_left() -> None:
    with pytest.raises(UnreachablePose, match=r"tool0: x = 2 m.* 1\.\d+ m away") as caught:
        Problem.create("ur5", 1.0, 10, goal={"frame": {"name": "tool0", "x": 2.0}})
    assert str(caught.value).endswith("move the goal or the base")
    assert caught.value.frame == "tool0"
    assert caught.value.distance == pytest.approx(1.05, abs=0.2)
    assert isinstance(caught.value, UnreachableGoal)
    limits = {"position": {"elbow_joint": [-0.2, 0.2], "shoulder_lift_joint": [-2.0, -1.0]}}
    with pytest.raises(UnreachablePose, match=r"at its limit|at their limits") as caught:
        Problem.create(
            "ur5", 1.0, 10, start={"q": [0, -1.5, 0, 0, 0, 0]}, limits=limits,
            goal={"frame": {"name": "tool0", "position": [0.3, 0.1, 0.1]}},
        )  # fmt: skip
    assert set(caught.value.joints) & {"elbow_joint", "shoulder_lift_joint"}
    assert "mm away" in str(caught.value)
    frame = {"name": "tool0", "position": [0.35, 0.45, 0.5]}
    with pytest.raises(ProblemError, match=r"goal.q: elbow_joint is -0.5 rad, below its limit 0"):
        Problem.create(
            "ur5", 1.0, 10, start={"q": [0, -1.5, 1.5, 0, 0, 0]},
            goal={"q": {"elbow_joint": -0.5}, "frame": frame}, limits={"position": {"elbow_joint": [0, 2.6]}},
        )  # fmt: skip


@pytest.mark.parametrize("enforce", ["penalty", "both"])
def test_a_penalty_draws_the_frame_to_its_goal(enforce: str) -> None:
    frame = {"name": "tool0", "position": [0.45, 0.25, 0.35], "rpy": [3.0, 0.2, 0.4], "weight": 10.0}
    goal = {"enforce": enforce, "frame": frame}
    misses = []
    for terminal in (1e2, 1e4):
        cost = {"velocity": 100.0, "terminal": terminal}
        problem = Problem.create("ur5", 1.0, 12, goal=goal, cost=cost, scheme="se1")
        errors = pose_errors(problem.robot, problem.goal, solved(problem).q_final)
        misses.append(errors.positions[0] + errors.angles[0])
    assert misses[1] < (1e-9 if enforce == "both" else 0.1 * misses[0])


def test_problems_write_and_read_back(tmp_path: Path) -> None:
    frames = [
        {"name": "tool0", "x": 0.3, "z": 0.4, "axis": [0, 0, 1], "direction": [0, 0, -1], "velocity": 0},
        {"name": "forearm_link", "z": 0.4, "relative_to": "shoulder_link", "weight": 2.0},
    ]
    problem = Problem.create("ur5", 1.0, 10, goal={"v": 0, "frame": frames}, scheme="se1")
    text = problem_to_toml(problem)
    again = parse_problem(text)
    assert problem_to_toml(again) == text
    assert again.goal.q == pytest.approx(problem.goal.q, abs=1e-12)
    path = tmp_path / "pose.toml"
    path.write_text(
        'robot = "ur5"\n[horizon]\nduration = 1.0\nsteps = 10\n[goal]\nv = 0\n'
        '[goal.frame]\nname = "tool0"\nposition = [0.4, 0.2, 0.4]\n',
        encoding="utf-8",
    )
    assert load_problem(path).goal.frames[0].target.position == pytest.approx([0.4, 0.2, 0.4])
    moved = load_problem(path, ["goal.frame.position=[0.3, 0.3, 0.5]"])
    assert moved.goal.frames[0].target.position == pytest.approx([0.3, 0.3, 0.5])
    several = path.read_text(encoding="utf-8").replace("[goal.frame]", "[[goal.frame]]")
    several += '[[goal.frame]]\nname = "forearm_link"\nz = 0.5\n'
    path.write_text(several, encoding="utf-8")
    assert [frame.name for frame in load_problem(path).goal.frames] == ["tool0", "forearm_link"]


def test_another_start_finds_the_pose_again() -> None:
    frame = {"name": "tool0", "position": [0.4, 0.3, 0.4], "rpy": [3.0, 0.1, 0.2]}
    problem = Problem.create("ur5", 1.0, 10, goal={"v": 0, "frame": frame}, scheme="se1")
    other = problem.with_(start={"q": [2.0, -1.0, 1.2, -1.0, -1.3, 0.2]})
    errors = pose_errors(other.robot, other.goal, other.goal.q)
    assert max(errors.positions[0], errors.angles[0]) < 1e-8
    further = problem.with_(goal={"frame": {"name": "tool0", "position": [0.2, 0.3, 0.5]}})
    assert further.robot.frame_placement("tool0", further.goal.q).translation == pytest.approx(
        [0.2, 0.3, 0.5]
    )


def test_a_pose_takes_the_place_of_a_whole_configuration() -> None:
    q = [0.5, -1.2, 1.2, -1.0, -1.0, 0.2]
    problem = Problem.create("ur5", 1.0, 10, goal={"q": q, "v": 0})
    frame = {"name": "tool0", "position": [0.2, 0.3, 0.5]}
    moved = problem.with_(goal={"frame": frame})
    assert not moved.goal.q_active.any()
    assert moved.goal.rate_active.all()
    with pytest.raises(
        ProblemFileError, match=r"goal\.q gives every joint, and with these tool0 is not where"
    ):
        problem.with_(goal={"q": q, "frame": frame})
    there = problem.robot.frame_placement("tool0", problem.goal.q).translation
    both = Problem.create("ur5", 1.0, 10, goal={"q": q, "frame": {**frame, "position": there}})
    assert both.goal.q_active.all()


def test_the_summary_says_how_well_it_is_met() -> None:
    frame = {"name": "tool0", "position": [0.4, 0.3, 0.4]}
    problem = Problem.create(
        "ur5", 1.0, 12, goal={"v": 0, "frame": frame}, cost={"velocity": 100.0}, scheme="se1"
    )
    words = solved(problem).goal_error
    assert "tool0 off by" in words
    assert " mm and " in words


@pytest.mark.parametrize(
    ("frame", "error", "message"),
    [
        ({"name": "tool1", "x": 0.1}, UnknownFrame, r"goal\.frame: robot .* no frame .tool1"),
        ({"name": "tool0"}, InvalidValue, "nothing for 'tool0'"),
        ({"name": "tool0", "x": 0.1, "velocty": 0}, ProblemFileError, "velocity"),
        ({"name": "tool0", "x": 0.1, "weight": -1.0}, ProblemFileError, "weight"),
        ({"name": "tool0", "position": [0.1, 0.2]}, ProblemFileError, "a list of 3"),
        (
            {"name": "tool0", "rpy": [0, 0, 0], "axis": [0, 0, 1], "direction": [0, 0, 1]},
            ProblemFileError,
            "axis",
        ),
        ({"name": "tool0", "x": 1e10}, ProblemFileError, "x of tool0.*at most 1e\\+09 m"),
        ({"name": "base_link", "velocity": [1, 0, 0]}, InconsistentStart, "velocity"),
    ],
)
def test_what_is_wrong_is_refused(frame: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises((error, ProblemFileError), match=message):
        Problem.create("ur5", 1.0, 10, goal={"frame": frame})


def test_natural_coordinates_have_no_other_velocities_than_rest() -> None:
    frame = {"name": "tool0", "velocity": [0.1, 0, 0]}
    with pytest.raises(ProblemFileError, match="natural coordinates velocities of bodies"):
        Problem.create("ur5", 1.0, 10, goal={"frame": frame}, coordinates="natural")


def test_more_rows_than_the_controls_can_meet_are_refused() -> None:
    frame = {"name": "tool0", "position": [0.4, 0.3, 0.4], "rpy": [3.0, 0.1, 0.2]}
    with pytest.raises(OverdeterminedGoal, match="12 independent"):
        Problem.create("ur5", 1.0, 1, goal={"v": 0, "frame": frame})


def test_a_goal_of_a_frame_in_python() -> None:
    with pytest.raises(InvalidValue, match="weight"):
        FrameGoal(target=FrameTarget(name="tool0", position=(None, None, 0.3)), weight=np.nan)
    goal = FrameGoal(target=FrameTarget(name="tool0"), velocity=np.zeros(3))
    assert not goal.has_pose
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert goal.rate_labels == ("velocity x of tool0", "velocity y of tool0", "velocity z of tool0")


TOLERANT = {"name": "tool0", "position": [0.45, 0.25, 0.35], "rpy": [3.0, 0.2, 0.4]}
DIRECT = {"q": [0.1, -1.0, 1.2, -1.0, -1.3, 0.2]}


@pytest.mark.parametrize("words", [{}, {"coordinates": "natural"}, {"scheme": "euler"}], ids=str)
def test_tolerances_are_a_box_and_a_cone_at_the_end(words: dict[str, Any]) -> None:
    """An optimum makes use of them, and no node before the last is bounded."""
    frame = {**TOLERANT, "position_tolerance": [0.02, 0.03, 0.01], "orientation_tolerance": 0.1}
    problem = Problem.create(
        "ur5",
        1.0,
        8,
        start=DIRECT,
        goal={"v": 0, "frame": frame},
        cost={"velocity": 100.0},
        **{"integrator": {"scheme": "se1"}, **words},
    )
    exact = problem.with_(goal={"frame": TOLERANT})
    solution = solved(problem)
    assert solution.cost < solved(exact).cost
    assert solution.eta.size == 6
    assert solution.limit_violation <= 1e-8
    reached = problem.robot.frame_placement("tool0", solution.q_final)
    away = np.abs(reached.translation - TOLERANT["position"])
    angle = np.linalg.norm(rotation_vector(reached.rotation, pin.rpy.rpyToMatrix(*TOLERANT["rpy"])))
    assert (away <= np.array([0.02, 0.03, 0.01]) + 1e-8).all()
    assert angle <= 0.1 + 1e-8
    assert (away > [0.019, 0.029, 0.009]).any() or angle > 0.099


def test_a_tolerance_of_one_part_leaves_the_other_exact() -> None:
    frame = {**TOLERANT, "orientation_tolerance": 0.2}
    problem = Problem.create(
        "ur5", 1.0, 12, start=DIRECT, goal={"v": 0, "frame": frame}, cost={"velocity": 100.0}, scheme="se1"
    )
    solution = solved(problem)
    assert solution.eta.size == 9
    reached = problem.robot.frame_placement("tool0", solution.q_final)
    assert reached.translation == pytest.approx(TOLERANT["position"], abs=1e-9)
    angle = np.linalg.norm(rotation_vector(reached.rotation, pin.rpy.rpyToMatrix(*TOLERANT["rpy"])))
    assert angle == pytest.approx(0.2, abs=1e-6)
    text = problem_to_toml(problem)
    assert problem_to_toml(parse_problem(text)) == text
    assert [label.name for row in problem.path for label in row.labels] == ["goal of tool0, angle"]
    (active,) = solution.active_limits
    assert (active.name, active.bound, active.unit, active.count) == ("goal of tool0, angle", 0.2, "rad", 1)


def test_values_of_a_tolerance_are_lengths_and_angles() -> None:
    frame = {**TOLERANT, "position_tolerance": 0.05, "orientation_tolerance": 0.2}
    problem = Problem.create("ur5", 1.0, 12, start=DIRECT, goal={"frame": frame}, scheme="se1")
    box, cone = problem.path
    q = np.array(problem.robot.integrate(problem.goal.q, [0.01, 0.02, -0.01, 0.03, 0.02, 0.01]))
    errors = pose_errors(problem.robot, problem.goal, q)
    assert np.linalg.norm(box.values(problem.robot, q, np.zeros(6))) == pytest.approx(errors.positions[0])
    angle = cone.values(problem.robot, q, np.zeros(6))
    assert angle == pytest.approx(errors.angles)
    step = 1e-6  # the slope takes multipliers of the expression to those of the angle
    scale = (2 * np.tan(0.1)) ** 2
    expected = (4 * np.tan((angle + step) / 2) ** 2 - 4 * np.tan((angle - step) / 2) ** 2) / (
        2 * step * scale
    )
    assert cone.slopes(angle) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"position_tolerance": 0.0}, "above 0"),
        ({"position_tolerance": [0.1, 0.1, -0.1]}, "above 0"),
        ({"position_tolerance": [0.1, 0.1, 0.1, 0.1]}, "or one number"),
        ({"orientation_tolerance": 3.2}, "between 0 and pi"),
        ({"orientation_tolerance": 0.1, "rpy": None}, "beside an orientation"),
    ],
)
def test_tolerances_that_cannot_be_right(words: dict[str, Any], message: str) -> None:
    frame = {key: value for key, value in {**TOLERANT, **words}.items() if value is not None}
    with pytest.raises(ProblemFileError, match=message):
        Problem.create("ur5", 1.0, 12, goal={"frame": frame})


def test_a_penalty_has_no_tolerance() -> None:
    goal = {"enforce": "penalty", "frame": {**TOLERANT, "position_tolerance": 0.1}}
    with pytest.raises(ProblemFileError, match="tolerance is for enforce"):
        Problem.create("ur5", 1.0, 12, goal=goal, cost={"terminal": 1.0})


def test_a_tolerance_in_the_least_time() -> None:
    """The last node is the end, however long the motion takes."""
    frame = {**TOLERANT, "position_tolerance": 0.02, "orientation_tolerance": 0.1}
    problem = Problem.create(
        "ur5",
        {"min": 0.2, "max": 4.0, "guess": 1.0},
        12,
        start=DIRECT,
        goal={"v": 0, "frame": frame},
        cost={"effort": 1e-4, "time": 100.0},
        limits={"effort": True},
        scheme="se1",
    )
    solution = solved(problem)
    errors = pose_errors(problem.robot, problem.goal, solution.q_final)
    assert 0.0099 < errors.positions[0] < 0.02 * np.sqrt(3)
    assert errors.angles[0] <= 0.1 + 1e-8
    exact = solved(problem.with_(goal={"frame": TOLERANT}))
    assert solution.duration < exact.duration

"""Velocities and accelerations of frames in their own axes: wheels, knife edges, the shortest way."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import mbocp
from mbocp.exceptions import LimitsExceeded
from mbocp.problem import Problem, ProblemWarning, parse_problem, problem_to_toml
from mbocp.robot import Robot

NO_SLIP = {"kind": "velocity", "frame": "base_link", "y": [0, 0]}


@cache
def base() -> Robot:
    return mbocp.load_robot("planar_base", dynamics=False)


def drive(goal: list[float], steps: int = 40, **words: Any) -> Problem:
    """From rest to rest."""
    tables = {"path": [NO_SLIP], "cost": {"effort": 1.0}, **words}
    return Problem.create(base(), 4.0, steps, goal={"q": goal, "v": 0}, **tables)


def slips(qs: np.ndarray, vs: np.ndarray) -> np.ndarray:
    """Velocity across the heading, of x, y, cosine and sine."""
    return vs[:, 1] * qs[:, 2] - vs[:, 0] * qs[:, 3]


@pytest.mark.parametrize("given", ["ur5", {"name": "hector", "actuated": ["root_joint"]}], ids=str)
def test_values_are_pinocchios(given: Any) -> None:
    robot = Problem.create(given, 1.0, 4, goal={"v": 0}).robot
    frame = robot.frame_names[-1]
    sides = {axis: [-99, 99] for axis in "xyz"}
    path = [{"kind": kind, "frame": frame, **sides} for kind in ("velocity", "frame_acceleration")]
    problem = Problem.create(robot, 1.0, 4, path=path, goal={"v": 0}, scheme="se1")
    rng, data = np.random.default_rng(1), robot.model.createData()
    for _ in range(3):
        q = pin.randomConfiguration(robot.model, -np.ones(robot.nq), np.ones(robot.nq))
        v, a = rng.normal(size=(2, robot.nv))
        pin.forwardKinematics(robot.model, data, q, v, a)
        at = (robot.model, data, robot.frame_id(frame), pin.LOCAL)
        wanted = pin.getFrameVelocity(*at).linear, pin.getFrameClassicalAcceleration(*at).linear
        u = np.zeros((1, robot.nu))
        for term, expected in zip(problem.path, wanted, strict=True):
            (found,) = term.values_along(robot, q[None], v[None], u, a[None])
            assert np.allclose(found, expected, atol=1e-11)


def test_its_text_reads_back() -> None:
    text = problem_to_toml(drive([0, 1, 0], path=[{**NO_SLIP, "x": [-1, 2]}]))
    assert problem_to_toml(parse_problem(text)) == text


@pytest.mark.parametrize("goal", [[0, 1, 0], [-1, 0, 0], [0, 0, 2], [-1, 1, 3]], ids=str)
def test_a_base_comes_to_each_place_without_slip(goal: list[float]) -> None:
    """Beside it, behind it, turned where it is: the straight line is no guess for the first of them."""
    solution = mbocp.solve(drive(goal), check=True)
    assert "a way that frames keep to" in solution.guess_used
    assert np.abs(slips(solution.qs, solution.vs)).max() < 1e-9
    assert np.abs(solution.qs[-1, :2] - goal[:2]).max() < 1e-9


def test_bounds_of_x_say_which_way_it_goes() -> None:
    forwards, backwards = (
        mbocp.solve(drive([1, 1, 0], path=[{**NO_SLIP, "x": x}]), check=True)
        for x in ([0, np.inf], [-np.inf, 0])
    )
    ahead = [s.vs[:, 0] * s.qs[:, 2] + s.vs[:, 1] * s.qs[:, 3] for s in (forwards, backwards)]
    assert ahead[0].min() > -1e-9
    assert ahead[1].max() < 1e-9


def test_a_motion_that_is_sent_slips_little_or_is_refused(tmp_path: Path) -> None:
    with pytest.raises(LimitsExceeded, match=r"velocity of base_link\.y"):
        mbocp.solve(drive([0, 1, 0], steps=30)).export(tmp_path / "coarse.csv", rate=100)
    mbocp.solve(drive([0, 1, 0], steps=90)).export(tmp_path / "fine.npz", rate=100)
    with np.load(tmp_path / "fine.npz") as sent:
        (_, _, yaw), (x, y, _) = sent["q"].T, sent["v"].T
    assert np.abs(y * np.cos(yaw) - x * np.sin(yaw)).max() < 1e-3


def test_the_shortest_way_of_a_car() -> None:
    """Left, straight, right [Dubins1957]: found ways are longer by the time of a step, and never shorter."""
    goal, x = [-4.83, 3.13, 2.59], {"kind": "velocity", "frame": "base_link", "x": [1, 1], "y": [0, 0]}
    over = []
    for steps in (40, 80):
        ends = {"x": np.cos(goal[2]), "y": np.sin(goal[2])}
        problem = Problem.create(
            base(),
            {"min": 1.0, "max": 20.0, "guess": 8.0},
            steps,
            start={"v": [1, 0, 0]},
            goal={"q": goal, "v": ends},
            cost={"effort": 1e-7, "time": 1.0},
            limits={"velocity": {"yaw": 1.0}},
            path=[x],
        )
        over.append(mbocp.solve(problem, check=True).duration - _left_straight_right(*goal))
    assert 0.0 < over[1] < 0.55 * over[0] < 0.2


def _left_straight_right(x: float, y: float, heading: float) -> float:
    """Length from the origin along x, by circles of radius 1: left of the start, right of the end."""
    between = np.array([x + np.sin(heading), y - np.cos(heading) - 1.0])
    straight = np.sqrt(between @ between - 4.0)
    angle = np.arctan2(between[1], between[0]) + np.arctan2(2.0, straight)
    return float(angle % (2 * np.pi) + straight + (angle - heading) % (2 * np.pi))


MASS, INERTIA, AHEAD = 2.0, 0.3, 0.5
SLIDE = """<joint name="{0}" type="prismatic"><parent link="{1}"/><child link="{2}"/><axis xyz="{3}"/>
<limit effort="0" velocity="0"/></joint>"""
SLEIGH = f"""<robot name="sleigh"><link name="ice"/><link name="a"/><link name="b"/>
<link name="blade"><inertial><origin xyz="{AHEAD} 0 0"/><mass value="{MASS}"/>
<inertia ixx="0.3" iyy="0.3" izz="{INERTIA}" ixy="0" ixz="0" iyz="0"/></inertial></link>
{SLIDE.format("x", "ice", "a", "1 0 0")}{SLIDE.format("y", "a", "b", "0 1 0")}
<joint name="yaw" type="continuous"><parent link="b"/><child link="blade"/><axis xyz="0 0 1"/></joint></robot>
"""
WRENCH = """urdf = "sleigh.urdf"
actuation.joints = []
actuator = [{ type = "wrench", frame = "blade", name = "ice", components = ["fx", "fy", "mz"] }]
"""


def test_chaplygins_sleigh(tmp_path: Path) -> None:
    """A body on a knife edge, from backwards to forwards: its motion to order two, and its energy."""
    (tmp_path / "sleigh.urdf").write_text(SLEIGH)
    (tmp_path / "robot.toml").write_text(WRENCH)
    robot = mbocp.load_robot(tmp_path)
    T, speed, turn = 2.0, -1.0, 2.0

    def rates(_: float, y: np.ndarray) -> list[float]:
        v, w, heading = y[:3]
        slows = -MASS * AHEAD * v * w / (INERTIA + MASS * AHEAD**2)
        return [AHEAD * w**2, slows, w, v * np.cos(heading), v * np.sin(heading)]

    wanted = solve_ivp(rates, (0, T), [speed, turn, 0, 0, 0], rtol=1e-11, atol=1e-12).y[:, -1]
    errors, drifts = [], []
    for steps in (25, 50):
        with pytest.warns(ProblemWarning, match="asks for nothing"):
            problem = Problem.create(
                robot,
                T,
                steps,
                start={"v": [speed, 0, turn]},
                goal={"enforce": "none"},
                cost={"effort": {"ice.fx": 1, "ice.mz": 1, "ice.fy": 0}},
                limits={"effort": {"ice.fy": 100.0}},
                path=[{**NO_SLIP, "frame": "blade"}],
            )
        solution = mbocp.solve(problem, check=True)
        q, v, heading = solution.qs[-1], solution.vs[-1], wanted[2]
        found = [v[0] * q[2] + v[1] * q[3], v[2], q[0], q[1]]
        errors.append(np.abs(np.array(found) - wanted[[0, 1, 3, 4]]).max())
        assert np.cos(heading) == pytest.approx(q[2], abs=0.01)
        masses = zip(solution.qs, solution.vs, strict=True)
        energies = [0.5 * v @ robot.mass_matrix(q) @ v for q, v in masses]
        drifts.append(np.ptp(energies))
        assert np.abs(solution.us[:, [0, 2]]).max() < 1e-8  # the edge alone pushes, and does no work
    assert errors[1] < 0.3 * errors[0] < 0.01
    assert drifts[1] < 0.3 * drifts[0] < 0.01

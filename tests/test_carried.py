"""Two arms that carry a box through a window: the loop is closed, nothing is touched, grips hold the box."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest

import mbocp
from mbocp import Problem, Solution
from mbocp._arrays import Array
from mbocp.robot import Robot

pytestmark = pytest.mark.slow  # compiling takes most of a minute

FILE = Path(__file__).parents[1] / "examples" / "arms" / "dual_arm_box.toml"
MASS = 2.0  # [kg] of the box


@pytest.fixture(scope="module")
def problem() -> Problem:
    return mbocp.load_problem(FILE)


@pytest.fixture(scope="module")
def solved(problem: Problem) -> Solution:
    return mbocp.solve(problem, solver="monolithic", check=True)


def test_the_loop_is_closed(problem: Problem, solved: Solution) -> None:
    assert np.abs(problem.robot.closure_along(solved.qs)[0]).max() < 1e-12
    assert solved.constraint_violation < 1e-12


def test_box_and_arms_pass_the_window(problem: Problem, solved: Solution) -> None:
    # On geodesics from node to node; the solution says it of its cubics, which are a little apart there.
    assert least_distance(problem, solved.t, solved.qs) == pytest.approx(solved.clearance, abs=5e-4)
    assert solved.clearance > 0.0
    assert problem.goal.q is not None
    model, ends = problem.robot.model, (np.array(problem.q_start), np.array(problem.goal.q))
    line = np.array([pin.interpolate(model, *ends, share) for share in np.linspace(0.0, 1.0, 41)])
    assert least_distance(problem, solved.t, line) < 0.0  # the box would hit the sill


def test_ipopt_agrees(problem: Problem, solved: Solution) -> None:
    other = mbocp.solve(problem, solver="ipopt", check=True)
    assert other.cost == pytest.approx(solved.cost, rel=1e-7)
    np.testing.assert_allclose(other.lams, solved.lams, atol=1e-3 * np.abs(solved.lams).max())


def test_grips_carry_the_box(problem: Problem, solved: Solution) -> None:
    """Their wrenches on the box are its weight and what accelerates it, up to the order of the scheme."""
    finer = mbocp.solve(problem.with_(steps=2 * problem.num_steps), solver="monolithic", check=True)
    errors = [balance_errors(problem.robot, one) for one in (solved, finer)]
    for coarse, fine in zip(*errors, strict=True):
        assert fine < 0.8 * coarse < 0.05  # N, N m; the grips pull by 49 N and turn by 18 N m


def balance_errors(robot: Robot, solution: Solution) -> tuple[float, float]:
    """What is left of the box's balances of force [N] and moment [N m], root mean square over the steps."""
    grips = [f"grip_{side}" for side in ("left", "right")]
    columns = {column.name: k for k, column in enumerate(solution.labels.lam)}
    wrenches = {
        grip: solution.lams[:, [columns[f"{grip}.{row}"] for row in ("x", "y", "z", "rx", "ry", "rz")]]
        for grip in grips
    }
    model, box = robot.model, robot.frame_id("box/body")
    inertia = model.inertias[model.frames[box].parentJoint].inertia
    forces, moments, poses, momenta = [], [], [], []
    for q, v in zip(solution.qs, solution.vs, strict=True):
        data = model.createData()
        pin.forwardKinematics(model, data, q, v)
        pin.updateFramePlacements(model, data)
        speed = pin.getFrameVelocity(model, data, box, pin.LOCAL)
        R = data.oMf[box].rotation
        momenta.append((MASS * R @ speed.linear, R @ inertia @ speed.angular))
        poses.append((data.oMf[box], {grip: data.oMf[robot.frame_id(f"{grip}.b")] for grip in grips}))
    for n, dt in enumerate(np.diff(solution.t)):
        at, placed = poses[n + 1]
        force, moment = np.array([0.0, 0.0, -9.81 * MASS]), np.zeros(3)
        for grip in grips:
            pushed, turned = np.split(wrenches[grip][n], 2)
            pushed, turned = placed[grip].rotation @ pushed, placed[grip].rotation @ turned
            force += pushed
            moment += turned + np.cross(placed[grip].translation - at.translation, pushed)
        forces.append(force - (momenta[n + 1][0] - momenta[n][0]) / dt)
        moments.append(moment - (momenta[n + 1][1] - momenta[n][1]) / dt)
    return tuple(float(np.sqrt(np.mean(np.square(left)))) for left in (forces, moments))  # type: ignore[return-value]


def least_distance(problem: Problem, t: Array, qs: Array) -> float:
    """Of any link from the window at a thousand poses a second [m], by coal alone."""
    model, shapes = problem.robot.model, problem.robot.collision_model
    data, placed = model.createData(), pin.GeometryData(shapes)
    moving = [k for k, shape in enumerate(shapes.geometryObjects) if shape.parentJoint]
    walls = [
        (coal.Box(*o.sizes), coal.Transform3s(o.placement.rotation, o.placement.translation))
        for o in problem.obstacle
    ]
    found = np.inf
    for time in np.arange(t[0], t[-1], 1e-3):
        n = min(int(np.searchsorted(t, time, side="right")) - 1, len(t) - 2)
        q = pin.interpolate(model, qs[n], qs[n + 1], (time - t[n]) / (t[n + 1] - t[n]))
        pin.updateGeometryPlacements(model, data, shapes, placed, q)
        for k, (wall, there) in product(moving, walls):
            at = coal.Transform3s(placed.oMg[k].rotation, placed.oMg[k].translation)
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            shape = shapes.geometryObjects[k].geometry
            found = min(found, float(coal.distance(shape, at, wall, there, request, result)))
    return found

"""`obstacle.motion`: poses by the time, rows with derivatives, the guess, the check, results, replays."""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import Any

import casadi as ca
import coal
import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import CubicHermiteSpline

import mbocp
from mbocp.exceptions import MbocpError
from mbocp.formulation import Motion, formulate
from mbocp.formulation.stage import build_functions
from mbocp.guesses.around import around
from mbocp.guesses.in_time import blend
from mbocp.guesses.ways import straight
from mbocp.mechanics import JointMechanics
from mbocp.problem import Problem, load_problem, parse_problem, problem_to_toml
from mbocp.receding.refusals import check_functions
from mbocp.robot import load_robot
from mbocp.robot.collision.obstacle_motion import ObstacleMotion
from mbocp.terms.point import Point
from mbocp.view.meshcat.goals import obstacle_tracks
from tests.terms.test_distances import leveled

ARMS = Path(__file__).parents[2] / "examples" / "arms"
BELT, CELL = ARMS / "past_a_belt.toml", ARMS / "two_arms_cell.toml"
TIMES, POSITIONS = [0.23, 0.56, 1.31], [[0.7, -0.8, 0.3], [0.6, 0.0, 0.2], [0.5, 0.8, 0.6]]
TURNS = [[0.0, 0.0, 0.0], [0.4, 0.2, 1.5], [-0.3, 0.9, 3.0]]
TABLE = {"times": TIMES, "positions": POSITIONS, "orientations": TURNS}


def reach(motion: dict[str, Any], duration: Any = 1.0, margin: float = -0.5) -> Problem:
    """A UR5 and a box that moves, and that it may be in."""
    box = {"name": "box", "shape": "box", "size": [0.1, 0.2, 0.1], "position": [0.1, 0.0, 0.05]}
    start, goal = [-0.9, -0.9, 1.2, -1.8, -1.57, 0.0], [0.9, -0.9, 1.2, -1.8, -1.57, 0.0]
    return Problem.create(
        "ur5",
        duration,
        10,
        start={"q": start},
        goal={"q": goal, "v": 0},
        obstacle=[{**box, "margin": margin, "motion": motion}],
        integrator={"scheme": "midpoint"},
    )


def expected_pose(t: float) -> pin.SE3:
    """Of the table, by Pinocchio."""
    k = int(np.clip(np.searchsorted(TIMES, t, side="right") - 1, 0, 1))
    share = np.clip((t - TIMES[k]) / (TIMES[k + 1] - TIMES[k]), 0.0, 1.0)
    ends = [pin.Quaternion(pin.rpy.rpyToMatrix(np.array(turn))) for turn in TURNS[k : k + 2]]
    along = np.array(POSITIONS[k]) + share * (np.array(POSITIONS[k + 1]) - POSITIONS[k])
    return pin.SE3(ends[0].slerp(share, ends[1]).matrix(), along)


def test_a_table_is_followed_on_lines_and_by_the_shorter_rotation() -> None:
    (box,) = reach({"times": [*TIMES], "positions": POSITIONS, "orientations": TURNS}).obstacle
    for t in (-1.0, 0.0, 0.23, 0.3, 0.56, 0.9, 1.31, 7.0):
        placed = box.placements(np.array([t]))[0]
        assert placed.isApprox(expected_pose(t) * pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.05])), 1e-12)


def test_a_steady_motion_turns_about_a_point() -> None:
    motion = {
        "velocity": [0.0, 0.1, 0.0],
        "angular_velocity": [0, 0, 2.0],
        "about": [0.5, 0, 0],
        "during": [1, 3],
    }
    (box,) = reach(motion).obstacle
    for t, passed in ((0.5, 0.0), (1.7, 0.7), (9.0, 2.0)):
        turn = pin.SE3(pin.utils.rotate("z", 2.0 * passed), np.array([0.5, 0.1 * passed, 0.0]))
        expected = turn * pin.SE3(np.eye(3), np.array([-0.4, 0.0, 0.05]))
        assert box.placements(np.array([t]))[0].isApprox(expected, 1e-12)


@pytest.mark.parametrize("turns", ["roll,pitch,yaw", "qx,qy,qz,qw", ""])
def test_a_file_and_its_text_say_the_same(tmp_path: Path, turns: str) -> None:
    quaternions = [pin.Quaternion(pin.rpy.rpyToMatrix(np.array(turn))).coeffs() for turn in TURNS]
    columns = {"roll,pitch,yaw": TURNS, "qx,qy,qz,qw": quaternions, "": [[], [], []]}[turns]
    rows = [[t, *p, *turn] for t, p, turn in zip(TIMES, POSITIONS, columns, strict=True)]
    header = ",".join(filter(None, ["t [s],x [m],y,z", turns]))
    lines = [header, *(",".join(map(repr, map(float, row))) for row in rows)]
    (tmp_path / "poses.csv").write_text("\n".join(lines))
    given = problem_to_toml(reach(TABLE if turns else {**TABLE, "orientations": [[0, 0, 0]] * 3}))
    keys = 'shape = "sphere"\nradius = 0.1\nposition = [0.1, 0, 0.05]\nmotion = { file = "poses.csv" }\n'
    (tmp_path / "p.toml").write_text(
        'robot = "ur5"\nhorizon = { duration = 1.0, steps = 4 }\ngoal = { v = 0 }\n'
        f"[[obstacle]]\nmargin = -0.5\n{keys}"
    )
    ts = np.linspace(0.0, 1.5, 7)
    boxes = [load_problem(tmp_path / "p.toml").obstacle[0], parse_problem(given).obstacle[0]]
    for one, other in zip(*(box.placements(ts) for box in boxes), strict=True):
        assert one.isApprox(other, 1e-12)


@pytest.mark.parametrize(
    ("motion", "told"),
    [
        ({}, "expected velocity or angular_velocity, or times"),
        ({"velocity": [1, 0, 0], "times": [0, 1]}, "got .*times.*velocity"),
        ({"during": [0, 1]}, "needs velocity"),
        ({"velocity": [1, 0, 0], "during": [1, 1]}, "during: got"),
        ({"velocity": [1, 0, 0], "about": [1, 0, 0]}, "about: without angular_velocity"),
        ({"times": [0, 1]}, "times and positions go together"),
        ({"times": [0, 0], "positions": [[0, 0, 0]] * 2}, "times: got .*later than"),
        ({"times": [0, 1], "positions": [[0, 0, 0]]}, "positions: got 1 rows"),
        ({"times": [0, 1], "positions": [[0, 0, 0]] * 2, "orientations": [[0, 0]] * 2}, "orientations: got"),
        ({"file": "nowhere.csv"}, "motion.file: nowhere.csv"),
        ({"speed": 1.0}, "speed"),
    ],
)
def test_what_cannot_be_right_is_refused(motion: dict[str, Any], told: str) -> None:
    with pytest.raises(MbocpError, match=rf"(?s)obstacle.*{told}"):
        reach(motion)


def test_other_refusals() -> None:
    with pytest.raises(MbocpError, match="frame: got 'tool0', expected no frame"):
        Problem.create(
            "ur5",
            1.0,
            4,
            goal={"v": 0},
            obstacle=[
                {"shape": "sphere", "radius": 0.1, "frame": "tool0", "motion": {"velocity": [1, 0, 0]}}
            ],
        )
    with pytest.raises(MbocpError, match=r"receding horizon: obstacle\.motion"):
        check_functions(formulate(reach({"velocity": [0, 0.1, 0]})))
    problem = reach({"velocity": [0, 0.1, 0]})
    with pytest.raises(MbocpError, match=r"stop: obstacle\.motion"):
        mbocp.stop(problem, q=problem.q_start, v=np.full(6, 0.1))


def test_an_obstacle_that_is_in_the_way_at_the_end_alone_is_refused() -> None:
    with pytest.raises(MbocpError, match=r"at the goal .* (inside|from) it"):
        reach({"times": [0.9, 1.0], "positions": [[0.25, 2.0, 0.15], [0.25, 0.4, 0.15]]}, margin=0.0)


def test_rows_have_exact_derivatives_in_configuration_and_time() -> None:
    problem = reach(TABLE)
    term = problem.clearance.term
    point = Point(JointMechanics(problem.robot), ca.SX.sym("q", 6), ca.SX.zeros(6), moment=ca.SX.sym("t"))
    function, values = term.function(point), term.values(point)
    rng, numbers = np.random.default_rng(3), list(problem.clearance.numbers.values())
    for t in (0.1, 0.35, 1.1, 1.4):
        z, m = np.append(rng.normal(size=6), t), rng.normal(size=term.rows)
        h, slope, upper = (np.array(found) for found in function(z, m, *numbers))
        expected = problem.clearance.values_along(problem.robot, z[None, :6], z[None], z[None], np.array([t]))
        used = np.flatnonzero(np.isfinite(problem.clearance.lower))
        radii = problem.clearance.inner_bounds[0][used] - problem.clearance.lower[used]
        near = leveled(expected[0, used], problem.clearance.lower[used])
        assert h[used, 0] - radii == pytest.approx(near, abs=1e-9)
        hessian = upper + upper.T - np.diag(np.diag(upper))
        for k, e in enumerate(1e-6 * np.eye(7)):
            change = (values(z + e, *numbers) - values(z - e, *numbers)) / 2e-6
            assert slope[:, k] == pytest.approx(np.array(change)[:, 0], abs=1e-6)
            slopes = [np.array(function(z + s * e, m, *numbers)[1]).T @ m for s in (1, -1)]
            assert hessian[k] == pytest.approx((slopes[0] - slopes[1]) / 2e-6, abs=2e-4)
    assert np.abs(slope[:, 6]).max() == 0.0  # after its last time it stands still


@pytest.mark.parametrize("duration", [1.0, {"min": 0.5, "max": 2.0, "guess": 1.0}])
def test_states_tell_the_time(duration: Any) -> None:
    """Functions of the path see poses at the times of the nodes, whatever the steps, with derivatives."""
    problem = reach(TABLE, duration)
    formulation = formulate(problem)
    qs = straight(problem)(problem.q_start, np.linspace(0.0, 1.0, 11))
    dts = np.full(10, 0.1 if duration == 1.0 else 0.13)
    us = np.zeros((10, 6))
    iterate = formulation.iterate_of(Motion(qs, np.zeros((11, 6)), us, dts), np.zeros((10, 0)))
    made = build_functions(
        JointMechanics(problem.robot), formulation.pieces.signature, ["path", "path_values"]
    )
    clearance, theta, still = problem.clearance, formulation.programme.theta, np.zeros((10, 6))
    expected = clearance.values_along(problem.robot, qs[1:], still, us, np.cumsum(dts))
    used = np.flatnonzero(np.isfinite(clearance.lower))
    radii = clearance.inner_bounds[0][used] - clearance.lower[used]
    u, m = np.zeros(made["path"].numel_in(2)), np.ones(clearance.rows)
    for x, values in zip(iterate.xs[1:], expected, strict=True):
        h, slopes, upper = (np.array(found) for found in made["path"](x, m, u, theta))
        near = leveled(values[used], clearance.lower[used])
        assert h[used, 0] - radii == pytest.approx(near, abs=1e-9)
        assert np.array(made["path_values"](x, u, theta)) == pytest.approx(h)
        for number in (0, len(x) - 1):
            e = 1e-6 * np.eye(len(x))[number]
            ends = [made["path"](x + sign * e, m, u, theta)[:2] for sign in (1, -1)]
            change = np.array(ends[0][0] - ends[1][0])[:, 0] / 2e-6
            assert slopes[:, number] == pytest.approx(change, abs=1e-6)
            curved = np.array(ends[0][1] - ends[1][1]).T @ m / 2e-6
            hessian = upper + upper.T - np.diag(np.diag(upper))
            assert hessian[number] == pytest.approx(curved, abs=2e-4)


def test_the_way_by_the_time_is_clear() -> None:
    problem = load_problem(BELT)
    way, u = around(problem), np.linspace(0.0, 1.0, 200)
    assert way is not None
    ts = problem.duration * u
    assert problem.clearance.least(straight(problem)(problem.q_start, blend(u)), ts=ts).min() < -0.02
    qs = way(problem.q_start, blend(u))
    assert problem.clearance.least(qs, ts=ts).min() > -2e-3
    assert np.abs(qs[-1] - problem.goal.q).max() < 1e-12


def least_distance(
    solution: mbocp.Solution, sizes: list[float], places: list[list[float]], speed: float
) -> float:
    """Of the links of a UR5 from boxes on a belt along y, a thousand times a second, by coal alone.

    Links that balls around them keep farther than 0.1 m from a box are not looked at.
    """
    robot = load_robot("ur5")
    data, geometry = robot.model.createData(), robot.collision_model
    for link in geometry.geometryObjects:
        link.geometry.computeLocalAABB()
    placed, found = pin.GeometryData(geometry), np.inf
    cubics = CubicHermiteSpline(solution.t, solution.qs, solution.vs)
    for t in np.append(np.arange(0.0, solution.t[-1], 1e-3), solution.t[-1]):
        pin.updateGeometryPlacements(robot.model, data, geometry, placed, cubics(t))
        for x, y, z in places:
            at = coal.Transform3s(np.eye(3), np.array([x, y + speed * t, z]))
            for k, link in enumerate(geometry.geometryObjects):
                gap = placed.oMg[k].act(link.geometry.aabb_center) - np.array([x, y + speed * t, z])
                reach = link.geometry.aabb_radius + np.linalg.norm(sizes) / 2.0
                if link.parentJoint and np.linalg.norm(gap) < reach + 0.1:
                    M = coal.Transform3s(placed.oMg[k].rotation, placed.oMg[k].translation)
                    request, result = coal.DistanceRequest(), coal.DistanceResult()
                    found = min(found, coal.distance(link.geometry, M, coal.Box(*sizes), at, request, result))
    return found


def test_boxes_on_a_belt_are_not_touched(tmp_path: Path) -> None:
    """The result tells what coal finds and comes back from its file; its replay moves the boxes."""
    found = mbocp.solve(load_problem(BELT))
    assert found.converged, found.advice
    nearest = least_distance(found, [0.12, 0.12, 0.3], [[0.45, 0.4, 0.15], [0.45, 1.1, 0.15]], -0.8)
    assert nearest > 0.0
    assert found.clearance == pytest.approx(nearest, abs=1e-4)
    again = mbocp.Solution.load(found.save(tmp_path / "belt.h5"))
    boxes = again.load_problem().obstacle
    tracks = {(t.path, t.name): t for t in obstacle_tracks(boxes, np.array([0.0, 0.5]), "/world")}
    places = tracks["/world/obstacles/1_second box", "position"].values
    np.testing.assert_allclose(places, [[0.45, 1.1, 0.15], [0.45, 0.7, 0.15]], atol=1e-12)


def test_poses_are_those_of_long_motions_too() -> None:
    """A motion that never ends keeps its digits, and finds how near it comes to a point."""
    motion = ObstacleMotion.steady(np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.5, 0.0]), np.zeros(3))
    assert motion.poses(np.array([1e4]))[0, :3] == pytest.approx([0.0, 4999.0, 0.0], abs=1e-9)
    assert motion.distance_from(np.array([0.3, 2.0, 0.0])) == pytest.approx(0.3, abs=1e-9)
    assert motion.distance_from(np.array([0.0, -3.0, 0.0])) == pytest.approx(2.0, abs=1e-9)


def test_motions_that_begin_alike_are_told_apart() -> None:
    box = {"shape": "box", "size": [0.1, 0.1, 0.1], "position": [0.6, -1.5, 0.2], "movable": True}
    motions = [{"velocity": [0, speed, 0]} for speed in (0.5, 0.5, 0.8)]
    obstacles = [{**box, "name": str(k), "motion": motion} for k, motion in enumerate(motions)]
    clearance = Problem.create("ur5", 1.0, 4, goal={"v": 0}, obstacle=obstacles).clearance
    assert len(clearance.movers) == 2
    assert [clearance.frame_of(one) for one in clearance.obstacles] == [
        k + clearance.scene.nframes for k in (-2, -2, -1)
    ]


def test_a_result_is_a_robot_that_moves(tmp_path: Path) -> None:
    """Spheres are where the links of its robot are at its nodes, also when it is read back from a text."""
    arm = Problem.create("ur5", 1.0, 3, goal={"q": [0.5] * 6, "v": 0}, integrator={"scheme": "se1"})
    other = mbocp.solve(arm)
    other.save(tmp_path / "other.h5")
    (tmp_path / "p.toml").write_text(
        'robot = "ur5"\nhorizon = { duration = 1.0, steps = 4 }\ngoal = { v = 0 }\n'
        '[[obstacle]]\nname = "other"\nresult = "other.h5"\nposition = [0, 3, 0]\nrpy = [0, 0, 1.0]\n'
    )
    problem = load_problem(tmp_path / "p.toml")
    assert len(problem.clearance.movers) == len(arm.robot.collision_spheres)
    again = parse_problem(problem_to_toml(problem))
    assert len(again.clearance.movers) == len(problem.clearance.movers)
    base = pin.SE3(pin.utils.rotate("z", 1.0), np.array([0.0, 3.0, 0.0]))
    for read in (problem, again):
        spheres = {sphere.name: sphere for sphere in read.obstacle}
        for link in arm.robot.collision_spheres:
            for t, q in zip(other.t, other.qs, strict=True):
                placed = spheres[f"other/{link.link}[0]"].placements(np.array([t]))[0]
                center = (base * arm.robot.frame_placement(link.link, q)).act(link.centers[0])
                assert placed.translation == pytest.approx(center, abs=1e-9)


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ('result = "nowhere.h5"', "no such file"),
        ('result = "p.toml"', "is not a result file"),
        ('result = "p.toml"\nshape = "box"', "shape: with a result there are"),
        ('name = "box"', "shape: required"),
    ],
)
def test_what_is_no_robot_that_moves_is_refused(tmp_path: Path, keys: str, told: str) -> None:
    text = 'robot = "ur5"\nhorizon = { duration = 1.0, steps = 4 }\ngoal = { v = 0 }\n[[obstacle]]\n'
    (tmp_path / "p.toml").write_text(text + keys)
    with pytest.raises(MbocpError, match=rf"(?s)obstacle.*{told}"):
        load_problem(tmp_path / "p.toml")


def test_robots_of_a_cell_have_a_distance_of_their_own() -> None:
    clearance = load_problem(CELL).clearance
    names = [clearance.names_of(clearance.link_pairs[group]) for group in clearance.groups]
    is_both = np.array([a.split("/")[0] != b.split("/")[0] for a, b in names])
    assert (clearance.margins[is_both] == 0.02).all()
    assert (clearance.margins[~is_both] == 0.0).all()
    assert is_both.any()
    assert not is_both.all()


@pytest.mark.slow
def test_two_arms_of_a_cell_visit_one_fixture() -> None:
    """They keep 2 cm apart at every millisecond, by coal alone."""
    problem = load_problem(CELL)
    found = mbocp.solve(problem)
    assert found.converged, found.advice
    geometry, model = pin.GeometryModel(problem.robot.collision_model), problem.robot.model
    sides = [
        [k for k, g in enumerate(geometry.geometryObjects) if g.name.startswith(s)] for s in ("left", "right")
    ]
    for one, other in product(*sides):
        geometry.addCollisionPair(pin.CollisionPair(one, other))
    data, placed = model.createData(), pin.GeometryData(geometry)
    for request in placed.collisionRequests:
        request.security_margin = 0.0199
    for t in np.append(np.arange(0.0, found.t[-1], 1e-3), found.t[-1]):
        q = np.array([np.interp(t, found.t, column) for column in found.qs.T])
        assert not pin.computeCollisions(model, data, geometry, placed, q, True), t
    both = np.append(problem.via[0].goal.q[:6], problem.via[1].goal.q[6:])
    assert pin.computeCollisions(model, data, geometry, placed, both, True)  # both cannot be there at once
    assert found.t[-1] < 1.3  # one arm alone takes 1.025 s

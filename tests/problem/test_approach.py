"""The nearest approach of a motion: where nothing is looked at, nothing is nearer."""

from __future__ import annotations

import copy
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbocp import solve
from mbocp.exceptions import ProblemError
from mbocp.problem import Problem
from mbocp.problem.obstacles.approach import (
    clearances_along,
    keeps_clear,
    nearest_approach,
    poses_between,
    touches_along,
)
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.problem.obstacles.shape_distances import ShapeDistances
from mbocp.solution.later import is_there

START = np.array([-0.9, -0.9, 1.2, -1.8, -1.57, 0.0])
OBSTACLES: list[dict[str, Any]] = [
    {
        "name": "box",
        "shape": "box",
        "margin": 0.01,
        "size": [0.12, 0.12, 0.5],
        "position": [0.45, -0.05, 0.15],
    },
    {"name": "ball", "shape": "sphere", "radius": 0.08, "position": [0.22, 0.3, 0.1], "margin": 0.03},
    {"name": "floor", "shape": "halfspace", "position": [0, 0, -0.2]},
]


@pytest.fixture(scope="module")
def clearance() -> Clearance:
    """Of an arm with meshes."""
    problem = Problem.create(
        "ur5", 1.0, 8, start={"q": START}, goal={"q": START, "v": 0}, obstacle=OBSTACLES, self_collision=True
    )
    assert problem.clearance is not None
    return problem.clearance


def test_shapes_decide_where_spheres_of_links_overlap() -> None:
    """With the arm stretched out, spheres of its forearm and its wrist overlap; they meet when it folds."""
    stretched, beyond = np.zeros(6), np.array([0.0, 0.0, 0.0, 2.9, 0.0, 0.0])
    problem = Problem.create("ur5", 1.0, 8, start={"q": stretched}, goal={"q": beyond}, self_collision=True)
    assert problem.clearance is not None
    found = nearest_approach(problem.clearance, np.array([0.0, 1.0]), np.array([stretched, beyond]))
    assert found is not None
    assert (found.link, found.other) == ("forearm_link", "wrist_2_link")
    assert found.distance < 0.0
    assert clearances_along(problem.clearance, np.zeros(1), stretched[None])[0] > 0.01


def test_hardly_a_pose_is_kept_out_where_shapes_of_links_decide() -> None:
    """Of poses in which base and upper arm are apart, one in fifty, and these by less than 2 mm."""
    q = np.zeros(6)
    problem = Problem.create("ur5", 1.0, 2, start={"q": q}, goal={"q": 0.1 + q}, self_collision=True)
    clearance = problem.clearance
    assert clearance is not None
    pair = ("base_link", "upper_arm_link")
    (group,) = (n for n, found in enumerate(clearance.link_pairs) if clearance.names_of(found) == pair)
    qs = np.zeros((1000, 6))
    qs[:, :2] = np.random.default_rng(3).uniform(-np.pi, np.pi, (1000, 2))  # what else moves is not between
    apart = np.array([_apart(problem, pair, q) for q in qs])
    kept = clearance.pair_values(qs)[:, clearance.groups == group].min(axis=1)
    assert 0.9 < apart.mean() < 1.0
    assert (kept[apart] < 0.0).mean() < 0.02
    assert kept[apart].min() > -2e-3  # [m]
    assert (kept[~apart] < 0.0).mean() > 0.3


def _apart(problem: Problem, links: tuple[str, str], q: np.ndarray) -> bool:
    """Whether shapes of two links do not meet, by coal."""
    shapes, model = problem.robot.collision_model, problem.robot.model
    placed = pin.GeometryData(shapes)
    pin.updateGeometryPlacements(model, model.createData(), shapes, placed, q)
    found = [
        (
            shapes.geometryObjects[k].geometry,
            coal.Transform3s(placed.oMg[k].rotation, placed.oMg[k].translation),
        )
        for k in range(shapes.ngeoms)
        if model.frames[shapes.geometryObjects[k].parentFrame].name in links
    ]
    (one, at), (other, there) = found
    return not coal.collide(one, at, other, there, coal.CollisionRequest(), coal.CollisionResult())


def test_a_start_in_which_such_links_meet_is_refused() -> None:
    start = [2.78, 2.46, 2.29, -0.07, 1.53, 2.45]
    with pytest.raises(ProblemError, match=r"at the start base_link is .* mm inside upper_arm_link, and"):
        Problem.create("ur5", 1.0, 8, start={"q": start}, goal={"v": 0}, self_collision=True)


def test_shapes_decide_where_spheres_overlap_at_the_goal() -> None:
    """Those of a forearm and a last wrist, which are apart in the default pose, are 35 mm in each other."""
    open_, bent = np.array([0.0, -1.0, 1.0, 0.0, 0.5, 0.0]), np.array([0.0, -1.0, 1.0, 1.57, 2.2, 0.0])
    words: dict[str, Any] = {"start": {"q": open_}, "self_collision": True}
    words["cost"] = {"effort": 1e-3, "velocity": 0.1}
    beside = Problem.create("ur5", 2.0, 20, goal={"q": open_ + 0.1, "v": 0}, **words)
    there = Problem.create("ur5", 2.0, 20, goal={"q": bent, "v": 0}, **words)
    assert beside.clearance is not None
    assert there.clearance is not None
    assert beside.clearance.least(bent[None])[0] < -0.03
    assert there.clearance.least(bent[None])[0] >= 0.0
    solution = solve(there)
    assert solution.converged, solution.advice
    assert solution.clearance > 0.0
    back = {"q": open_, "v": 0}
    assert Problem.create("ur5", 2.0, 20, goal=back, **{**words, "start": {"q": bent}}).clearance is not None
    folded = {"q": [0.0, -1.0, 1.0, 2.2, 2.2, 0.0], "v": 0}
    with pytest.raises(ProblemError, match=r"at the goal forearm_link is .* inside wrist_3_link"):
        Problem.create("ur5", 2.0, 20, goal=folded, **words)


def motion(seed: int, spread: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and configurations of four nodes."""
    rng = np.random.default_rng(seed)
    return np.array([0.0, 0.005, 0.01, 0.016]), START + np.cumsum(
        spread * rng.standard_normal((4, 6)), axis=0
    )


def pairs_of(clearance: Clearance) -> tuple[list[tuple[int, int, bool]], list[float]]:
    """Each pair of a link and an obstacle or a link, and its margin."""
    found: dict[tuple[int, int, bool], float] = {}
    for row, (a, k) in enumerate(clearance.pairs):
        found.setdefault((clearance.spheres[a][0], k, True), clearance.margins[row])
    for row, (a, b) in enumerate(clearance.sphere_pairs, start=len(clearance.pairs)):
        found.setdefault((clearance.spheres[a][0], clearance.spheres[b][0], False), clearance.margins[row])
    return list(found), list(found.values())


def all_distances(clearance: Clearance, t: np.ndarray, qs: np.ndarray) -> np.ndarray:
    """Distances beyond margins of all pairs at all poses."""
    pairs, margins = pairs_of(clearance)
    shapes, found = ShapeDistances(clearance, pairs), []
    for q in poses_between(clearance.robot, t, qs)[1]:
        shapes.place(q)
        found.append([shapes.of(k) for k in range(len(pairs))])
    return np.array(found) - margins


def test_what_runs_backwards_or_is_not_finite_has_no_poses(clearance: Clearance) -> None:
    t, qs = motion(0, 0.3)
    assert nearest_approach(clearance, t, qs) is not None
    for ts, places in ((-t, qs), (t[[0, 2, 1, 3]], qs), (0.0 * t, qs), (t, np.nan * qs)):
        assert nearest_approach(clearance, ts, places) is None
        assert keeps_clear(clearance, ts, places, 0.0)
        assert touches_along(clearance, ts, places) == {}


@settings(max_examples=8)
@given(seed=st.integers(0, 10_000), spread=st.sampled_from([0.0, 1e-9, 0.03, 0.15, 0.4]))
def test_it_is_the_least_of_all_pairs_at_all_poses(clearance, seed, spread):
    """Of pairs that are in each other it is the least of neighbouring poses."""
    t, qs = motion(seed, spread)
    found = nearest_approach(clearance, t, qs)
    beyond, (pairs, margins) = all_distances(clearance, t, qs), pairs_of(clearance)
    least, told = beyond.min(), found.distance - found.margin
    assert told == pytest.approx(least, abs=2e-6) or (found.distance <= 0.0 and told > least)
    times, sampled = poses_between(clearance.robot, t, qs)
    n = int(np.abs(times - found.time).argmin())
    of_pairs = [k for k in range(len(pairs)) if beyond[n, k] == pytest.approx(told, abs=2e-6)]
    assert of_pairs
    if found.distance < 0.0:
        beside = beyond[max(n - 1, 0) : n + 2][:, of_pairs]
        assert (beside >= told - 2e-6).all(axis=0).any()
    along = (beyond + margins).min(axis=1)
    assert clearances_along(clearance, times, sampled) == pytest.approx(along, abs=2e-6)
    touches, deepest = touches_along(clearance, t, qs), -(beyond + margins).min(axis=0)
    depths = sorted(-touch.distance for touch in touches.values())
    inside = zip(depths, sorted(deepest[deepest > 0.0]), strict=True)
    assert all(0.0 < depth <= most + 2e-6 for depth, most in inside)
    assert found.distance >= 0.0 or found.between in touches


@settings(max_examples=8)
@given(seed=st.integers(0, 10_000), spread=st.sampled_from([0.03, 0.15, 0.4]), aside=st.floats(-0.02, 0.02))
def test_what_keeps_clear_has_no_approach_below_its_margin(clearance, seed, spread, aside):
    """With margins that put the nearest approach to both sides of what is allowed."""
    t, qs = motion(seed, spread)
    least = all_distances(clearance, t, qs).min()
    moved = copy.copy(clearance)
    moved.__dict__.pop("_pair_clearances", None)  # which has the margins, too
    moved.__dict__["margins"] = clearance.margins + (least + aside if abs(aside) > 1e-5 else 0.0)
    approach = nearest_approach(moved, t, qs)
    is_clear = approach.distance >= max(approach.margin, 0.0) - 1e-9
    deepest = (all_distances(clearance, t, qs) + pairs_of(clearance)[1]).min()
    assert keeps_clear(moved, t, qs, 1e-9) == (is_clear and deepest >= -1e-9)


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), spread=st.floats(0.0, 1.0))
def test_nothing_comes_nearer_than_its_points_move(clearance, seed, spread):
    pairs, _ = pairs_of(clearance)
    qs = motion(seed, spread)[1]
    joints = clearance.joint_placements(qs)
    shapes, found = ShapeDistances(clearance, pairs), []
    for q in qs:
        shapes.place(q)
        found.append([shapes.of(k) for k in range(len(pairs))])
    for k, values in enumerate(np.array(found).T):
        moved = shapes.displacements(k, joints[0], joints)
        assert moved[0] == 0.0
        assert (np.maximum(values[0], 0.0) - np.maximum(values, 0.0) <= moved + 2e-6).all()


@given(seed=st.integers(0, 10_000))
def test_joints_are_where_pinocchio_places_them(clearance, seed):
    model = clearance.robot.model
    data, qs = model.createData(), motion(seed, 1.0)[1]
    for q, placed in zip(qs, clearance.joint_placements(qs), strict=True):
        pin.forwardKinematics(model, data, q)
        for joint in range(model.njoints):
            np.testing.assert_allclose(placed[joint], data.oMi[joint].homogeneous[:3], atol=1e-14)


def test_a_motion_without_numbers_keeps_clear_and_comes_near_to_nothing(clearance):
    qs = np.full((2, 6), np.nan)
    assert keeps_clear(clearance, np.array([0.0, 1.0]), qs, 0.0)
    assert nearest_approach(clearance, np.array([0.0, 1.0]), qs) is None


def test_a_motion_that_keeps_clear_tells_how_near_it_comes_when_asked():
    goal = {"q": START - np.array([0.3, 0, 0, 0, 0, 0]), "v": 0}
    problem = Problem.create("ur5", 1.0, 6, start={"q": START}, goal=goal, obstacle=OBSTACLES)
    found = solve(problem)
    assert found.converged
    assert not is_there(found, "clearance")
    expected = nearest_approach(problem.clearance, found.t, found.qs, found.vs)
    assert (found.clearance, found.clearance_time) == (expected.distance, expected.time)
    assert found.clearance_between == expected.between
    assert is_there(found, "clearance")


@pytest.fixture(scope="module")
def crowd() -> Clearance:
    """Of the arm among hundreds of small boxes, one on its wrist, and a floor."""
    rng, boxes = np.random.default_rng(1), OBSTACLES[1:]
    for k, at in enumerate(rng.uniform([-1.0, -1.0, 0.4], [1.0, 1.0, 1.2], (300, 3))):
        where = {"frame": "wrist_1_link"} if k == 0 else {}
        size = rng.uniform(0.01, 0.05, 3).tolist()
        boxes.append({"name": f"b{k}", "shape": "box", "size": size, "position": at.tolist(), **where})
    problem = Problem.create(
        "ur5", 1.0, 8, start={"q": START}, goal={"q": START, "v": 0}, obstacle=boxes, self_collision=True
    )
    assert problem.clearance is not None
    return problem.clearance


@pytest.mark.parametrize("seed", range(4))
def test_what_is_far_changes_nothing(crowd: Clearance, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Links whose spheres are far are left out, and nothing that comes nearer than was asked."""
    t, qs = motion(seed, 0.02 + 0.1 * seed)
    near = 0.1
    least = (crowd.pair_values(qs) - crowd.margins).min(axis=0)
    assert np.count_nonzero(least < near) < crowd.num_pairs / 2
    np.testing.assert_allclose(crowd.nearest_of_pairs(qs, near), np.minimum(least, near), atol=1e-12)
    culled = nearest_approach(crowd, t, qs), clearances_along(crowd, t, qs), keeps_clear(crowd, t, qs, 1e-4)
    monkeypatch.setattr("mbocp.problem.obstacles.approach._NEARS", (np.inf,))
    assert culled[0] == nearest_approach(crowd, t, qs)
    np.testing.assert_allclose(culled[1], clearances_along(crowd, t, qs), atol=1e-9)
    assert culled[2] == keeps_clear(crowd, t, qs, 1e-4)

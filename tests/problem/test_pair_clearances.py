"""Clearances in numbers and ways in C++, beside Pinocchio's placements."""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mbocp
from mbocp.problem import Problem
from mbocp.problem.obstacles.clearance import Clearance
from mbocp.problem.obstacles.pair_clearances import PairClearances, PlacedShape, WaySize
from mbocp.terms.distances import core_of
from tests.robot.urdfs import link, robot, write

JOINT = (
    '<joint name="j{k}" type="{kind}"><origin xyz="0.1 0 0.2" rpy="0.1 0.2 0.3"/><parent link="l{k}"/>'
    '<child link="l{next}"/><axis xyz="0 0.6 0.8"/>{more}</joint>'
)
LIMIT = '<limit lower="-2" upper="2" effort="9" velocity="9"/>'
MIMIC = LIMIT + '<mimic joint="j0" multiplier="-0.7" offset="0.2"/>'
SIZE = WaySize(step=0.2, resolution=0.02, most=5000, cuts=50)


def chain() -> str:
    """A link on a joint of each kind that a URDF has."""
    kinds = [("revolute", LIMIT), ("prismatic", LIMIT), ("continuous", ""), ("revolute", MIMIC)]
    joints = [JOINT.format(k=k, next=k + 1, kind=kind, more=more) for k, (kind, more) in enumerate(kinds)]
    return robot(*(link(f"l{k}") for k in range(len(kinds) + 1)), *joints)


@pytest.mark.parametrize("floats", [False, True])
def test_places_are_pinocchios(tmp_path, floats: bool) -> None:
    """The height of a point above a halfspace, for each link."""
    made = mbocp.load_robot(write(tmp_path, chain()), free_flyer=floats, mimic=True)
    model, rng = made.model, np.random.default_rng(0)
    frames = tuple(k for k, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY)
    centers, core = rng.normal(size=(len(frames), 3)), core_of("halfspace", (), 2e-3)
    at = np.array([0.0, 0.0, core.middle - 5.0])
    table = np.array([[k, 0, 0.1, 0.05, 0] for k in range(len(frames))])
    plane = PlacedShape(0, at, np.eye(3), core)
    pairs = PairClearances(model, frames, tuple(enumerate(centers, start=1)), (plane,), table)
    qs = np.array([pin.integrate(model, made.q0, rng.uniform(-1.5, 1.5, model.nv)) for _ in range(20)])
    data, expected = model.createData(), []
    for q in qs:
        pin.framesForwardKinematics(model, data, q)
        points = [data.oMf[frame].act(c) for frame, c in zip(frames, centers, strict=True)]
        expected.append([point[2] + 5.0 - 0.1 for point in points])
    np.testing.assert_allclose(pairs.values(qs), expected, atol=1e-9)
    least = np.min(expected, axis=1) - 0.05
    np.testing.assert_allclose(pairs.least(qs), least, atol=1e-9)
    np.testing.assert_allclose(pairs.of_groups(qs, np.inf)[:, 0], least, atol=1e-9)
    np.testing.assert_allclose(pairs.nearest(qs, np.inf), np.min(expected, axis=0) - 0.05, atol=1e-9)


@pytest.fixture(scope="module")
def clearance() -> Clearance:
    post = {"name": "post", "shape": "box", "size": [0.1, 0.1, 0.6], "position": [0.45, 0.0, 0.3]}
    start, goal = [-0.6, -1.0, 1.2, -0.2, 0.5, 0.0], [0.9, -1.0, 1.2, -0.2, 0.5, 0.0]
    made = mbocp.load_robot("ur5")
    problem = Problem.create(
        made, 2.0, 20, start={"q": start}, goal={"q": goal}, obstacle=[post], scheme="se1"
    )
    assert problem.clearance is not None
    return problem.clearance


def test_a_way_keeps_its_reserve(clearance: Clearance) -> None:
    ends = np.array([[-0.6, -1.0, 1.2, -0.2, 0.5, 0.0], [0.9, -1.0, 1.2, -0.2, 0.5, 0.0]])
    ranges = np.array([np.full(6, -np.pi), np.full(6, np.pi), np.ones(6)])
    lines = np.linspace(ends[0], ends[1], 200)
    assert clearance.least(lines).min() < 0.0
    way = clearance.way(ends, ranges, 0.01, 0, SIZE)
    assert way is not None
    np.testing.assert_array_equal(way[[0, -1]], ends)
    np.testing.assert_array_equal(way, clearance.way(ends, ranges, 0.01, 0, SIZE))
    along = np.vstack([np.linspace(a, b, 100) for a, b in pairwise(way)])
    assert clearance.least(along).min() > 0.0
    other = clearance.way(ends, ranges, 0.01, 1, SIZE)
    assert other is not None
    assert other.shape != way.shape or not np.allclose(other, way)


def test_a_goal_inside_something_has_no_way(clearance: Clearance) -> None:
    start, goal = np.array([[-0.6, -1.0, 1.2, -0.2, 0.5, 0.0], [0.9, -1.0, 1.2, -0.2, 0.5, 0.0]])
    line = np.linspace(start, goal, 200)
    inside = np.array([start, line[clearance.least(line).argmin()]])
    ranges = np.array([np.full(6, -np.pi), np.full(6, np.pi), np.ones(6)])
    assert clearance.way(inside, ranges, 0.0, 0, SIZE) is None


@given(near=st.floats(-0.2, 2.0), seed=st.integers(0, 10**6))
@settings(max_examples=100)
def test_what_is_near_is_exact_and_what_is_far_is_between(near: float, seed: int) -> None:
    """For every kind of shape, with points on all sides of it and inside."""
    rng = np.random.default_rng(seed)
    model = pin.buildSampleModelManipulator()
    frames = tuple(k for k, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY)
    sizes = {"sphere": 1, "capsule": 2, "box": 3, "cylinder": 2, "halfspace": 0}
    spheres, shapes = [], []
    for place in range(1, len(frames) + 1):
        for shape, count in sizes.items():
            core = core_of(shape, rng.uniform(0.05, 0.5, count), 2e-3)
            axes = pin.SE3.Random().rotation
            at = rng.normal(size=3) + core.middle * axes[:, 2]
            spheres.append((place, rng.normal(size=3)))
            shapes.append(PlacedShape(0, at, axes, core))
    every = np.array(list(product(range(len(spheres)), range(len(shapes)))))
    count = len(every)
    numbers = [rng.uniform(0.0, 0.2, count), rng.uniform(-0.02, 0.1, count), rng.integers(0, 5, count)]
    pairs = PairClearances(model, frames, tuple(spheres), tuple(shapes), np.column_stack([every, *numbers]))
    qs = np.array([pin.randomConfiguration(model) for _ in range(3)])
    exact, found = pairs.values(qs), pairs.values(qs, near)
    is_near = exact <= near
    assert np.array_equal(found[is_near], exact[is_near])
    assert (found <= exact + 1e-12).all()
    assert (found[~is_near] >= near - 1e-12).all()
    beyond = exact - pairs.pairs[:, 3]
    np.testing.assert_allclose(pairs.nearest(qs, near), np.minimum(beyond.min(axis=0), near), atol=1e-12)
    np.testing.assert_allclose(pairs.least(qs, near), np.minimum(beyond.min(axis=1), near), atol=1e-12)
    groups = np.column_stack([beyond[:, pairs.pairs[:, 4] == k].min(axis=1) for k in range(5)])
    found, is_near = pairs.of_groups(qs, near), groups <= near - 2e-3  # by which edges are rounded at most
    np.testing.assert_allclose(found[is_near], groups[is_near], atol=2e-3)
    assert (found[~is_near] >= near - 4e-3).all()
    assert (found <= groups + 2e-3).all()

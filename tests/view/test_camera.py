"""The camera of a replay, for windows of any shape."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mbocp.robot import FrameTarget, load_robot
from mbocp.terms.frame_goal import FrameGoal
from mbocp.view.camera import ASPECT, FIELD_OF_VIEW, FILL_ABOVE, FILL_BELOW, FILL_SIDE, Camera, fit_camera
from mbocp.view.marks import Marks, ViaMark
from mbocp.view.meshcat.goals import axis_points, goal_placements
from mbocp.view.meshcat.scene import build_scene
from mbocp.view.motion_samples import sample_motion

ASPECTS = st.floats(0.25, 4.0)
ROUGHLY = 1.02  # windows between those that the camera was made for


@st.composite
def clouds(draw: st.DrawFn) -> np.ndarray:
    """Points of motions that are wide, tall, deep or all of it."""
    seed, sizes = draw(st.integers(0, 2**32 - 1)), draw(st.tuples(*[st.floats(0.02, 3.0)] * 3))
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (40, 3)) * sizes


def shares(camera: Camera, points: np.ndarray, aspect: float) -> tuple[np.ndarray, np.ndarray]:
    """How far aside and above the points are seen, as parts of half the picture."""
    back = camera.offset / np.linalg.norm(camera.offset)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    x, y, ahead = ((points - camera.target) @ axis for axis in (right, np.cross(back, right), back))
    half = np.tan(np.deg2rad(FIELD_OF_VIEW) / 2.0) * (camera.distance(aspect) - ahead)
    return x / half / aspect, y / half


@given(clouds(), ASPECTS)
def test_all_points_are_in_the_picture(points: np.ndarray, aspect: float) -> None:
    x, y = shares(fit_camera(points, points), points, aspect)
    assert np.abs(x).max() <= ROUGHLY * FILL_SIDE
    assert y.max() <= FILL_ABOVE + 1e-9
    assert y.min() >= -FILL_BELOW - 1e-9


@given(clouds(), ASPECTS)
def test_they_fill_it_in_one_direction(points: np.ndarray, aspect: float) -> None:
    camera = fit_camera(points, points)
    if camera.distance(aspect) <= 0.2 * np.linalg.norm(np.ptp(points, axis=0)) + 1e-9:
        return  # nearer than that it never goes
    x, y = shares(camera, points, aspect)
    fills = (np.abs(x).max() / FILL_SIDE, y.max() / FILL_ABOVE, -y.min() / FILL_BELOW)
    assert max(fills) == pytest.approx(1.0, rel=ROUGHLY - 1.0)


@given(clouds())
def test_the_offset_is_that_of_the_usual_window(points: np.ndarray) -> None:
    camera = fit_camera(points, points)
    assert np.linalg.norm(camera.offset) == pytest.approx(camera.distance(ASPECT))


@pytest.mark.parametrize("aspect", [0.3, 0.5, 1.0, 1.5, 3.0])
def test_axes_of_goals_and_boxes_of_via_points_are_in_the_picture(aspect: float) -> None:
    robot = load_robot("ur5")
    qs = np.array([robot.q0, robot.q0 + 0.01])
    motion = sample_motion(robot.model, np.array([0.0, 1.0]), qs)
    place, far, sides = np.array([0.2, -1.0, 1.0]), np.array([1.5, 0.2, 0.1]), np.array([0.4, 0.5, 0.6])
    goal = FrameTarget(name="tool0", position=far, orientation=np.array([0.0, 0.0, 0.0, 1.0]))
    via = FrameGoal(target=FrameTarget(name="tool0", position=place), position_tolerance=sides)
    scene = build_scene(robot, motion, goals=[goal], marks=Marks(via=(ViaMark(0.5, via),)))
    corners = place + sides * np.array(list(itertools.product([-1.0, 1.0], repeat=3)))
    ends = axis_points(goal_placements(robot, [goal], qs[-1]), scene.size)
    x, y = shares(scene.camera, np.vstack([corners, ends]), aspect)
    assert np.abs(x).max() <= ROUGHLY * FILL_SIDE
    assert y.max() <= FILL_ABOVE + 1e-9
    assert y.min() >= -FILL_BELOW - 1e-9


def box(centre: list[float], sides: list[float]) -> np.ndarray:
    return np.array(centre) + np.array(list(itertools.product([-0.5, 0.5], repeat=3))) * sides


def azimuth(camera: Camera) -> float:
    return float(np.arctan2(camera.offset[1], camera.offset[0]))


@given(st.floats(-np.pi, np.pi), clouds())
def test_a_wall_before_the_motion_turns_the_camera_to_its_other_side(way: float, points: np.ndarray) -> None:
    ahead = np.array([np.cos(way), np.sin(way)])
    reach = float(np.linalg.norm(points, axis=1).max())
    turn = np.array([[ahead[0], -ahead[1], 0.0], [ahead[1], ahead[0], 0.0], [0.0, 0.0, 1.0]])
    wall = box([1.5 * reach, 0.0, 0.0], [0.1, 20.0 * reach, 20.0 * reach]) @ turn.T
    found = azimuth(fit_camera(points, points, obstacles=[wall]))
    assert np.cos(found - way) < 0.3  # not through the wall


@given(clouds())
def test_what_hides_nothing_leaves_the_camera_as_it_is(points: np.ndarray) -> None:
    below = box([0.0, 0.0, -20.0], [0.1, 0.1, 0.1])
    free, beside = (fit_camera(points, points, obstacles=boxes) for boxes in ([], [below]))
    np.testing.assert_array_equal(free.offset, beside.offset)

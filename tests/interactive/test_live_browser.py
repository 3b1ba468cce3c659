"""The live page in a real browser, headless. Slow: run with `-m slow`; it needs Chromium and viser."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from mbocp.problem import Problem
from mbocp.robot import load_robot
from mbocp.view import movie
from mbocp.view.meshcat.surroundings import BACKGROUND
from tests.view.pages import angles, write_arm

pytest.importorskip("viser", reason="viser is not installed: pip install 'mbocp[live]'")

import mbocp
from mbocp.interactive import Live
from tests.view.devtools import WAIT, OpenPage

SIZE = (1200, 700)
BOX = '<origin xyz="0 0 0.5"/><geometry><box size="0.1 0.1 1"/></geometry>'
GRIP = 0.8  # of the length of a handle's arrows: where the hand takes them
STILL = 2.0  # [s] of frames, after which nothing that was asked for is still on its way

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(movie.find_browser() is None, reason="no Chromium"),
]


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return load_robot(write_arm(tmp_path_factory.mktemp("arm"), upper=BOX, base=BOX))


@pytest.fixture
def live(arm):
    problem = Problem.create(
        arm,
        1.0,
        20,
        start={"q": angles(0.3, 0.4)},
        goal={"v": 0, "frame": {"name": "tip", "x": 0.7, "z": 1.2}},
        cost={"effort": 1.0, "velocity": 0.5},
    )
    with Live(problem, mbocp.solve(problem), port=18180) as served:
        served._plays.value = False
        yield served


@pytest.fixture
def page(live, tmp_path):
    with OpenPage(live.url, tmp_path / "profile", SIZE) as opened:
        until(lambda: len(live._server.get_clients()) == 1)
        until(lambda: drawn(opened.picture()).sum() > 1000)
        yield opened


def until(is_so: Callable[[], bool]) -> None:
    end = time.monotonic() + WAIT
    while not is_so():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.1)


def drawn(picture: np.ndarray) -> np.ndarray:
    """Where something stands out from the sky, in the part of the window that has no controls."""
    return np.abs(picture - picture[-5, 5]).max(axis=2)[160:, : SIZE[0] - 360] > 60.0


def pixel(live: Live, point: np.ndarray) -> np.ndarray:
    """Where a point in the page's space is seen."""
    ((_, client),) = live._server.get_clients().items()
    camera = client.camera
    w, x, y, z = camera.wxyz
    seen = pin.Quaternion(w, x, y, z).matrix().T @ (point - camera.position)  # right, down, ahead
    half = 0.5 * SIZE[1] / np.tan(0.5 * camera.fov)
    return 0.5 * np.array(SIZE) + half * seen[:2] / seen[2]


def directions(handle) -> np.ndarray:
    """Axes of a handle in the page's space, as rows."""
    w, x, y, z = handle.wxyz
    return pin.Quaternion(w, x, y, z).matrix().T


def test_the_page_shows_the_robot_and_complains_of_nothing(page):
    assert page.value("document.title")
    assert page.value("Math.max(...[...document.querySelectorAll('canvas')].map((c) => c.width))") == SIZE[0]
    seen = page.picture()[160:, : SIZE[0] - 360][drawn(page.picture())]
    assert np.ptp(seen.mean(axis=1)) > 40.0  # lit from one side; what is as light as the floor is left out
    assert page.picture()[5, SIZE[0] // 2] == pytest.approx(255.0 * np.array(BACKGROUND), abs=3.0)
    assert not page.errors()


def test_a_hand_on_the_goal_moves_the_robot(page, live):
    ((pose, handle),) = live._poses
    before, q_before, picture = np.array(handle.position), live.solution.qs[-1], page.picture()
    arrows = [axis for axis, moves in zip(directions(handle), pose.axes, strict=True) if moves]
    arrow = max(arrows, key=lambda axis: np.linalg.norm(pixel(live, before + axis) - pixel(live, before)))
    grip = before + GRIP * handle.scale * arrow
    aim = grip - 0.25 * arrow
    page.drag(pixel(live, grip), pixel(live, aim))
    until(lambda: not live._is_dragged and np.linalg.norm(handle.position - before) > 0.15)
    assert live.wait_until_idle(WAIT)
    moved = np.array(handle.position) - before
    assert moved @ arrow == pytest.approx(-0.25, abs=0.05)  # the hand has pixels
    assert np.linalg.norm(moved - (moved @ arrow) * arrow) < 1e-6
    assert live.answer.is_good
    end = live.solution.qs[-1]
    tip = live.problem.robot.frame_placement("tip", end).translation
    assert np.allclose(live._scene.turn @ tip, handle.position, atol=1e-6)
    assert np.abs(end - q_before).max() > 0.1
    until(lambda: live._time >= live.solution.duration)
    time.sleep(STILL)
    assert (np.abs(page.picture() - picture).max(axis=2) > 60.0)[160:, : SIZE[0] - 360].sum() > 500
    assert f"cost {live.solution.cost:.5g}" in page.value("document.body.innerText")
    assert not page.errors()

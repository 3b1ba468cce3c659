"""The page in a real browser, headless. Slow: run with `-m slow`; it needs Chromium."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mbocp.robot import Robot, load_robot
from mbocp.view import movie
from mbocp.view.replay import write_replay
from tests.view.devtools import WAIT, OpenPage

SIZE = (900, 600)
NARROW = (400, 800)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(movie.find_browser() is None, reason="no Chromium"),
]


def browse(page, *extra: str, time: float | None = None) -> str:
    address = page.as_uri() + ("" if time is None else f"#t={time}")
    return movie.browse(address, page.parent / "profile", *extra, size=SIZE).stdout


def picture(page, time: float) -> np.ndarray:
    file = page.with_name(f"{time}.png")
    browse(page, f"--screenshot={file}", time=time)
    return np.asarray(Image.open(file).convert("RGB"), dtype=float)


def page_of(name: str, folder: Path) -> tuple[Path, Robot]:
    robot = load_robot(name)
    t = np.linspace(0.0, 2.0, 41)
    step = 0.025 * np.resize([1.0, -1.2, 0.8, 0.9, -0.5], robot.nv)
    qs = np.array([robot.integrate(robot.q0, k * step) for k in range(41)])
    return write_replay(robot, t, qs, folder / "page.html"), robot


@pytest.fixture(scope="module", params=["ur5", "kinova", "iris", "elastic_pendulum"])
def page(request, tmp_path_factory):
    return page_of(request.param, tmp_path_factory.mktemp(request.param))


def test_page_opens_with_all_meshes(page):
    path, robot = page
    document = browse(path, "--dump-dom")
    assert 'data-state="ready"' in document
    assert 'data-problems="0"' in document
    drawn = int(document.split('data-meshes="')[1].split('"')[0])
    assert drawn >= len(robot.visual_model.geometryObjects)


def test_robot_is_in_the_picture_and_moves(page):
    path, _ = page
    first, last = picture(path, 0.0), picture(path, 2.0)
    empty = np.median(first[90:150], axis=(0, 1))  # sky
    # The robot is dark, bright or coloured against a pale floor; no part of it touches the picture's edge.
    for shot in (first, last):
        robot = np.abs(shot - empty).max(axis=2) > 60.0
        robot[:70, :400] = robot[:25] = robot[530:] = False  # title, controls, playback bar
        assert robot.sum() > 1000
        assert not robot[:, :3].any()
        assert not robot[:, -3:].any()
    changed = np.abs(first - last).max(axis=2) > 40.0
    assert changed[70:530].sum() > 500


def distance(page: OpenPage, size: tuple[int, int]) -> float:
    """Of the camera, once the page is loaded and the picture has the size of its pane."""
    fits = "document.body.dataset.state == 'ready' && document.querySelector('canvas').width == " + str(
        size[0]
    )
    deadline = time.monotonic() + WAIT
    while not page.value(fits):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    return page.value("viewer.camera.position.length()")


def test_a_window_of_another_shape_is_fitted_until_somebody_moves_the_camera(tmp_path):
    path, _ = page_of("ur5", tmp_path)
    with OpenPage(path.as_uri(), tmp_path / "narrow", NARROW) as narrow:
        near = distance(narrow, NARROW)
    with OpenPage(path.as_uri(), tmp_path / "wide", SIZE) as opened:
        wide = distance(opened, SIZE)
        assert wide < 0.9 * near
        opened.resize(NARROW)
        assert distance(opened, NARROW) == pytest.approx(near, rel=1e-6)
        opened.drag(np.array([200.0, 300.0]), np.array([260.0, 320.0]))
        moved = opened.value("viewer.camera.position.toArray()")
        opened.resize(SIZE)
        distance(opened, SIZE)
        np.testing.assert_allclose(opened.value("viewer.camera.position.toArray()"), moved, atol=1e-9)

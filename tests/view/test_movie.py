"""Ghosts, several motions in one picture, cameras; pictures and films of a replay."""

from __future__ import annotations

import io
import itertools
import shutil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from mbocp.exceptions import ReplayError
from mbocp.robot import Robot, load_robot
from mbocp.view import movie
from mbocp.view.camera import fit_camera
from mbocp.view.movie import Film, frame_times, write_frames, write_movie
from mbocp.view.of_solution import film_solution, replay_solution
from mbocp.view.replay import OtherMotion, write_replay
from tests.view.motions import motion
from tests.view.pages import Page, read_page

UR5 = load_robot("ur5")
T = np.linspace(1.0, 3.0, 21)  # [s]; does not begin at zero
QS = UR5.q0 + np.outer((T - 1.0) / 2.0, [0.8, -0.6, 0.5, 0.4, -0.3, 0.2])


def page(folder: Path, **options) -> Page:
    return read_page(write_replay(UR5, T, QS, folder / "page.html", **options))


def joints(found: Page, root: str, robot: Robot = UR5) -> np.ndarray:
    """Placements of all joints below a node."""
    numbers = range(robot.model.njoints)
    return np.array([found.transform(f"/replay/world/{root}/joint_{joint}") for joint in numbers])


def placements(q: np.ndarray, robot: Robot = UR5) -> np.ndarray:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, q)
    return np.array([placed.homogeneous for placed in data.oMi])


def test_ghosts_stand_where_the_robot_is_then(tmp_path: Path) -> None:
    times = [1.0, 1.35, 3.0]
    found = page(tmp_path, ghosts=times)
    for k, time in enumerate(times):
        q = UR5.q0 + (time - 1.0) / 2.0 * (QS[-1] - QS[0])
        np.testing.assert_allclose(joints(found, f"ghost_{k}"), placements(q), atol=1e-9)
    materials = [
        material
        for path, drawn in found.objects("/replay/world/ghost_").items()
        for material in drawn["materials"]
    ]
    assert materials
    assert all(material["transparent"] and material["opacity"] < 0.5 for material in materials)


@pytest.mark.parametrize("time", [0.9, 3.1, float("nan")])
def test_ghosts_at_other_times_are_refused(time: float, tmp_path: Path) -> None:
    with pytest.raises(ReplayError, match="expected times from 1 to 3 s"):
        page(tmp_path, ghosts=[time])


def test_another_motion_moves_beside_the_first(tmp_path: Path) -> None:
    later = OtherMotion(UR5, [0.0, 4.0], [UR5.q0, UR5.q0 + 1.0], "slow <one>")
    found = page(tmp_path, others=[later])
    assert "orange: slow &lt;one&gt;, 4 s" in found.text
    assert found.scene["duration"] == 4.0
    times, quaternions = found.tracks()["/replay/world/other_0/joint_1", "quaternion"]
    assert times[-1] == pytest.approx(4.0)
    angle = 2 * np.arctan2(quaternions[:, 2], quaternions[:, 3])  # the first joint of a UR5 turns about z
    np.testing.assert_allclose(np.unwrap(angle) - angle[0], times / 4.0, atol=1e-6)
    colours = {m["color"] for o in found.objects("/replay/world/other_0").values() for m in o["materials"]}
    assert len(colours) == 1


def test_more_motions_than_colours_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ReplayError, match="got 6 motions, expected at most 5"):
        page(tmp_path, others=[OtherMotion(UR5, T, QS, "x")] * 5)


@given(st.floats(-360.0, 360.0), st.floats(-89.0, 89.0))
def test_the_camera_looks_from_where_it_is_asked_to(azimuth: float, elevation: float) -> None:
    points = np.random.default_rng(1).standard_normal((50, 3))
    direction = np.deg2rad([azimuth, elevation])
    camera = fit_camera(points, points, (direction[0], direction[1]))
    x, y, z = camera.offset / np.linalg.norm(camera.offset)
    assert np.isclose(np.arcsin(z), direction[1], atol=1e-9)
    assert np.isclose(np.cos(np.arctan2(y, x) - direction[0]), 1.0)


def test_cameras_from_above_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ReplayError, match="expected an elevation from -89 to 89"):
        page(tmp_path, direction=(0.0, 90.0))


@given(st.floats(0.0, 20.0), st.floats(1.0, 60.0), st.floats(0.1, 4.0))
def test_pictures_are_evenly_spread_and_end_with_the_motion(
    duration: float, rate: float, speed: float
) -> None:
    try:
        times = frame_times(duration, Film(rate, speed))
    except ReplayError:
        assert duration / speed * rate > 2990
        return
    assert times[0] == 0.0
    assert times[-1] == pytest.approx(duration, abs=1e-6)
    np.testing.assert_allclose(np.diff(times)[:-1], speed / rate)
    assert all(step <= speed / rate * (1 + 1e-9) for step in np.diff(times))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"speed": 0.0}, "speed: got 0.0"),
        ({"frames_per_second": float("inf")}, "frames_per_second: got inf"),
        ({"size": (641, 400)}, "size: got 641x400, expected even numbers"),
    ],
)
def test_films_that_cannot_be(options: dict, words: str) -> None:
    with pytest.raises(ReplayError, match=words):
        Film(**options)


def coloured(number: int) -> bytes:
    """A white column on a grey ground, which stands elsewhere for each number."""
    content = io.BytesIO()
    image = Image.new("RGB", (64, 64), (90, 90, 90))
    image.paste((255, 255, 255), (4 * number, 0, 4 * number + 4, 64))
    image.save(content, "PNG")
    return content.getvalue()


def test_a_gif_lasts_as_long_as_the_motion(tmp_path: Path) -> None:
    path = write_movie([coloured(k) for k in range(11)], tmp_path / "film.gif", 30.0)
    with Image.open(path) as film:
        assert film.n_frames == 11
        lasts = []
        for k in range(11):
            film.seek(k)
            lasts.append(film.info["duration"])
    assert sum(lasts) == pytest.approx(1000 * 11 / 30, abs=10)  # [ms]


def test_what_is_missing_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(ReplayError, match="no ffmpeg on the PATH"):
        write_movie([coloured(1)], tmp_path / "film.mp4", 25.0)
    with pytest.raises(ReplayError, match=r"no browser on the PATH .*apt install chromium"):
        film_solution(motion(UR5, UR5.q0 + 0.5), robot=UR5, movie=tmp_path / "film.gif")
    with pytest.raises(ReplayError, match=r"ends in \.gif or \.mp4, got \.avi"):
        write_movie([coloured(1)], tmp_path / "film.avi", 25.0)
    assert not list(tmp_path.iterdir())


def test_pictures_of_another_film_stay(tmp_path: Path) -> None:
    write_frames([coloured(1), coloured(2)], tmp_path / "film")
    with pytest.raises(ReplayError, match="has pictures of a film"):
        write_frames([coloured(3)], tmp_path / "film")
    assert [path.name for path in sorted((tmp_path / "film").iterdir())] == ["00000.png", "00001.png"]


def test_so_many_ghosts_are_spread_over_the_motion(tmp_path: Path) -> None:
    robot = load_robot("double_pendulum")
    solution = motion(robot, robot.q0 + 0.5)
    for count, expected in ((0, []), (1, [20]), (3, [0, 10, 20])):
        found = read_page(replay_solution(solution, tmp_path / f"{count}.html", robot=robot, ghosts=count))
        for k, node in enumerate(expected):
            there = joints(found, f"ghost_{k}", robot)
            np.testing.assert_allclose(there, placements(solution.qs[node], robot), atol=1e-9)
            assert found.objects(f"/replay/world/ghost_{k}")
        assert not found.objects(f"/replay/world/ghost_{len(expected)}")


@pytest.mark.slow
@pytest.mark.skipif(movie.find_browser() is None, reason="no Chromium")
def test_the_browser_draws_each_picture(tmp_path: Path) -> None:
    solution = motion(UR5, UR5.q0 + 0.9)
    film = Film(frames_per_second=2.0, size=(320, 240))
    film_solution(solution, robot=UR5, frames=tmp_path / "film", movie=tmp_path / "film.gif", film=film)
    expected = len(frame_times(float(solution.t[-1] - solution.t[0]), film))
    pictures = [
        np.asarray(Image.open(p).convert("RGB"), dtype=float) for p in sorted((tmp_path / "film").iterdir())
    ]
    assert len(pictures) == expected
    assert all(picture.shape == (240, 320, 3) for picture in pictures)
    for before, after in itertools.pairwise(pictures):
        assert (np.abs(before - after).max(axis=2) > 40.0).sum() > 50  # it moves
    if shutil.which("ffmpeg"):
        film_solution(solution, robot=UR5, movie=tmp_path / "film.mp4", film=film)
        assert (tmp_path / "film.mp4").read_bytes()[4:8] == b"ftyp"

"""The live page, driven as a browser drives it: messages of its handles through a websocket."""

from __future__ import annotations

import time
import urllib.request
from collections import deque
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest

from mbocp.exceptions import ReplayError
from mbocp.problem import Problem
from mbocp.robot import load_robot
from mbocp.view.live import live_scene
from mbocp.view.live.server import is_own_page
from tests.view.pages import angles, write_arm

viser = pytest.importorskip("viser", reason="viser is not installed: pip install 'mbocp[live]'")
msgspec = pytest.importorskip("msgspec")
websockets = pytest.importorskip("websockets.sync.client")

from websockets.exceptions import ConnectionClosed, InvalidStatus  # noqa: E402

import mbocp  # noqa: E402
from mbocp.interactive import Live, Wish  # noqa: E402
from mbocp.interactive.handles import joint_handles, pose_handles  # noqa: E402
from mbocp.interactive.resolver import change_problem, weight_keys  # noqa: E402
from mbocp.solution import Status  # noqa: E402

START = angles(0.3, 0.4)
BOX = '<origin xyz="0 0 0.5"/><geometry><box size="0.1 0.1 1"/></geometry>'
WAIT = 60.0  # [s]


def problem_of(arm, goal, **more) -> Problem:
    cost = {"effort": 1.0, "velocity": 0.5}
    return Problem.create(arm, 1.0, 20, start={"q": START}, goal={"v": 0, **goal}, cost=cost, **more)


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return load_robot(write_arm(tmp_path_factory.mktemp("arm"), upper=BOX, base=BOX))


@pytest.fixture(scope="module")
def at_frame(arm):
    return problem_of(arm, {"frame": {"name": "tip", "x": 0.7, "z": 1.2}})


@pytest.fixture(scope="module")
def in_joints(arm):
    return problem_of(arm, {"q": angles(0.8, -0.4)})


@pytest.fixture
def page(at_frame):
    with Live(at_frame, mbocp.solve(at_frame), port=18080) as opened:
        yield opened


@pytest.fixture
def page_in_joints(in_joints):
    with Live(in_joints, mbocp.solve(in_joints), port=18080) as opened:
        yield opened


class Browser:
    """What a browser sends."""

    def __init__(self, page: Live) -> None:
        address = page.url.replace("http", "ws", 1)
        protocol = f"viser-v{viser.__version__}"
        self._socket = websockets.connect(address, subprotocols=[protocol], max_size=None)
        camera = {
            "wxyz": (1, 0, 0, 0),
            "position": (3, 3, 3),
            "look_at": (0, 0, 0),
            "up_direction": (0, 0, 1),
        }
        size = {"image_height": 100, "image_width": 100, "fov": 1.0, "near": 0.1, "far": 100.0}
        self.send("ViewerCameraMessage", **camera, **size)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._socket.close()

    def send(self, kind: str, **fields) -> None:
        self._socket.send(msgspec.msgpack.encode({"type": kind, **fields}))

    def drag(self, page: Live, *points) -> None:
        ((_, handle),) = page._poses
        name, turn = handle.name, tuple(float(x) for x in handle.wxyz)
        self.send("TransformControlsDragStartMessage", name=name)
        for point in points:
            position = tuple(float(x) for x in point)
            self.send("TransformControlsUpdateMessage", name=name, wxyz=turn, position=position)
        self.send("TransformControlsDragEndMessage", name=name)

    def slide(self, slider, value: float) -> None:
        self.send("GuiUpdateMessage", uuid=slider._impl.uuid, updates={"value": value})


def until(is_so: Callable[[], bool]) -> None:
    end = time.monotonic() + WAIT
    while not is_so():
        assert time.monotonic() < end, "nothing happened"
        time.sleep(0.02)


def tip(page: Live, q) -> np.ndarray:
    return np.array(page.problem.robot.frame_placement("tip", q).translation)


def test_dragging_the_goal_solves_again_and_moves_the_robot(page):
    (_, handle), before = page._poses[0], page.solution
    goal = np.array(handle.position) + np.array([-0.2, 0.0, 0.15])
    with Browser(page) as browser:
        browser.drag(page, 0.5 * (goal + handle.position), goal)
        until(lambda: np.allclose(tip(page, page.solution.qs[-1]), goal, atol=1e-6))
    assert page.answer.is_good
    assert page.solution.cost != before.cost
    q = page.solution.qs[-1]
    page.wait_until_idle(WAIT)
    until(lambda: page._time >= page.solution.duration)
    joint = page._scene._node("/replay/world/robot/elbow")
    placed = page.problem.robot.frame_placement("lower", q)
    assert np.allclose(joint.position, placed.translation, atol=1e-6)
    assert np.allclose(handle.position, goal, atol=1e-6)


def test_a_goal_out_of_reach_is_told_and_the_motion_stays(page):
    before = page.solution
    with Browser(page) as browser:
        browser.drag(page, [9.0, 0.0, 1.0])
        until(lambda: page.answer.solution is None)
        until(lambda: "out of reach" in page._status.content)
    assert "not solved" in page._status.content
    assert page.solution is before


def test_weights_and_duration(page):
    keys, slider = weight_keys(page.problem), page._weights[0]
    assert keys == ["effort", "velocity"]
    with Browser(page) as browser:
        browser.slide(slider, 1.0)
        until(lambda: float(page.problem.cost.effort[0]) == pytest.approx(10.0))
        browser.slide(page._length, 2.0)
        until(lambda: page.solution.duration == pytest.approx(2.0))
        until(lambda: page._clock.max == pytest.approx(2.0))
        until(lambda: f"cost {page.solution.cost:.5g}" in page._status.content)
    assert page.problem.cost.effort[0] == pytest.approx(10.0)


def test_a_joint_of_the_goal(page_in_joints):
    page = page_in_joints
    with Browser(page) as browser:
        browser.slide(page._values[1], 0.9)
        until(lambda: np.allclose(page.solution.qs[-1], angles(0.8, 0.9), atol=1e-6))
    page.ask(Wish())
    assert page.wait_until_idle(WAIT)
    assert np.allclose(page.solution.qs[-1], angles(0.8, -0.4), atol=1e-6)


def test_a_result_of_the_page_holds_the_problem_as_asked(page, at_frame, tmp_path):
    assert at_frame.solver.time_limit is None
    page.ask(Wish(duration=1.5))
    assert page.wait_until_idle(WAIT)
    again = mbocp.Solution.load(page.solution.save(tmp_path / "page.h5")).load_problem()
    assert again.duration == pytest.approx(1.5)
    assert again.solver == at_frame.solver
    assert page.problem.solver == at_frame.solver


def test_solves_of_the_page_end_in_time(at_frame):
    with Live(at_frame, mbocp.solve(at_frame), port=18080, time_limit=1e-9) as page:
        page.ask(Wish(duration=1.5))
        assert page.wait_until_idle(WAIT)
        assert page.answer.solution.status is Status.TIME_LIMIT


def test_play_and_scrub(page):
    with Browser(page) as browser:
        until(lambda: page._time > 0.0)
        with page._lock:  # a frame that waits for it comes before what the hand has asked for
            browser.slide(page._clock, 0.5)
            until(lambda: page._clock.value == 0.5)
        until(lambda: not page._plays.value)
        until(lambda: page._time == pytest.approx(0.5))


def test_not_converged_is_said(page, at_frame):
    short = at_frame.with_(
        duration=0.02, limits={"velocity": [[-0.5, 0.5]] * 2}, solver={"max_iterations": 5}
    )
    with Live(short, mbocp.solve(short), port=18080) as other:
        assert "not converged" in other._status.content
        assert other.answer.words in other._status.content


def test_notebooks_show_the_page(page):
    assert f'<iframe src="{page.url}"' in page._repr_html_()


def test_errors_in_the_thread_are_raised(page, monkeypatch):
    monkeypatch.setattr("mbocp.interactive.resolver.change_problem", lambda *_: 1 / 0)
    page.ask(Wish())
    with pytest.raises(ZeroDivisionError):
        page.wait_until_closed()


def test_handles_of_goals(at_frame, in_joints):
    (handle,) = pose_handles(at_frame)
    assert (handle.axes, handle.slides, handle.turns) == ((True, False, True), True, False)
    assert [joint.name for joint in joint_handles(in_joints)] == ["shoulder", "elbow"]
    assert not pose_handles(in_joints)  # a planar arm brings its tip to no pose in space
    assert not joint_handles(at_frame)


def test_bodies_that_fly_are_dragged():
    goal = {"q": [0.5, 0, 1, 0, 0, 0, 1], "v": 0}
    problem = Problem.create(
        {"name": "iris", "actuated": ["root_joint"]}, 1.0, 10, start={"q": [0, 0, 1, 0, 0, 0, 1]}, goal=goal
    )
    (handle,) = pose_handles(problem)
    placed = handle.placement(problem.goal, problem.goal.q)
    placed.translation = placed.translation + np.array([0.0, 0.25, 0.0])
    changed = change_problem(problem, handle.move(Wish(), placed, problem.goal.q), problem.goal.q)
    assert np.allclose(changed.goal.q, [0.5, 0.25, 1, 0, 0, 0, 1])


def test_a_tool_is_dragged_where_the_goal_is_in_joints():
    q = [0.5, -1.2, 1.2, -1.0, -1.0, 0.2]
    problem = Problem.create(
        "ur5", 1.0, 10, start={"q": [0, -1.57, 1.57, -1.57, -1.57, 0]}, goal={"q": q, "v": 0}
    )
    (handle,) = pose_handles(problem)
    placed = handle.placement(problem.goal, problem.goal.q)
    placed.translation = placed.translation + np.array([0.05, 0.0, -0.05])
    changed = change_problem(problem, handle.move(Wish(), placed, problem.goal.q), problem.goal.q)
    assert changed.robot.frame_placement("tool0", changed.goal.q).isApprox(placed, 1e-6)
    assert np.abs(changed.goal.q - q).max() < 0.5  # the branch near by


def test_without_viser_it_is_refused_by_name(monkeypatch, at_frame):
    monkeypatch.setitem(__import__("sys").modules, "viser", None)
    with pytest.raises(ReplayError, match=r"pip install 'mbocp\[live\]'"):
        live_scene.viser_module()
    with pytest.raises(ReplayError, match=r"pip install 'mbocp\[live\]'"):
        mbocp.live(at_frame)


def test_drawn_triangles_are_those_of_the_shapes():
    from mbocp.view.live.live_scene import triangles_of
    from mbocp.view.meshcat.commands import mg, shape_object

    sizes = {"box": (1.0, 2.0, 3.0), "ball": (1.0, 1.0, 1.0), "cylinder": (1.0, 2.0, 1.0)}
    drawn = {"box": mg.Box([1, 2, 3]), "ball": mg.Sphere(0.5), "cylinder": mg.Cylinder(2.0, 0.5)}
    for name, shape in drawn.items():
        (piece,) = triangles_of(shape_object(shape, mg.MeshPhongMaterial(color=0xFF8000, opacity=0.5)))
        assert np.ptp(piece.vertices, axis=0) == pytest.approx(sizes[name], rel=0.05)
        assert piece.colours == pytest.approx([1.0, 128 / 255, 0.0])
        assert piece.opacity == 0.5
        a, b, c = (piece.vertices[piece.faces[:, k]] for k in range(3))
        assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0.0  # faces look outwards


@pytest.mark.parametrize(
    ("asked", "origin", "is_own"),
    [
        ("127.0.0.1:8080", None, True),  # no browser
        ("127.0.0.1:8080", "http://127.0.0.1:8080", True),
        ("localhost:9999", "http://localhost:9999", True),  # through a tunnel
        ("[::1]:8080", "http://[::1]:8080", True),
        ("robots.example:8080", "http://robots.example:8080", True),  # as --host says
        ("127.0.0.1:8080", "http://evil.example", False),
        ("127.0.0.1:8080", "http://127.0.0.1:80", False),
        ("127.0.0.1:8080", "null", False),
        ("127.0.0.1:8080", "", False),
        ("evil.example:8080", "http://evil.example:8080", False),  # a name that was made to stand for us
        ("evil.example:8080", None, False),
        ("[:8080", None, False),
        ("", None, False),
    ],
)
def test_own_pages(asked, origin, is_own):
    assert is_own_page(asked, origin, "robots.example") == is_own


def test_other_pages_are_refused(page):
    address, protocols = page.url.replace("http", "ws", 1), [f"viser-v{viser.__version__}"]
    for origin in ("http://evil.example", "null"):
        with pytest.raises(InvalidStatus, match="403"):
            websockets.connect(address, subprotocols=protocols, origin=origin)
    with websockets.connect(address, subprotocols=protocols, origin=page.url, max_size=None) as own:
        assert own.recv(timeout=WAIT)


@pytest.mark.parametrize("encoding", ["gzip", "identity"])
def test_the_page_looks_at_the_colours_that_the_browser_prefers(page, encoding):
    request = urllib.request.Request(page.url, headers={"Accept-Encoding": encoding})
    with urllib.request.urlopen(request, timeout=WAIT) as answer:
        text, length = answer.read(), int(answer.headers["Content-Length"])
    assert len(text) == length
    assert text.index(b"prefers-color-scheme: dark") < text.index(b"</script>")
    assert text.rstrip().endswith(b"</html>")


def test_garbled_frames_end_their_connection_without_a_word(page, capfd):
    address, protocols = page.url.replace("http", "ws", 1), [f"viser-v{viser.__version__}"]
    for frame in (b"\xff\xff\xff", b"", "text", b"\x93\x01", b"\x81\xa4type\xa5nosuc"):
        with websockets.connect(address, subprotocols=protocols, max_size=None) as socket:
            socket.send(frame)
            with pytest.raises(ConnectionClosed):
                deque(iter(partial(socket.recv, timeout=WAIT), None))
    with Browser(page):
        pass
    assert capfd.readouterr() == ("", "")

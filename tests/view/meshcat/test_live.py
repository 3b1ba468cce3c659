from __future__ import annotations

import asyncio
import os
import signal
import threading
import time

import numpy as np
import pytest

from mbocp.exceptions import ReplayError
from mbocp.robot import load_robot
from mbocp.view import replay
from mbocp.view.live_robot import LiveReplay
from mbocp.view.meshcat.commands import meshcat, mg

umsgpack = mg.umsgpack


def listen(url: str, received: list[dict], done: threading.Event) -> None:
    """A stand-in for the browser: connects and collects messages until the animation has come."""
    from tornado.websocket import websocket_connect

    async def run() -> None:
        connection = await websocket_connect(url.replace("http:", "ws:").replace("static/", ""))
        while not received or received[-1]["type"] != "set_animation":
            message = await asyncio.wait_for(connection.read_message(), 20.0)
            received.append(umsgpack.unpackb(message, ext_handlers={}))
        connection.close()

    asyncio.run(run())
    done.set()


@pytest.fixture
def scene():
    robot = load_robot("cart_pendulum_elastic")
    motion = replay._motion(robot, [0.0, 1.0], [robot.q0, robot.q0 + 0.3], 2.0, 60.0)
    return replay.build_scene(robot, motion, speed=2.0)


def test_scene_is_sent_once_a_browser_has_come(scene):
    received, done = [], threading.Event()
    with LiveReplay() as live:
        process = live._viewer.window.server_proc
        assert live.url.startswith("http://127.0.0.1:")
        with pytest.raises(
            ReplayError, match=r"no browser opened http://127\.0\.0\.1:\d+/static/ within 0\.2 s"
        ):
            live.wait_for_browser(timeout=0.2)
    assert process.poll() is not None

    with LiveReplay() as live:
        threading.Thread(target=listen, args=(live.url, received, done), daemon=True).start()
        live.wait_for_browser(timeout=20.0)
        live.send(scene)
        assert done.wait(20.0)
    assert len(received) == len(scene.commands) + 1
    track = received[-1]["animations"][0]["clip"]["tracks"][0]
    assert track["times"][-1] == pytest.approx(0.5)  # twice true speed


def test_terminating_a_live_replay_stops_its_server(scene, monkeypatch, capsys):
    started: list[LiveReplay] = []

    class Recorded(LiveReplay):
        def __init__(self) -> None:
            super().__init__()
            started.append(self)

        def wait_for_browser(self, timeout: float | None = None) -> None:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5.0)

    monkeypatch.setattr(replay, "LiveReplay", Recorded)
    replay.serve(scene, title="cart", browser=False)
    assert started[0]._viewer.window.server_proc.poll() is not None
    said = capsys.readouterr().out
    assert "cart: open http://127.0.0.1:" in said
    assert "Replay closed." in said
    assert signal.getsignal(signal.SIGTERM) == signal.SIG_DFL


def test_a_server_that_does_not_start_is_an_error(monkeypatch):
    def refuse(*_, **__):
        raise RuntimeError("the meshcat server process exited prematurely with exit code 1")

    monkeypatch.setattr(meshcat, "Visualizer", refuse)
    with pytest.raises(ReplayError, match="cannot be served: the meshcat server process exited"):
        LiveReplay()


def test_commands_are_plain_messages(scene):
    for command in (*scene.commands, scene.animation):
        assert umsgpack.packb(command.lower())
    assert np.isfinite(scene.camera.far)

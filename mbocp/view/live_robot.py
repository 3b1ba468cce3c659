"""A page that is served, and on it a robot while something else moves it, as in a control loop."""

from __future__ import annotations

import contextlib
import io
import webbrowser

import numpy as np
import pinocchio as pin
import zmq
from numpy.typing import ArrayLike

from mbocp.exceptions import ReplayError
from mbocp.robot import Robot
from mbocp.view.meshcat.commands import Command, meshcat, set_transform
from mbocp.view.meshcat.scene import Scene, build_scene, joint_node
from mbocp.view.motion_samples import sample_motion


class LiveRobot:
    """A page that shows one pose of a robot after the other; use it in a `with` block.

    Parameters
    ----------
    robot : Robot
    q : array_like, shape (nq,)
        The first configuration [m, rad, unit quaternion xyzw].
    timeout : float, optional
        Longest wait for a browser [s]; without one it waits for ever.

    Raises
    ------
    ReplayError
        If the page cannot be served, or no browser came in time.
    """

    def __init__(self, robot: Robot, q: ArrayLike, *, timeout: float | None = None) -> None:
        self._model, self._data = robot.model, robot.model.createData()
        self._motion = sample_motion(robot.model, [0.0], np.asarray(q)[None])
        self._live = LiveReplay()
        print(f"{robot.name}: open {self._live.url} in a browser", flush=True)
        try:
            self._live.open_browser()
            self._live.wait_for_browser(timeout)
            self._live.send(build_scene(robot, self._motion, trace=()))
        except BaseException:
            self._live.close()
            raise

    def __enter__(self) -> LiveRobot:
        return self

    def __exit__(self, *_: object) -> None:
        self._live.close()

    def show(self, q: ArrayLike) -> None:
        """Show another configuration, shape (nq,)."""
        pin.forwardKinematics(self._model, self._data, np.asarray(q))
        for joint in range(1, self._model.njoints):
            placed = self._data.oMi[joint]
            self._live.send_command(
                set_transform(joint_node(self._motion, joint), placed.rotation, placed.translation)
            )


class LiveReplay:
    """meshcat's server as a child process on the loopback interface; use it in a `with` block."""

    def __init__(self) -> None:
        self._viewer = _start()

    def __enter__(self) -> LiveReplay:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """Address of the page."""
        return str(self._viewer.url())

    def open_browser(self) -> bool:
        """Open the page in the user's browser; False if there is none."""
        with contextlib.suppress(webbrowser.Error):
            return webbrowser.open(self.url, new=2)
        return False

    def wait_for_browser(self, timeout: float | None = None) -> None:
        """Block until a browser has connected.

        Parameters
        ----------
        timeout : float, optional
            Longest wait [s]; without one it waits for ever.

        Raises
        ------
        ReplayError
            If no browser came in time.
        """
        socket = self._viewer.window.zmq_socket
        socket.setsockopt(zmq.RCVTIMEO, -1 if timeout is None else int(1000 * timeout))
        try:
            self._viewer.wait()
        except zmq.Again as error:
            raise ReplayError(f"no browser opened {self.url} within {timeout:g} s") from error
        finally:
            socket.setsockopt(zmq.RCVTIMEO, -1)

    def send(self, scene: Scene) -> None:
        """Send a scene; the server keeps it for pages that are loaded later."""
        for command in (*scene.commands, *([scene.animation] if scene.animation else [])):
            self.send_command(command)

    def send_command(self, command: Command) -> None:
        """Send one command."""
        self._viewer.window.send(command)

    def wait_until_closed(self) -> None:
        """Block until the server ends, which it does on its own only in case of trouble."""
        self._viewer.window.server_proc.wait()

    def close(self) -> None:
        """Stop the server."""
        window = self._viewer.window
        window.zmq_socket.close(linger=0)
        window.server_proc.kill()
        window.server_proc.wait()
        for pipe in (window.server_proc.stdout, window.server_proc.stderr):
            pipe.close()


def _start() -> meshcat.Visualizer:
    with contextlib.redirect_stdout(io.StringIO()):  # it announces itself on stdout
        try:
            return meshcat.Visualizer()
        except (OSError, RuntimeError, ValueError, zmq.ZMQError) as error:
            raise ReplayError(f"the live page cannot be served: {error}; write a file instead") from error

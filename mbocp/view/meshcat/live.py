"""A live meshcat page: the server, the browser, and the wait until the one has the other."""

from __future__ import annotations

import contextlib
import io
import webbrowser

import zmq

from mbocp.exceptions import ReplayError
from mbocp.view.meshcat.commands import Command
from mbocp.view.meshcat.scene import Scene
from mbocp.view.meshcat.viewer import meshcat


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

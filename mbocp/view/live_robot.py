"""A robot in a browser while something else moves it, as in a control loop."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from mbocp.robot import Robot
from mbocp.view.meshcat.commands import set_transform
from mbocp.view.meshcat.live import LiveReplay
from mbocp.view.meshcat.scene import build_scene, joint_node
from mbocp.view.motion import sample_motion


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

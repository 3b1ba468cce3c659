"""The scene of a replay in viser: drawn once, then moved, and given other motions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp._warn import warn_caller
from mbocp.exceptions import ReplayError
from mbocp.robot import FrameTarget, Robot
from mbocp.view.live.triangles import Triangles, triangles_of
from mbocp.view.marks import Marks
from mbocp.view.meshcat.commands import Command
from mbocp.view.meshcat.scene import WORLD, build_scene, joint_node, motion_commands
from mbocp.view.meshcat.shapes import nice_length
from mbocp.view.meshcat.surroundings import BACKGROUND, FLOOR, LINE
from mbocp.view.motion import Motion

ACCENT = (47, 111, 171)  # of sliders and buttons, as in meshcat/page.html
_MOVES = ("position", "quaternion", "scale")
_GRID = 40.0  # side of the floor in sizes of the scene
_BACK, _ASIDE = 1.3, 0.1  # by which the camera steps back and aside, for the panel of the page
_FADE = 8.0  # where it ends, in the same


def viser_module() -> Any:
    """Viser, imported.

    Raises
    ------
    ReplayError
        If it is not installed.
    """
    try:
        import viser
    except ImportError as error:
        raise ReplayError(
            f"live view: viser cannot be imported ({error}): pip install 'mbocp[live]'"
        ) from error
    return viser


class LiveScene:
    """A robot, what is around it, and the motion that it shows.

    Parameters
    ----------
    server : viser.ViserServer
    robot : Robot
    motion : Motion
        The first motion.
    goals : sequence of FrameTarget
        Poses of frames whose axes are drawn.
    marks : Marks, optional
        Via points, lines and obstacles.

    Attributes
    ----------
    size : float
        Extent of the scene [m].
    turn : ndarray, shape (3, 3)
        Rotation from the world of the robot to that of the picture, where z is up.
    """

    def __init__(
        self,
        server: Any,
        robot: Robot,
        motion: Motion,
        *,
        goals: Sequence[FrameTarget] = (),
        marks: Marks | None = None,
    ) -> None:
        scene = build_scene(robot, motion, trace=(), goals=goals, marks=marks)
        self._server, self._robot = server, robot
        self._frames = [robot.frame_id(name) for name in robot.trace_frames]
        self._nodes: dict[str, Any] = {}
        self._drawn: dict[str, list[Any]] = {}
        self.size = scene.size
        self._set_stage(scene.camera.target, scene.camera.offset, scene.camera.field_of_view, scene.floor)
        self._draw(command for command in scene.commands if command.message["path"].startswith(WORLD))
        self.show(motion)

    @property
    def turn(self) -> Array:
        """Rotation of the robot's world, shape (3, 3)."""
        w, x, y, z = self._nodes[WORLD].wxyz
        return np.array(pin.Quaternion(w, x, y, z).matrix())

    def show(self, motion: Motion) -> None:
        """Show another motion, at its start."""
        commands, self._tracks = motion_commands(self._robot, motion, self._frames, self.size)
        self.motion = motion
        with self._server.atomic():
            self._draw(commands)
            self.move_to(0.0)

    def move_to(self, time: float) -> None:
        """Show the pose at a time [s] since the motion's start."""
        motion = self.motion
        at = int(np.argmin(np.abs(motion.times - time)))
        with self._server.atomic():
            for joint in range(1, motion.model.njoints):
                node = self._node(joint_node(motion, joint))
                node.position = motion.positions[at, joint]
                node.wxyz = np.roll(motion.quaternions[at, joint], 1)
            for track in self._tracks:
                self._set(track.path, track.name, track.values[at])

    def _set_stage(self, target: Array, offset: Array, field_of_view: float, floor: float) -> None:
        server, cell = self._server, nice_length(self.size / 5.0)
        server.scene.set_up_direction("+z")
        server.scene.set_background_image(
            np.full((2, 2, 3), _colour(BACKGROUND), dtype=np.uint8), format="png"
        )
        server.scene.add_grid(
            "/floor",
            width=_GRID * self.size,
            height=_GRID * self.size,
            cell_size=cell,
            section_size=5.0 * cell,
            cell_color=_colour(LINE),
            section_color=_colour(LINE),
            plane_color=_colour(FLOOR),
            plane_opacity=1.0,
            position=(0.0, 0.0, floor - 1e-3 * self.size),
            fade_distance=_FADE * self.size,
        )
        camera = server.initial_camera
        right = np.cross([0.0, 0.0, 1.0], offset)
        seen = target + _ASIDE * right / np.linalg.norm(right) * np.linalg.norm(offset)
        camera.look_at, camera.position = seen, seen + _BACK * offset
        camera.fov = float(np.deg2rad(field_of_view))
        camera.near, camera.far = 1e-2 * self.size, 1e2 * self.size

    def _draw(self, commands: Iterable[Command]) -> None:
        for command in commands:
            message = command.message
            path = message["path"]
            if message["type"] == "set_object":
                self._draw_object(path, message["object"])
            elif message["type"] == "set_transform":
                matrix = np.reshape(message["matrix"], (4, 4)).T
                node = self._node(path)
                node.position = matrix[:3, 3]
                node.wxyz = np.roll(pin.Quaternion(matrix[:3, :3]).coeffs(), 1)
            elif message["type"] == "set_property":
                self._set(path, message["property"], message["value"])

    def _set(self, path: str, name: str, value: Any) -> None:
        if name not in _MOVES:
            return
        numbers = tuple(float(x) for x in value)
        node = self._node(path)
        if name == "quaternion":
            node.wxyz = np.roll(numbers, 1)
        else:
            setattr(node, name, numbers)

    def _node(self, path: str) -> Any:
        """The frame of a node."""
        if path not in self._nodes:
            self._nodes[path] = self._server.scene.add_frame(path, show_axes=False)
        return self._nodes[path]

    def _draw_object(self, path: str, drawn: dict[str, Any]) -> None:
        self._node(path)
        for old in self._drawn.pop(path, ()):
            old.remove()
        try:
            pieces = list(triangles_of(drawn))
        except ReplayError as error:
            warn_caller(f"{path.removeprefix(WORLD)}: {error}")
            return
        self._drawn[path] = [
            self._draw_piece(f"{path}/piece_{number}", piece) for number, piece in enumerate(pieces)
        ]

    def _draw_piece(self, path: str, piece: Triangles) -> Any:
        vertices, faces = piece.vertices.astype(np.float32), piece.faces.astype(np.uint32)
        colours = np.round(255.0 * np.clip(piece.colours, 0.0, 1.0)).astype(np.uint8)
        if np.ptp(np.atleast_2d(colours), axis=0).any():  # a colour for each corner
            from trimesh import Trimesh

            mesh = Trimesh(vertices, faces, vertex_colors=colours, process=False)
            return self._server.scene.add_mesh_trimesh(path, mesh)
        return self._server.scene.add_mesh_simple(
            path,
            vertices,
            faces,
            color=tuple(int(c) for c in np.atleast_2d(colours)[0]),
            opacity=None if piece.opacity >= 1.0 else piece.opacity,
            side="double",
        )


def _colour(shares: Sequence[float]) -> tuple[int, int, int]:
    """A colour of the replay as viser takes it."""
    red, green, blue = (round(255.0 * share) for share in shares)
    return red, green, blue

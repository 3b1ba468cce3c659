"""The scene of a replay in viser: drawn once, then moved, and given other motions."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbocp._arrays import Array, dataclass
from mbocp._text import warn_caller
from mbocp.exceptions import ReplayError
from mbocp.robot import FrameTarget, Robot
from mbocp.view.marks import Marks
from mbocp.view.meshcat.commands import Command
from mbocp.view.meshcat.scene import WORLD, build_scene, joint_node, motion_commands
from mbocp.view.meshcat.shapes import nice_length
from mbocp.view.meshcat.surroundings import BACKGROUND, FLOOR, LINE
from mbocp.view.motion_samples import PlacementSamples

ACCENT = (47, 111, 171)  # of sliders and buttons, as in meshcat/page.html
_MOVES = ("position", "quaternion", "scale")
_GRID = 40.0  # side of the floor in sizes of the scene
_BACK, _ASIDE = 1.3, 0.1  # by which the camera steps back and aside, for the panel of the page
_FADE = 8.0  # where it ends, in the same
_TYPES = {"Float32Array": "<f4", "Uint32Array": "<u4", "Int32Array": "<i4", "Uint8Array": "u1"}
_STL_HEADER = 84  # [bytes]
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_SEGMENTS = 24  # of a round shape about its axis
_SUBDIVISIONS = 2  # of the icosahedron that stands for a ball


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
    motion : PlacementSamples
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
        motion: PlacementSamples,
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

    def show(self, motion: PlacementSamples) -> None:
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


@dataclass(frozen=True, eq=False)
class Triangles:
    """A piece of a drawn object.

    Attributes
    ----------
    vertices : ndarray, shape (K, 3)
        Corners [m].
    faces : ndarray, shape (M, 3)
        Their numbers, three a triangle.
    colours : ndarray, shape (3,) or (K, 3)
        Red, green, blue from 0 to 1.
    opacity : float
        From 0 to 1.
    """

    vertices: Array
    faces: NDArray[np.int64]
    colours: Array
    opacity: float


def triangles_of(drawn: Mapping[str, Any]) -> Iterator[Triangles]:
    """Pieces of an object, one for each of its materials.

    Parameters
    ----------
    drawn : mapping
        As a `set_object` command carries it. Pictures on surfaces are left out, in favour of their colour.

    Raises
    ------
    ReplayError
        If it is neither triangles nor a box, ball or cylinder.
    """
    node = drawn["object"]
    geometry = next(g for g in drawn["geometries"] if g["uuid"] == node["geometry"])
    vertices, faces, colours = _corners(geometry)
    matrix = np.reshape(node.get("matrix", np.eye(4).ravel()), (4, 4)).T  # column by column
    vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    used = node["material"]
    listed = used if isinstance(used, list) else [used]
    materials = [next(m for m in drawn["materials"] if m["uuid"] == uuid) for uuid in listed]
    whole = [{"start": 0, "count": 3 * len(faces), "materialIndex": 0}]
    groups = geometry["data"].get("groups", whole) if isinstance(geometry.get("data"), Mapping) else whole
    for group in groups:
        material = materials[group["materialIndex"]]
        first = group["start"] // 3
        picked = faces[first : first + group["count"] // 3]
        corners, numbers = np.unique(picked, return_inverse=True)
        yield Triangles(
            vertices[corners],
            numbers.reshape(-1, 3),
            _rgb(material["color"]) if colours is None else colours[corners],
            float(material.get("opacity", 1.0)),
        )


def _corners(geometry: Mapping[str, Any]) -> tuple[Array, NDArray[np.int64], Array | None]:
    """Vertices, faces and colours of the vertices."""
    kind = geometry["type"]
    if kind == "BufferGeometry":
        attributes = geometry["data"]["attributes"]
        faces = _array(geometry["data"]["index"]).reshape(-1, 3).astype(np.int64)
        colours = _array(attributes["color"]) if "color" in attributes else None
        return _array(attributes["position"]), faces, colours
    if kind.startswith("_meshfile") and geometry.get("format") == "stl":
        content = np.frombuffer(geometry["data"].data, dtype=np.uint8)[_STL_HEADER:]
        vertices = content.view(_STL_TRIANGLE)["corners"].reshape(-1, 3).astype(np.float64)
        return vertices, np.arange(len(vertices)).reshape(-1, 3), None
    return *_primitive(kind, geometry), None


def _primitive(kind: str, sizes: Mapping[str, Any]) -> tuple[Array, NDArray[np.int64]]:
    from trimesh import creation

    if kind == "BoxGeometry":
        mesh = creation.box([sizes["width"], sizes["height"], sizes["depth"]])
        flat = np.array(mesh.vertices)[np.array(mesh.faces).ravel()]  # no corner in common: edges are seen
        return flat, np.arange(len(flat)).reshape(-1, 3)
    if kind == "SphereGeometry":
        mesh = creation.icosphere(subdivisions=_SUBDIVISIONS, radius=sizes["radius"])
    elif kind == "CylinderGeometry" and sizes["radiusTop"] == sizes["radiusBottom"]:
        mesh = creation.cylinder(sizes["radiusTop"], sizes["height"], sections=_SEGMENTS)
        vertices = np.array(mesh.vertices)[:, [1, 2, 0]]  # along y, as three.js has it
        return vertices, np.array(mesh.faces, dtype=np.int64)
    else:
        raise ReplayError(f"live view: a {kind} cannot be drawn")
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64)


def _array(packed: Mapping[str, Any]) -> Array:
    """Numbers of an attribute, one row an item."""
    numbers = np.frombuffer(packed["array"].data, dtype=_TYPES[packed["type"]])
    return numbers.reshape(-1, packed["itemSize"]).astype(np.float64)


def _rgb(number: int) -> Array:
    return np.array([number >> 16 & 255, number >> 8 & 255, number & 255]) / 255.0

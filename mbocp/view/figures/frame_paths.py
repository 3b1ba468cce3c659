"""The path in space of chosen frames, with the robot's start and end pose drawn thinly behind it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.ticker import FixedLocator, MaxNLocator

from mbocp._arrays import Array
from mbocp.robot import Robot
from mbocp.robot.joints import joint_kind
from mbocp.robot.kinematics import frame_poses
from mbocp.robot.large import make_working_data
from mbocp.view.figures.style import GREY, finish_axes, line_style, plain_text, strip_legend

_HINGES = ("revolute", "continuous", "spherical")
_NUM_ARROWS = 7
_FLATNESS_RATIO = 0.25  # of the size: how thick a robot may be whose motion is drawn as flat
_MAX_NODES = 2000  # more points do not make a finer picture
_TICK_PADS, _LABEL_PADS = (0, 0, 3), (1, 3, 6)  # [points]; those of z stand beside their axis, not below
_SHRINK, _MAX_SHRINKS = 0.94, 8  # of a box whose labels leave the page


class FramePaths:
    """Where the frames go, and how to draw it: flat if the motion is, else in perspective.

    Parameters
    ----------
    names : sequence of str
    paths : ndarray, shape (len(names), n, 3)
        [m].
    poses : sequence of ndarray, each of shape (k, 2, 3)
        Line segments of the start and the end pose [m].
    """

    def __init__(self, names: Sequence[str], paths: Array, poses: Sequence[Array]) -> None:
        self.names, self.paths, self.poses = tuple(names), paths, tuple(poses)
        everything = np.concatenate([paths.reshape(-1, 3), *(pose.reshape(-1, 3) for pose in poses)])
        everything = everything[np.isfinite(everything).all(axis=1)]
        if not len(everything):
            everything = np.zeros((1, 3))
        self.lower, self.upper = everything.min(axis=0), everything.max(axis=0)
        extent = self.upper - self.lower
        self._size = float(max(extent.max(), 1e-9))
        # Axes to draw: all three, or those of the plane that the motion stays in, x-z before the others.
        # Links may lie in layers beside that plane.
        moved = np.ptp(paths, axis=1).max(axis=0) if paths.size else extent
        is_thin = (moved < 1e-6 * self._size) & (extent < _FLATNESS_RATIO * self._size)
        thin = [i for i in (1, 0, 2) if is_thin[i]]
        self.axes = tuple(i for i in range(3) if i not in thin[:1])

    @property
    def is_planar(self) -> bool:
        """Whether the motion stays in a plane of two axes of the world."""
        return len(self.axes) == 2

    @property
    def projection(self) -> str | None:
        """Matplotlib's name of the projection."""
        return None if self.is_planar else "3d"

    def draw(self, axes: Axes) -> None:
        """Draw into axes of the right `projection`."""
        pick = list(self.axes)
        for pose, alpha in zip(self.poses, (0.45, 0.8), strict=False):
            for segment in pose[:, :, pick]:
                axes.plot(*segment.T, color=GREY, linewidth=1.6, alpha=alpha, solid_capstyle="round")
        handles = []
        for i, path in enumerate(self.paths[:, :, pick]):
            color = line_style(i).color
            handles += axes.plot(*path.T, **line_style(i)._asdict())
            self._draw_arrows(axes, path, color)
            axes.plot(
                *path[:1].T, "o", markersize=5.5, color=color, markerfacecolor="white", markeredgewidth=1.3
            )
            axes.plot(
                *path[-1:].T, "*", markersize=9, color=color, markeredgecolor="white", markeredgewidth=0.5
            )
        names = [*self.names, "start", "end"]
        handles += [
            axes.plot([], [], "o", color=GREY, markerfacecolor="white", markersize=5.5)[0],
            axes.plot([], [], "*", color=GREY, markersize=9)[0],
        ]
        if not self.is_planar:
            self._finish_3d(axes)
        else:
            self._finish_2d(axes)
        strip_legend(axes, handles, names, per_row=3)

    def fit(self, axes: Any) -> None:
        """Shrink the box until its labels are within the axes' place; the figure has to be complete.

        Layouts know the place of axes in perspective, and not that of their labels.
        """
        if self.is_planar:
            return
        figure = axes.get_figure()
        canvas: Any = FigureCanvasAgg(figure)
        renderer = canvas.get_renderer()
        figure.get_layout_engine().execute(figure)  # alone: to draw all panels would take longer
        axes.draw(renderer)
        place, page = axes.get_window_extent(), figure.bbox
        margin = 0.02 * min(place.width, place.height)
        left, right = max(place.x0 - margin, page.x0), min(place.x1 + margin, page.x1)
        for _ in range(_MAX_SHRINKS):
            labels = [axis.get_tightbbox() for axis in (axes.xaxis, axes.yaxis, axes.zaxis)]
            found = [box for box in labels if box is not None]
            if all(box.x0 >= left and box.x1 <= right for box in found):
                return
            self._zoom *= _SHRINK
            axes.set_box_aspect(self._aspect, zoom=self._zoom)
            axes.draw(renderer)

    def _draw_arrows(self, axes: Any, path: Array, color: str) -> None:
        """Draw a few arrows along the motion, evenly spaced along the path, of one length."""
        gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        marks = np.linspace(0.0, gone[-1], _NUM_ARROWS + 2)[1:-1]
        inner = np.unique(np.searchsorted(gone, marks))
        inner = inner[(inner > 0) & (inner < len(path) - 1)]
        direction = path[inner + 1] - path[inner - 1]
        length = np.linalg.norm(direction, axis=1)
        moving = length > 1e-4 * self._size
        inner, direction = inner[moving], direction[moving] / length[moving, None]
        size = 0.08 * self._size
        if not self.is_planar:
            start = path[inner]
            axes.quiver(
                *start.T,
                *(size * direction).T,
                color=color,
                linewidth=1.1,
                arrow_length_ratio=0.45,
                pivot="middle",
            )
            return
        for p, d in zip(path[inner], direction, strict=True):
            axes.annotate(
                "", p + 0.5 * size * d, p, arrowprops={"arrowstyle": "-|>", "color": color, "lw": 0.8}
            )

    def _finish_2d(self, axes: Axes) -> None:
        x, y = ("xyz"[i] for i in self.axes)
        finish_axes(axes, title="Path in space", xlabel=f"${x}$ [m]", ylabel=f"${y}$ [m]")
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.08)

    def _finish_3d(self, axes: Any) -> None:
        axes.set_title("Path in space", loc="left")
        middle = (self.lower + self.upper) / 2
        # Equal scales; a thin box is widened, so that its ticks have room.
        half = np.maximum((self.upper - self.lower) / 2, 0.18 * self._size) * 1.05
        axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
        axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
        axes.set_zlim(middle[2] - half[2], middle[2] + half[2])
        # matplotlib clips the axis labels of a narrow cell unless the box leaves room for them.
        place = axes.get_window_extent()
        self._aspect = tuple(half / half.max())
        self._zoom = 0.88 if place.width > place.height else 0.82
        axes.set_box_aspect(self._aspect, zoom=self._zoom)
        axes.view_init(elev=22, azim=-55)
        for i, (axis, setter) in enumerate(
            ((axes.xaxis, axes.set_xlabel), (axes.yaxis, axes.set_ylabel), (axes.zaxis, axes.set_zlabel))
        ):
            setter(f"${'xyz'[i]}$ [m]", labelpad=_LABEL_PADS[i])
            ticks = MaxNLocator(3 if half[i] < 0.6 * half.max() else 5).tick_values(*axis.get_view_interval())
            # Labels at the corners would run into those of the next axis.
            inner = np.abs(ticks - middle[i]) < 0.85 * half[i]
            axis.set_major_locator(FixedLocator(list(ticks[inner])))
            axis.set_tick_params(pad=_TICK_PADS[i])
            axis.set_pane_color((0.5, 0.5, 0.5, 0.06))  # a shade of whatever is behind


def frame_paths(robot: Robot, qs: Array, frames: Sequence[str] | None = None) -> FramePaths:
    """Follow `frames` (those that the robot traces by default) along a trajectory.

    Raises
    ------
    UnknownFrame
        If the robot has no such frame.
    """
    names = list(frames) if frames is not None else list(robot.trace_frames)
    ids = [robot.frame_id(name) for name in names]
    keep = np.unique(np.linspace(0, len(qs) - 1, min(len(qs), _MAX_NODES)).astype(int))
    paths = frame_poses(robot.model, qs[keep], ids)[..., :3]
    poses = [_segments(robot, q, ids) for q in (qs[0], qs[-1])]
    return FramePaths([plain_text(name) for name in names], paths, poses)


def _segments(robot: Robot, q: Array, ids: Sequence[int]) -> Array:
    """Return lines that stand for the robot: from joint to joint to traced frame, its rods and springs."""
    model: Any = robot.model
    data: Any = make_working_data(model)
    pin.framesForwardKinematics(model, data, q)
    ends = [frame for c in robot.constraints if c.fixes_origin for frame in c.frame_ids]
    pairs = [c.frame_ids for c in robot.constraints if c.connector is not None]
    pairs += [(force.frame_a, force.frame_b) for force in robot.forces]
    lines = [(data.oMi[parent], data.oMi[joint]) for parent, joint in _links(robot)]
    for frame in (*ids, *ends):
        joint = model.frames[frame].parentJoint
        if joint != 0:  # the ground is no link
            lines.append((data.oMi[joint], data.oMf[frame]))
    lines += [(data.oMf[a], data.oMf[b]) for a, b in pairs]
    points = [[end.translation for end in line] for line in lines]
    return np.array(points, dtype=float).reshape(-1, 2, 3)


def _links(robot: Robot) -> Iterator[tuple[int, int]]:
    """Joints between which there is a link, each with the one before it."""
    model: Any = robot.model
    feet = sum(parent == 0 for parent in model.parents) - 1  # the first is the universe's own
    # Loops may close over frames that are no link, and robots in one world stand apart.
    is_over_ground = feet > 1 and bool(robot.constraints or robot.parts)
    turns = [False] * model.njoints
    for joint in range(1, model.njoints):
        parent = model.parents[joint]
        # A slider's axes are no links unless they turn, and neither is the way to a floating base.
        turns[joint] = turns[parent] or joint_kind(model, joint).word in _HINGES
        if turns[joint] and not (parent == 0 and is_over_ground):
            yield parent, joint

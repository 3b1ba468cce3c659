"""Paths in space: with arrows of the momentum, the projection on the ground, the constraint manifold."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.patches import FancyArrowPatch
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import proj3d  # type: ignore[import-untyped]

from mbocp._arrays import Array
from mbocp.view.figures.style import GREY
from mbocp_papers.pendulums.figure_parts import marker_style, marks

_ARROWS = 11


class _Arrow(FancyArrowPatch):
    """Arrow between two points in space, with a head that perspective leaves alone."""

    def __init__(self, tail: Array, head: Array, **style: Any) -> None:
        super().__init__((0, 0), (0, 0), shrinkA=0, shrinkB=0, clip_on=False, **style)
        self._ends = np.column_stack([tail, head])

    def do_3d_projection(self, renderer: Any = None) -> float:
        """Place the arrow on the page; matplotlib sorts by the depth that this returns."""
        xs, ys, zs = proj3d.proj_transform(*self._ends, self.axes.M)  # type: ignore[union-attr]
        self.set_positions((xs[0], ys[0]), (xs[1], ys[1]))
        return float(np.min(zs))


def draw_path(
    axes: Any, path: Array, arrows: Array, color: str, size: float, num: int = _ARROWS, width: float = 1.6
) -> Any:
    """Draw a path and, evenly along it, arrows in proportion to `arrows`, the longest `size` [m] long.

    Parameters
    ----------
    axes : 3-D axes
    path, arrows : ndarray, shape (n, 3)
    """
    (line,) = axes.plot(*path.T, color=color, linewidth=width, zorder=5)
    gone = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    at = np.unique(np.searchsorted(gone, gone[-1] * np.linspace(0.0, 1.0, num, endpoint=False)))
    lengths = np.linalg.norm(arrows, axis=1)
    for n in at[lengths[at] > 0.05 * lengths.max()]:
        head = path[n] + size / lengths.max() * arrows[n]
        style = {"arrowstyle": "-|>", "mutation_scale": 8, "color": color, "linewidth": 0.9}
        axes.add_artist(_Arrow(path[n], head, **style, zorder=6))
    return line


def draw_markers(axes: Any, path: Array, color: str) -> None:
    """FBSM-Newton's nodes on the path."""
    at = marks(len(path), "fbsm", 2)
    axes.plot(*path[at].T, **{**marker_style("fbsm", 2, color), "zorder": 7, "markersize": 3.2})


def draw_ends(axes: Any, path: Array, color: str) -> None:
    """Start as a circle, end as a star."""
    axes.plot(*path[:1].T, "o", color=color, markersize=6, zorder=8)
    axes.plot(
        *path[-1:].T, "*", color=color, markersize=11, markeredgecolor="white", markeredgewidth=0.6, zorder=8
    )


def ground_projection(axes: Any, path: Array, level: float) -> None:
    """Draw the shadow of the path on the plane z = level."""
    flat = np.column_stack([path[:, :2], np.full(len(path), level)])
    axes.plot(*flat.T, color=GREY, linewidth=1.1, linestyle=(0, (4, 1.5)))
    for i in (0, len(path) - 1):
        axes.plot(*np.array([path[i], flat[i]]).T, color=GREY, linewidth=0.6, linestyle=":")


def sphere(axes: Any, radius: float) -> None:
    """Draw the manifold |q| = radius."""
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, 37), np.linspace(0, 2 * np.pi, 73))
    x = radius * np.sin(polar) * np.cos(azimuth)
    y = radius * np.sin(polar) * np.sin(azimuth)
    z = radius * np.cos(polar)
    axes.plot_surface(x, y, z, color="#BFD7E8", alpha=0.22, linewidth=0, shade=True, rstride=2, cstride=2)
    axes.plot_wireframe(x, y, z, color="#7FA6C0", alpha=0.35, linewidth=0.4, rstride=6, cstride=4)


def tilted_tube(axes: Any, length: float, reach: tuple[float, float]) -> None:
    """Draw the manifold (q3 - q1)^2 + q4^2 = length^2 over q1 in `reach`."""
    q1, angle = np.meshgrid(np.linspace(*reach, 25), np.linspace(0, 2 * np.pi, 73), indexing="ij")
    q3, q4 = q1 + length * np.cos(angle), length * np.sin(angle)
    axes.plot_surface(
        q1, q3, q4, color="#BFD7E8", alpha=0.25, linewidth=0, shade=True, rstride=1, cstride=1, clip_on=False
    )
    axes.plot_wireframe(
        q1, q3, q4, color="#7FA6C0", alpha=0.45, linewidth=0.4, rstride=4, cstride=6, clip_on=False
    )


def equal_box(
    axes: Any, lower: Array, upper: Array, zoom: float, stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> None:
    """Equal scales on all axes, or stretched by given factors."""
    axes.set_xlim(lower[0], upper[0])
    axes.set_ylim(lower[1], upper[1])
    axes.set_zlim(lower[2], upper[2])
    extent = (upper - lower) * stretch
    axes.set_box_aspect(tuple(extent / extent.max()), zoom=zoom)


def finish_space(axes: Any, title: str, names: tuple[str, str, str], view: tuple[float, float]) -> None:
    """Title, labels, few ticks, calm panes."""
    axes.set_title(title, loc="left")
    axes.view_init(elev=view[0], azim=view[1])
    for axis, name in zip((axes.xaxis, axes.yaxis, axes.zaxis), names, strict=True):
        axis.set_label_text(name)
        if axis is axes.zaxis:
            axis.set_rotate_label(False)  # from some sides it would stand upside down
            axis.label.set_rotation(90)
        axis.labelpad = -3
        axis.set_major_locator(MaxNLocator(4))
        axis.set_tick_params(pad=-2, labelsize=7)
        axis.set_pane_color((0.975, 0.975, 0.975, 1.0))

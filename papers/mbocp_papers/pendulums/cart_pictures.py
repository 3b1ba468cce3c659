"""Pictures of a cart with a bob above it: snapshots, and the manoeuvre as a whole."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch, FancyBboxPatch

from mbocp._arrays import Array
from mbocp.view.figures.style import PALETTE
from mbocp_papers.pendulums.motions import Motion

_CART = (0.34, 0.16)  # [m] width, height
_BOB = 0.055  # [m] radius
_FORCE = 0.0115  # [m/N] length of the arrow
_POSES = 14
_GHOSTS = 7


def draw_snapshot(axes: Axes, letter: str, motion: Motion, t: float, *, first: bool) -> None:
    """Cart, rod and bob at time `t`, the control force as an arrow, what was passed before in grey."""
    s = motion.solution
    n = round(t / motion.problem.dt)
    u = float(s.us[min(n, s.num_steps - 1), 0])  # the control of the step that begins here
    lower, upper = float(s.qs[:, :2].min()) - 0.75, float(s.qs[:, :2].max()) + 0.35
    axes.axhline(0.0, color="#555555", linewidth=1.2, zorder=1)
    axes.plot(s.qs[: n + 1, 1], s.qs[: n + 1, 2], color=PALETTE[1], linewidth=1.2, alpha=0.8, zorder=2)
    for k in np.unique(np.round(n * np.linspace(0.0, 1.0, _GHOSTS, endpoint=False) ** 1.5).astype(int)):
        _pose(axes, s.qs[k], alpha=0.15)
    _pose(axes, s.qs[n], alpha=1.0)
    _cart(axes, float(s.qs[n, 0]))
    _force(axes, float(s.qs[n, 0]), u)
    axes.set_title(f"({letter}) $t$ = {t:g} s", loc="left")
    axes.annotate(
        f"$u$ = {_round(u)} N",
        (0.03, 0.94),
        xycoords="axes fraction",
        va="top",
        fontsize=8,
        color=PALETTE[2],
    )
    axes.set_xlim(lower, upper)
    axes.set_ylim(-0.2, 1.35)
    axes.set_aspect("equal")
    axes.set_xticks([0, 1])
    axes.set_yticks([0, 1])
    axes.set_xlabel("$x$ [m]")
    axes.set_ylabel("$z$ [m]" if first else "")


def draw_manoeuvre(axes: Axes, motion: Motion) -> None:
    """Poses along the motion, from pale to dark, and the path of the bob."""
    s = motion.solution
    # The swing-up is quick: half of the poses belong to the first quarter of the time.
    share = np.linspace(0.0, 1.0, _POSES) ** 2
    for i, n in enumerate(np.unique(np.round(share * s.num_steps).astype(int))):
        _pose(axes, s.qs[n], alpha=0.25 + 0.5 * i / _POSES, thin=True)
    axes.plot(s.qs[:, 1], s.qs[:, 2], color=PALETTE[1], linewidth=1.3)
    axes.axhline(0.0, color="#555555", linewidth=0.8, zorder=0)
    axes.set_aspect("equal")
    axes.set_xlim(-0.15, 1.15)
    axes.set_ylim(-0.12, 1.3)
    axes.set_xticks([0, 0.5, 1])
    axes.set_yticks([0, 0.5, 1])
    axes.tick_params(labelsize=6, length=2, pad=1)
    axes.set_ylabel("$x$, $z$ [m]", fontsize=6.5, labelpad=0)
    axes.grid(visible=False)


def _pose(axes: Axes, q: Array, *, alpha: float, thin: bool = False) -> None:
    cart, x, z = q
    axes.plot([cart, x], [0.0, z], color=PALETTE[0], alpha=alpha, linewidth=0.8 if thin else 2.2, zorder=3)
    radius = 0.4 * _BOB if thin else _BOB
    axes.add_patch(Circle((x, z), radius, color=PALETTE[1], alpha=alpha, zorder=4, linewidth=0))


def _cart(axes: Axes, x: float) -> None:
    width, height = _CART
    box = FancyBboxPatch(
        (x - width / 2, -height / 2),
        width,
        height,
        boxstyle="round,pad=0,rounding_size=0.03",
        facecolor="#D9E4EC",
        edgecolor="#34495E",
        linewidth=1.0,
        zorder=2.5,
    )
    axes.add_patch(box)
    for side in (-0.3, 0.3):
        axes.add_patch(Circle((x + side * width, -height / 2), 0.04, color="#34495E", zorder=2.6))


def _force(axes: Axes, x: float, u: float) -> None:
    """Arrow that pushes at the cart from behind."""
    length = _FORCE * u
    if abs(length) < 0.01:  # [m] no arrow that anybody could see
        return
    side = -np.sign(u) * _CART[0] / 2
    tail, head = (x + side - length, 0.0), (x + side, 0.0)
    arrow = FancyArrowPatch(
        tail,
        head,
        arrowstyle="-|>",
        mutation_scale=10,
        color=PALETTE[2],
        linewidth=2.0,
        zorder=5,
        shrinkA=0,
        shrinkB=0,
    )
    axes.add_patch(arrow)


def _round(u: float) -> str:
    return f"{u:.1f}" if abs(u) >= 0.05 else "0.0"  # and not -0.0

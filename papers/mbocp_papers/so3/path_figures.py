"""Figures 5, 6 and 7 of [Manara2017]_: one task solved with quaternions and with rotation matrices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MultipleLocator

from mbocp._arrays import Array
from mbocp.robot import Robot
from mbocp.robot.large import make_working_data
from mbocp.view.figures.style import PALETTE, finish_axes, mark_time, new_figure, strip_legend
from mbocp.view.replay import write_replay
from mbocp_papers.so3.data import CHOICES, UNICYCLE
from mbocp_papers.so3.motions import Motion, task_motion
from mbocp_papers.so3.request import Request, Say

LABELS = {5: "Q RK-MK", 6: "DCM RK-MK"}

_JOINT, _TIP = "joint_B", "pendulum_tip"
_RED, _GREEN = "#C0392B", "#1E8449"  # the paper's colours of joint and tip
_POSES = 16
_VIEW = (24.0, -58.0)  # [deg] elevation, azimuth


def path_figure(number: int, say: Say = str) -> Figure:
    """Time lapse of the motion: joint B in red, tip of the pendulum in green, as in Figures 5 and 6."""
    say(f"Figure {number}: {LABELS[number]}")
    motion = task_motion(LABELS[number])
    robot, solution = motion.problem.robot, motion.solution
    joint, tip = (_positions(robot, solution.qs, frame) for frame in (_JOINT, _TIP))
    figure = new_figure(6.4, 4.6)
    axes: Any = figure.add_subplot(projection="3d")
    for i in np.unique(np.linspace(0, solution.num_steps, _POSES).round().astype(int)):
        fade = 0.2 + 0.8 * i / solution.num_steps
        _pendulum(axes, joint[i], tip[i], fade)
        _axle(axes, solution.qs[i], fade)
    axes.plot(*joint.T, color=_RED, lw=1.8)
    axes.plot(*tip.T, color=_GREEN, lw=1.8)
    _finish(axes, np.vstack([joint, tip]))
    axes.set_title(
        f"{LABELS[number]}: x = y = 0.5 m, θ = π; cost {solution.cost:.3f}, {solution.iterations} iterations",
        loc="left",
    )
    handles = [Line2D([], [], color=c, lw=1.8) for c in (_RED, _GREEN)]
    figure.legend(handles, ["joint B", "tip of the pendulum"], loc="outside lower center", ncols=2)
    return figure


def path_replay(number: int, request: Request) -> list[Path]:
    """Replay page of the same motion, both paths traced."""
    motion = task_motion(LABELS[number])
    name = "quaternion" if number == 5 else "DCM"
    page = write_replay(
        motion.problem.robot,
        motion.solution.t,
        motion.solution.qs,
        request.folder / f"so3_fig{number}.html",
        trace=(_JOINT, _TIP),
        title=f"Figure {number}: {name}, x = y = 0.5 m, yaw = π",
    )
    return [page]


def components_figure(_request: Request, say: Say = str) -> Figure:
    """Components of the quaternion, and controls with their limits: Figure 7."""
    say("Figure 7: Q RK-MK")
    motion = task_motion(LABELS[5])
    t, q, u = motion.solution.t, _continuous(motion), motion.solution.us
    figure = new_figure(8.2, 3.0)
    left, right = figure.subplots(1, 2)
    names = [f"$q_{i}$" for i in range(4)]
    handles = [left.plot(t, q[:, i], color=PALETTE[i])[0] for i in range(4)]
    finish_axes(left, title="(a) quaternion, scalar first", ylabel="component")
    mark_time(left, t)
    strip_legend(left, handles, names)
    limits = (CHOICES.yaw_rate, CHOICES.acceleration)
    handles = []
    for i, limit in enumerate(limits):
        (line,) = right.step(t, np.append(u[:, i], u[-1, i]), where="post", color=PALETTE[i])
        handles.append(line)
        for bound in (-limit, limit):
            right.axhline(bound, color=PALETTE[i], lw=0.7, ls=(0, (4, 2)))
    finish_axes(right, title="(b) controls and their limits", ylabel="rad/s, m/s²")
    mark_time(right, t)
    strip_legend(right, handles, [r"$u_\theta$ [rad/s]", "$u_v$ [m/s²]"])
    return figure


def _continuous(motion: Motion) -> Array:
    """Quaternions with the scalar first and without jumps of their sign, shape (N + 1, 4)."""
    robot = motion.problem.robot
    xyzw = motion.solution.qs[:, robot.configuration_indices("pendulum")]
    q = np.roll(xyzw, 1, axis=1)
    for i in range(1, len(q)):
        if q[i] @ q[i - 1] < 0:
            q[i] = -q[i]
    return np.asarray(q)


def _positions(robot: Robot, qs: Array, frame: str) -> Array:
    """Positions of a frame at each node, shape (N + 1, 3) [m]."""
    data, index = make_working_data(robot.model), robot.model.getFrameId(frame)
    found = []
    for q in qs:
        pin.framesForwardKinematics(robot.model, data, q)
        found.append(data.oMf[index].translation.copy())
    return np.array(found)


def _pendulum(axes: Any, joint: Array, tip: Array, fade: float) -> None:
    axes.plot(*np.stack([joint, tip]).T, color="#333333", lw=1.6, alpha=fade)
    axes.scatter(*tip, color="#333333", s=10, alpha=fade, depthshade=False)


def _axle(axes: Any, q: Array, fade: float) -> None:
    """Axle and wheels as lines."""
    x, y, yaw = q[0], q[1], q[-1]
    along, across = np.array([np.cos(yaw), np.sin(yaw), 0.0]), np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    centre = np.array([x, y, UNICYCLE.r])
    ends = [centre + side * UNICYCLE.a * across for side in (-1, 1)]
    axes.plot(*np.stack(ends).T, color=PALETTE[0], lw=1.1, alpha=fade)
    angles = np.linspace(0, 2 * np.pi, 25)
    for end in ends:
        rim = [end + UNICYCLE.r * (np.cos(a) * along + np.array([0, 0, np.sin(a)])) for a in angles]
        axes.plot(*np.array(rim).T, color=PALETTE[0], lw=0.8, alpha=fade)


def _finish(axes: Any, points: Array) -> None:
    low, high = points.min(axis=0) - 0.05, points.max(axis=0) + 0.05
    low[2] = min(low[2], 0.0)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.25)
    axes.view_init(*_VIEW)
    for name in "xyz":
        getattr(axes, f"set_{name}label")(f"${name}$ [m]")
        getattr(axes, f"{name}axis").set_pane_color((1, 1, 1, 0))
        getattr(axes, f"{name}axis")._axinfo["grid"].update(color="#E3E3E3", linewidth=0.5)
        getattr(axes, f"{name}axis").set_major_locator(MultipleLocator(0.5))

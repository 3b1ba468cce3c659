"""Figure 9 of [Manara2017]_: how far each representation drifts off its manifold."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from mbocp._arrays import Array
from mbocp.view.figures.style import PALETTE, finish_axes, mark_time, new_figure, strip_legend
from mbocp_papers.so3.data import FORMULATIONS
from mbocp_papers.so3.motions import drift_of, resimulate, task_motion
from mbocp_papers.so3.request import Request, Say

_FLOOR = 1e-17  # where exact zeros are drawn
_COLOURS = {"plain": PALETTE[1], "baumgarte": PALETTE[2], "munthe_kaas": PALETTE[0]}
_PANELS = (
    ("quaternion", r"(a) quaternion: $|\,\|q\| - 1|$"),
    ("dcm", r"(b) DCM: $\|R^\top R - I\|_F$"),
)


def drift_figure(_request: Request, say: Say = str) -> Figure:
    """Solve one task by all formulations, and draw the drift along the solutions and along their motions.

    Solid: the states of the solution, which meet the dynamics to the solver's tolerance. Dotted: the start
    integrated anew with the solution's controls.
    """
    figure = new_figure(8.2, 3.4)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, (rotations, title) in zip(panels, _PANELS, strict=True):
        handles, names = [], []
        for one in FORMULATIONS:
            if one.rotations != rotations:
                continue
            say(f"Figure 9: {one.label}")
            motion = task_motion(one.label)
            t, solved = motion.solution.t, motion.solution.manifold_drifts
            again = drift_of(motion.problem, resimulate(motion.problem, motion.solution.us))
            handles.append(_curve(axes, t, solved, _COLOURS[one.lie], "-"))
            _curve(axes, t, again, _COLOURS[one.lie], (0, (1, 1.1)))
            names.append(one.label)
        axes.set_yscale("log")
        finish_axes(axes, title=title, ylabel="deviation")
        mark_time(axes, t)
        strip_legend(axes, handles, names)
    panels[1].set_ylabel("")
    panels[0].set_ylim(_FLOOR / 2, 1e-2)
    styles = [Line2D([], [], color="#444444", ls=ls) for ls in ("-", (0, (1, 1.1)))]
    figure.legend(styles, ["solution", "its controls, integrated anew"], loc="outside lower center", ncols=2)
    return figure


def _curve(axes: Axes, t: Array, values: Array, colour: str, dashes: object) -> Line2D:
    (line,) = axes.plot(t, np.maximum(values, _FLOOR), color=colour, linestyle=dashes)
    return line

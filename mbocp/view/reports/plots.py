"""Panels of a solution as vector pictures, with what ties those over time to a replay."""

from __future__ import annotations

import base64
import html
import io
import json
import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.problem.obstacles.approach import clearances_along
from mbocp.robot.large import working_data
from mbocp.solution import Column
from mbocp.view.figures import panels
from mbocp.view.figures.lines import LinePanel, line_panels
from mbocp.view.figures.style import house_style, line_style, mark_phases, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mbocp.problem import Problem
    from mbocp.robot import Robot
    from mbocp.solution import Solution

_SIZE = (4.5, 2.4)  # [inch]
_DIGITS = 5  # of the numbers under a plot
_MEANS = "Lines and numbers: means of neighbouring steps. Faint: as computed."
_ALWAYS = ("acceleration", "power")  # rates that are shown without limits, too
_MAX_NAMES = 30  # curves whose numbers stand under a plot


def motion_figures(solution: Solution, robot: Robot) -> Iterator[str]:
    """Plots of the motion over time as HTML; a cursor stands at the replay's time, and moves it."""
    tiles = [
        *panels.state_panels(solution),
        *panels.rate_panels(solution, "v"),
        *panels.control_panels(solution),
        *panels.rate_limit_panels(solution, robot, always=_ALWAYS),
        *frame_panels(solution, robot),
    ]
    if np.isfinite(solution.clearance):
        tiles += clearance_panels(solution, solution.load_problem())
    return _tie(tiles, solution)


def multiplier_figures(solution: Solution) -> Iterator[str]:
    """Plots of forces, adjoints and multipliers over time as HTML, with the same cursor."""
    return _tie(panels.multiplier_panels(solution), solution)


def _tie(tiles: Sequence[LinePanel], solution: Solution) -> Iterator[str]:
    for tile in tiles:
        with house_style():
            figure = new_figure(*_SIZE)
            axes = figure.add_subplot()
            styles = [line_style(i) for i in range(len(tile.names))]
            tile.draw(axes, styles)
            mark_phases(axes, solution)
            picture = _picture(figure)
            box = axes.get_position()
        shown = tile.names[:_MAX_NAMES]
        curves = {
            "t": _round(tile.t),
            "values": [_round(tile.values[:, i]) for i in range(len(shown))],
            "step": tile.step,
            "box": [box.x0, box.x1, 1.0 - box.y1, 1.0 - box.y0],
            "from": axes.get_xlim()[0],
            "to": axes.get_xlim()[1],
            "start": float(solution.t[0]),
            "duration": solution.duration,
        }
        legend = "".join(
            f'<span><i style="border-color:{style.color}"></i>{html.escape(_plain(name))} <b></b></span>'
            for name, style in zip(shown, styles, strict=False)
        )
        note = "" if tile.faint is None else _MEANS
        data = html.escape(json.dumps(curves, separators=(",", ":")))
        yield _figure(picture, tile.title, data, legend, note)


def why_zigzag(solution: Solution) -> str:
    """Why multipliers jump from step to step, for those who see it in plots; nothing without constraints."""
    if not solution.nc or all(panel.faint is None for panel in panels.multiplier_panels(solution)):
        return ""
    return (
        "Equations of motion with constraints have index 3. Nothing damps a part of their adjoints that "
        "changes its sign from step to step: it is drawn faintly, and the mean of neighbouring steps in its "
        "place. Motion, controls and forces have no such part."
    )


def other_figures(solution: Solution, robot: Robot) -> Iterator[str]:
    """Convergence, Hamiltonian and drifts as HTML."""
    tiles: list[tuple[str, Callable[[Axes], None]]] = [
        ("convergence", partial(panels.draw_convergence, solution)),
        ("cost of the iterates", partial(panels.draw_cost, solution)),
        ("control Hamiltonian", partial(panels.draw_hamiltonian, solution)),
    ]
    if solution.control_momenta.size or solution.nc or not solution.is_vector_space:
        tiles.append(("drift of what is conserved", partial(panels.draw_drift, solution, robot)))
    for title, draw in tiles:
        with house_style():
            figure = new_figure(*_SIZE)
            axes = figure.add_subplot()
            draw(axes)
            picture = _picture(figure)
        yield _figure(picture, title)


def _figure(picture: str, title: str, curves: str = "", legend: str = "", note: str = "") -> str:
    data, tied = (f' data-curves="{curves}"', " tied") if curves else ("", "")
    caption = f"<figcaption>{legend}</figcaption>" if legend else ""
    image = f'<img alt="{html.escape(_plain(title))}" src="data:image/svg+xml;base64,{picture}">'
    words = f'<p class="note">{note}</p>' if note else ""
    return f'<figure{data}><div class="picture{tied}">{image}</div>{caption}{words}</figure>'


def _picture(figure: Figure) -> str:
    """A figure as SVG in base64; afterwards its axes have their final places."""
    content = io.BytesIO()
    figure.savefig(content, format="svg", metadata={"Date": None})
    return base64.b64encode(content.getvalue()).decode("ascii")


def _round(values: Array) -> list[float | None]:
    return [float(f"{x:.{_DIGITS}g}") if np.isfinite(x) else None for x in values]


def _plain(words: str) -> Any:
    """A label without what matplotlib reads as mathematics."""
    return re.sub(r"\$|\\Delta |\\mathrm|[{}\\]", "", words).strip()


def frame_panels(solution: Solution, robot: Robot) -> list[LinePanel]:
    """Return where the frames that the robot traces are, and how fast they go, in the world's axes."""
    names = robot.trace_frames
    places, speeds = _follow_frames(robot, solution)
    found = []
    for name, place in zip(names, places, strict=True):
        axes = [Column(axis, "m") for axis in "xyz"]
        found += line_panels(f"Position of {name}", "$p$", axes, solution.t, place)
    columns = [Column(name, "m/s") for name in names]
    return [*found, *line_panels("Speed in space", "$|\\dot p|$", columns, solution.t, speeds)]


def _follow_frames(robot: Robot, solution: Solution) -> tuple[Array, Array]:
    """Positions of the traced frames, shape (frames, N + 1, 3) [m], and speeds, (N + 1, frames) [m/s]."""
    ids = [robot.frame_id(name) for name in robot.trace_frames]
    model, data = robot.model, working_data(robot.model)
    places = np.empty((len(ids), len(solution.t), 3))
    speeds = np.empty((len(solution.t), len(ids)))
    for n, (q, v) in enumerate(zip(solution.qs, solution.vs, strict=True)):
        pin.forwardKinematics(model, data, q, v)
        for i, frame in enumerate(ids):
            places[i, n] = pin.updateFramePlacement(model, data, frame).translation
            velocity = pin.getFrameVelocity(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
            speeds[n, i] = np.linalg.norm(velocity.linear)
    return places, speeds


def clearance_panels(solution: Solution, problem: Problem) -> list[LinePanel]:
    """Return the smallest distance of what the problem keeps apart, at the nodes; nothing without such."""
    if problem.clearance is None:
        return []
    columns = [Column("nearest pair of those that are checked", "m")]
    distances = clearances_along(problem.clearance, solution.t, solution.qs)[:, None]
    return line_panels("Clearance", "$d$", columns, solution.t, distances)

"""Panels of a solution as vector pictures, with what ties those over time to a replay."""

from __future__ import annotations

import base64
import html
import io
import json
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin

from mbocp._arrays import Array
from mbocp.problem.obstacles.approach import clearances_along
from mbocp.robot.large import make_working_data
from mbocp.solution import Column
from mbocp.view.figures import panels
from mbocp.view.figures.lines import LinePanel, line_panels
from mbocp.view.figures.style import (
    PALETTE,
    LineStyle,
    calm_limits,
    house_style,
    line_style,
    mark_phases,
    mark_time,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from mbocp.problem import Problem
    from mbocp.robot import Robot
    from mbocp.solution import Solution

_SIZE = (3.7, 2.0)  # [inch]
_DIGITS = 5  # of the numbers under a plot
_MEANS = "Lines and numbers: means of neighbouring steps. Faint: as computed."
_ALWAYS = ("acceleration", "power")  # rates that are shown without limits, too
_MAX_NAMES = 30  # curves whose numbers stand under a plot
_ROUND_OFF = 1e-8  # of a motion, in any of its units
_NOTHING = 1e-12  # of multipliers, whose units are the cost's
_AS_IN_REPLAY = (6, 1, 0, 2, 3)  # of the palette: the first robot has its own colours, see `COLOURS`
_FORCES = ("N", "N m")


def motion_panels(solution: Solution, robot: Robot) -> list[LinePanel]:
    """Return the motion over time: joints and controls, frames, clearance, energy."""
    found = [
        *panels.state_panels(solution),
        *panels.rate_panels(solution, "v"),
        *panels.control_panels(solution),
        *frame_panels(solution, robot),
    ]
    if np.isfinite(solution.clearance):
        found += clearance_panels(solution, solution.load_problem())
    rates = panels.rate_limit_panels(solution, robot, always=_ALWAYS)
    return [*found, *map(_add_total, rates), *energy_panels(solution, robot)]


def motion_figures(solution: Solution, robot: Robot) -> Iterator[str]:
    """Plots of the motion over time as HTML; a cursor stands at the replay's time, and moves it.

    What is constant is told in one line after them.
    """
    found = motion_panels(solution, robot)
    moving = [panel for panel in found if not _is_constant(panel)]
    yield from _tie([[panel] for panel in moving], solution)
    words = "; ".join(_values_of(panel) for panel in found if _is_constant(panel))
    if words:
        yield f'<p class="note whole">Constant: {html.escape(words)}.</p>'


def multiplier_figures(solution: Solution) -> Iterator[str]:
    """Plots of forces, adjoints and multipliers over time as HTML, with the same cursor."""
    return _tie([[panel] for panel in panels.multiplier_panels(solution)], solution, zero=_NOTHING)


def pair_figures(results: Mapping[str, tuple[Solution, Robot]]) -> Iterator[tuple[str, list[str]]]:
    """Title and plots of each quantity of several results, a plot for each column, a colour for each result.

    All begin at the time at which the first begins. Columns that no two results share are left out, and those
    that are constant and the same in all.
    """
    first = next(iter(results.values()))[0]
    styles = {name: LineStyle(PALETTE[k], "-") for name, k in zip(results, _AS_IN_REPLAY, strict=False)}
    found: dict[str, dict[str, list[LinePanel]]] = {}
    for name, (solution, robot) in results.items():
        for panel in motion_panels(solution, robot):
            for k, column in enumerate(panel.names):
                limits = None if panel.limits is None else panel.limits[:, [k]]
                t = panel.t + (first.t[0] - solution.t[0])
                one = replace(
                    panel, names=(name,), t=t, values=panel.values[:, [k]], limits=limits, bands=None
                )
                columns = found.setdefault(f"{panel.title} {_unit_of(panel)}", {})
                columns.setdefault(column, []).append(replace(one, title=_plain(column)))
    for heading, columns in found.items():
        tiles = [tile for tile in columns.values() if len(tile) > 1 and not _are_same(tile)]
        if tiles:
            yield _plain(heading), list(_tie(tiles, first, styles))


def _add_total(panel: LinePanel) -> LinePanel:
    """The powers of several controls with their sum."""
    if panel.title.partition(",")[0] != "Power" or len(panel.names) < 2:
        return panel
    values = np.column_stack([panel.values, panel.values.sum(axis=1)])
    limits = None if panel.limits is None else np.column_stack([panel.limits, [-np.inf, np.inf]])
    return replace(panel, names=(*panel.names, "total"), values=values, limits=limits)


def _is_constant(panel: LinePanel) -> bool:
    sizes = np.maximum(1.0, np.abs(panel.values).max(axis=0, initial=0.0))
    return panel.bands is None and bool((np.ptp(panel.values, axis=0) <= _ROUND_OFF * sizes).all())


def _are_same(tile: Sequence[LinePanel]) -> bool:
    ends = [panel.values[0, 0] for panel in tile]
    return all(map(_is_constant, tile)) and bool(np.ptp(ends) <= _ROUND_OFF)


def _values_of(panel: LinePanel) -> str:
    values = (0.0 if abs(value) <= _ROUND_OFF else value for value in panel.values[0])
    columns = ", ".join(
        f"{_plain(name)} {value:.4g}" for name, value in zip(panel.names, values, strict=True)
    )
    return f"{_plain(panel.title)}: {columns} {_unit_of(panel)}".strip()


def _unit_of(panel: LinePanel) -> str:
    """Unit of a panel in brackets."""
    return f"[{panel.ylabel.rpartition(' [')[2]}" if panel.ylabel.endswith("]") else ""


def _tie(
    tiles: Iterable[Sequence[LinePanel]],
    solution: Solution,
    own: Mapping[str, LineStyle] | None = None,
    zero: float = _ROUND_OFF,
) -> Iterator[str]:
    """Draw tiles; the panels of one share its axes, names may have their own styles, `zero` is no value."""
    for tile in tiles:
        names = [name for panel in tile for name in panel.names]
        styles = [(own or {}).get(name, line_style(i)) for i, name in enumerate(names)]
        with house_style():
            figure = new_figure(*_SIZE)
            axes = figure.add_subplot()
            drawn = 0
            for panel in tile:
                panel.draw(axes, styles[drawn : drawn + len(panel.names)])
                drawn += len(panel.names)
            if len(tile) > 1:
                axes.autoscale(axis="y")  # a constant curve has set its own limits
            mark_time(axes, np.sort(np.concatenate([panel.t for panel in tile])))
            calm_limits(axes, np.concatenate([panel.values.ravel() for panel in tile]), zero)
            mark_phases(axes, solution if len(tile) == 1 else None)
            notes = [axes.get_title(loc="right")]
            for place in ("left", "right"):  # they stand beside the picture, in the page's own letters
                axes.set_title("", loc=place)
            picture = _picture(figure)
            box = axes.get_position()
        curves = {
            **_curves(tile, float(solution.t[0]), zero),
            "box": [box.x0, box.x1, 1.0 - box.y1, 1.0 - box.y0],
            "from": axes.get_xlim()[0],
            "to": axes.get_xlim()[1],
        }
        shown = [name for panel in tile for name in panel.names[:_MAX_NAMES]]
        legend = "".join(
            f'<span><i style="border-color:{style.color}"></i>{html.escape(_plain(name))} <b></b></span>'
            for name, style in zip(shown, styles, strict=False)
        )
        notes += [_MEANS] if any(panel.faint is not None for panel in tile) else []
        data = html.escape(json.dumps(curves, separators=(",", ":")))
        yield _figure(picture, tile[0].title, data, legend, " ".join(filter(None, notes)))


def _curves(tile: Sequence[LinePanel], start: float, zero: float) -> dict[str, Any]:
    """What the page's script reads of a tile: its curves, decimals and times."""
    sizes = np.abs(np.concatenate([panel.values.ravel() for panel in tile]))
    parts = [
        {
            "t": _round(panel.t),
            "values": [_round(column) for column in panel.values.T[:_MAX_NAMES]],
            "step": panel.step,
        }
        for panel in tile
    ]
    return {
        "parts": parts,
        "places": _places(float(sizes[np.isfinite(sizes)].max(initial=0.0)), zero),
        "start": start,
        "duration": float(max(panel.t[-1] for panel in tile) - start),
    }


def _places(largest: float, zero: float) -> int:
    """Decimals of the numbers under a plot: four digits of the largest; what is smaller needs no more."""
    return 0 if largest <= zero else max(0, 3 - math.floor(math.log10(largest)))


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
        ("Convergence", partial(panels.draw_convergence, solution)),
        ("Cost of the iterates", partial(panels.draw_cost, solution)),
        ("Control Hamiltonian", partial(panels.draw_hamiltonian, solution)),
    ]
    if solution.control_momenta.size or solution.nc or not solution.is_vector_space:
        tiles.append(("Drift of what is conserved", partial(panels.draw_drift, solution, robot)))
    for title, draw in tiles:
        with house_style():
            figure = new_figure(*_SIZE)
            axes = figure.add_subplot()
            draw(axes)
            axes.set_title("", loc="left")
            picture = _picture(figure)
        yield _figure(picture, title)


def _figure(picture: str, title: str, curves: str = "", legend: str = "", note: str = "") -> str:
    data, tied = (f' data-curves="{curves}"', " tied") if curves else ("", "")
    caption = f"<figcaption>{legend}</figcaption>" if legend else ""
    heading = html.escape(_plain(title))
    image = f'<img alt="{heading}" src="data:image/svg+xml;base64,{picture}">'
    words = f'<p class="note">{html.escape(note)}</p>' if note else ""
    return (
        f'<figure{data}><h3>{heading}</h3><div class="picture{tied}">{image}</div>{caption}{words}</figure>'
    )


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
    model, data = robot.model, make_working_data(robot.model)
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


def energy_panels(solution: Solution, robot: Robot) -> list[LinePanel]:
    """Return kinetic and potential energy, this one from the start on; nothing where no forces act."""
    if solution.nu and not any(column.unit in _FORCES for column in solution.labels.u):
        return []
    kinetic = 0.5 * np.einsum("ni,ni->n", solution.ps, solution.vs)
    potential = np.array([robot.potential_energy(q) for q in solution.qs])
    potential -= potential[0]
    columns = [Column(name, "J") for name in ("kinetic", "potential since the start", "sum")]
    values = np.column_stack([kinetic, potential, kinetic + potential])
    return line_panels("Energy", "$E$", columns, solution.t, values)

"""Pictures of a solution: states, controls, multipliers, convergence, invariants, path in space.

Every function returns a `matplotlib.figure.Figure` that no global state knows about; `save_figure` writes it
as PNG, PDF or SVG.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec

from mbocp.robot import Robot
from mbocp.solution import Solution
from mbocp.terms.rates import RATE_TERMS
from mbocp.view.figures import panels as panels
from mbocp.view.figures.frame_paths import FramePaths, frame_paths
from mbocp.view.figures.lines import FEW, SHORT_NOTE, LinePanel
from mbocp.view.figures.style import (
    WARNING,
    house_style,
    line_style,
    mark_phases,
    new_figure,
    note_in_corner,
    plain_text,
    save_figure,
    strip_legend,
)

Tile: TypeAlias = LinePanel | Callable[[Axes], None]  # a function draws anything else, legend included

_LETTERS = 11  # on a line of the title, by inch


def plot_states(solution: Solution, *, rate: str = "v") -> Figure:
    """Configuration, and velocity ("v") or momentum ("p"), over time, a panel for each unit."""
    return _stack(solution, [*panels.state_panels(solution), *panels.rate_panels(solution, rate)])


def plot_controls(solution: Solution) -> Figure:
    """Controls over time; limits of the problem are dashed where the motion is near."""
    return _stack(solution, panels.control_panels(solution))


def plot_rates(solution: Solution, robot: Robot | None = None) -> Figure:
    """Accelerations, jerks and rates of controls of every step, and with `robot` the powers, over time.

    A panel for each unit; limits of the problem are dashed where the motion is near.
    """
    return _stack(solution, panels.rate_limit_panels(solution, robot, always=RATE_TERMS))


def plot_multipliers(solution: Solution) -> Figure:
    """Adjoints mu and zeta, multipliers lambda of constraints and of active limits over time."""
    return _stack(solution, panels.multiplier_panels(solution))


def plot_convergence(solution: Solution) -> Figure:
    """Residual, increment and cost over the iterations."""
    return _stack(solution, [partial(panels.draw_convergence, solution), partial(panels.draw_cost, solution)])


def plot_invariants(solution: Solution, robot: Robot | None = None) -> Figure:
    """Control Hamiltonian, control momenta, and how far what is conserved drifts.

    With `robot` the violation of its holonomic constraints is there, too.
    """
    rows: list[Tile] = [partial(panels.draw_hamiltonian, solution)]
    if solution.control_momenta.size:
        rows.append(panels.momentum_panel(solution))
    rows.append(partial(panels.draw_drift, solution, robot))
    return _stack(solution, rows)


def plot_path(solution: Solution, robot: Robot, frames: Sequence[str] | None = None) -> Figure:
    """Path of `frames` in space (default: those that the robot traces), with start, end and direction."""
    with house_style():
        paths = frame_paths(robot, solution.qs, frames)
        figure = new_figure(6.4, 5.6)
        axes = figure.add_subplot(projection=paths.projection)
        paths.draw(axes)
        _title(figure, solution)
        paths.fit(axes)
    return figure


def plot_solution(
    solution: Solution, path: str | Path, robot: Robot | None = None, *, style: str | Path | None = None
) -> Path:
    """Write an overview of the solution on one page as PNG, PDF or SVG, by the suffix of `path`.

    `style` is the name of a style of matplotlib, or a file with one (.mplstyle), over mbocp's own: fonts,
    sizes, lines, grids, backgrounds; colours and dashes of curves stay. With `robot` the page has the path in
    space, the powers and the constraint violation, too.

    Raises
    ------
    ResultFileError
        If the suffix is none of the three, or the file cannot be written.
    InvalidValue
        If there is no such style.
    """
    return save_figure(overview(solution, robot, style=style), path, style=style)


def overview(solution: Solution, robot: Robot | None = None, *, style: str | Path | None = None) -> Figure:
    """Everything about a solution on one page; `style` as in `plot_solution`."""
    tiles: list[Tile] = [
        *panels.state_panels(solution),
        *panels.rate_panels(solution, "v"),
        *panels.control_panels(solution),
        *panels.rate_limit_panels(solution, robot),
    ]
    tiles += _first_of_each_symbol(panels.multiplier_panels(solution))
    tiles += [partial(draw, solution) for draw in (panels.draw_convergence, panels.draw_hamiltonian)]
    if solution.control_momenta.size or solution.nc or not solution.is_vector_space:
        tiles.append(partial(panels.draw_drift, solution, robot))
    with house_style(style):
        paths = frame_paths(robot, solution.qs) if robot is not None and robot.trace_frames else None
        figure, places, path_place = _page(len(tiles), paths)
        shared: dict[str, Any] = {}
        for tile, place in zip(tiles, places, strict=False):
            _draw(tile, figure.add_subplot(place), shared, solution)
        if paths is not None:
            in_space = figure.add_subplot(path_place, projection=paths.projection)
            paths.draw(in_space)
        _share_legend(figure, shared)
        _title(figure, solution)
        if paths is not None:
            paths.fit(in_space)
        if paths is not None and not paths.is_planar:
            figure.set_layout_engine("none")  # all has its place: saving need not look for it again
    return figure


def _first_of_each_symbol(tiles: list[LinePanel]) -> list[LinePanel]:
    """Keep one panel for each kind of multiplier, the one with most curves: the page is an overview."""
    best: dict[str, LinePanel] = {}
    for tile in tiles:
        symbol = tile.ylabel.split(" ")[0]
        if symbol not in best or len(tile.names) > len(best[symbol].names):
            best[symbol] = tile
    return list(best.values())


def _page(num_tiles: int, paths: FramePaths | None) -> tuple[Figure, list[Any], Any]:
    """Lay out `num_tiles` panels and, if there is one, the path in space, at the top right and larger."""
    sizes = [(2, 1), (2, 2)] if paths is not None else [(0, 0)]
    layouts = []
    for columns in (3, 4):
        for high, wide in sizes:
            cells = num_tiles + high * wide
            if columns == 3 or cells > 9:
                rows = max(math.ceil(cells / columns), high)
                # Few empty places, but more than four rows do not fit a screen.
                waste = rows * columns - cells + 2 * max(rows - 4, 0)
                layouts.append((waste, rows, columns, high, wide))
    _, rows, columns, high, wide = min(layouts)
    figure = new_figure(4.1 * columns, 2.55 * rows + 0.9)
    grid = GridSpec(rows, columns, figure=figure)
    free = [grid[i, j] for i in range(rows) for j in range(columns) if i >= high or j < columns - wide]
    return figure, free, grid[:high, columns - wide :] if paths is not None else None


def _stack(solution: Solution, tiles: Sequence[Tile]) -> Figure:
    """Put panels one below the other."""
    with house_style():
        figure = new_figure(7.2, 2.5 * max(len(tiles), 1) + 0.9)
        shared: dict[str, Any] = {}
        for i, tile in enumerate(tiles):
            _draw(tile, figure.add_subplot(len(tiles), 1, i + 1), shared, solution)
        _share_legend(figure, shared)
        _title(figure, solution)
    return figure


def _draw(tile: Tile, axes: Axes, shared: dict[str, Any], solution: Solution) -> None:
    """Draw a panel with its legend above it, or, if that is too long, keep the legend for the whole page."""
    if not isinstance(tile, LinePanel):
        tile(axes)
        return
    if len(tile.names) <= FEW:
        strip_legend(axes, tile.draw(axes, [line_style(i) for i in range(len(tile.names))]), tile.names)
    else:  # a name has one style on the whole page
        places = {name: i for i, name in enumerate(dict.fromkeys([*shared, *tile.names]))}
        handles = tile.draw(axes, [line_style(places[name]) for name in tile.names])
        for name, handle in zip(tile.names, handles, strict=True):
            shared.setdefault(name, handle)
    if tile.faint is not None:
        note_in_corner(axes, SHORT_NOTE)
    mark_phases(axes, solution)


def _share_legend(figure: Figure, shared: dict[str, Any]) -> None:
    if not shared:
        return
    longest = max(len(name) for name in shared)
    width = figure.get_size_inches()[0]
    columns = max(1, min(len(shared), int(width / (0.075 * longest + 0.45))))
    figure.legend(
        list(shared.values()), list(shared), loc="outside lower center", ncols=columns, handlelength=2.4
    )


def _title(figure: Figure, solution: Solution) -> None:
    name = solution.problem_name or solution.robot_name or "solution"
    robot = f", robot {solution.robot_name}" if solution.robot_name not in ("", name) else ""
    status = "converged" if solution.converged else f"not converged ({solution.status})"
    width = int(_LETTERS * figure.get_size_inches()[0])
    head = f"{name}{robot}: {status} after {solution.iterations} iterations of {solution.solver}"
    words = [
        "\n".join(textwrap.wrap(head, width)),
        f"$J$ = {solution.cost:.7g}, residual {solution.residual:.1e}, "
        f"$N$ = {solution.num_steps}, $T$ = {solution.duration:g} s",
    ]
    if not solution.converged and solution.advice:
        words.append(
            "\n".join(textwrap.wrap(plain_text(solution.advice), width, max_lines=3, placeholder=" ..."))
        )
    figure.suptitle(
        "\n".join([plain_text(words[0]), *words[1:]]),
        fontsize=10.5,
        color=matplotlib.rcParams["text.color"] if solution.converged else WARNING,
    )

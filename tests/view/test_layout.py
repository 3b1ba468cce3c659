"""Where the words of a picture stand: on the page, and none over the numbers at the ticks."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import cache
from typing import Any

import pytest
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from mbocp.robot import load_robot
from mbocp.solution import Solution
from mbocp.view.figures.style import DPI
from mbocp.view.plots import (
    overview,
    plot_multipliers,
    plot_path,
    plot_states,
)
from tests.mechanics.models import cart_pendulum
from tests.solution.fabricated import arm, humanoid, limited, pendulum
from tests.view.motions import hanging, motion

TOUCH = 0.5  # [pixel] by which boxes may meet
SCALES = (1e-9, 4321.0)  # of what is drawn: the numbers at the ticks are long or short


def reach(scale: float) -> tuple[Solution, Any]:
    robot = hanging(load_robot("ur5"), "tool0")
    made = motion(robot, [0.5, -1.0, 1.0, 0.0, 0.5, 0.0])
    return motion(robot, [0.5, -1.0, 1.0, 0.0, 0.5, 0.0], us=scale * made.us, vs=scale * made.vs), robot


def flat() -> tuple[Solution, Any]:
    robot = hanging(cart_pendulum(), "bob_body")
    return motion(robot, [1.0, 1.5, 1.0]), robot


def overviews() -> Iterator[tuple[str, Any]]:
    for scale in SCALES:
        yield f"reach-{scale:g}", lambda scale=scale: overview(*reach(scale))
    yield "flat", lambda: overview(*flat())
    yield "path", lambda: plot_path(*reach(1.0))
    for make in (pendulum, arm, humanoid, limited):
        yield make.__name__, lambda make=make: overview(make(num_steps=20))
    yield "states", lambda: plot_states(humanoid(num_steps=20))
    yield "multipliers", lambda: plot_multipliers(limited())


CASES = dict(overviews())


def box(text: Text, renderer: Any) -> Bbox:
    return text.get_window_extent(renderer)


def ticks(axis: Axis) -> Iterator[Text]:
    """Numbers at the ticks that are in the picture: matplotlib keeps others, which it does not draw."""
    low, high = sorted(axis.get_view_interval())
    for place, tick in zip(axis.get_majorticklocs(), axis.majorTicks, strict=False):
        if low <= place <= high:
            yield tick.label1
    yield axis.get_offset_text()


def axes_of(figure: Figure) -> Iterator[Axis]:
    for axes in figure.axes:
        yield from (getattr(axes, f"{name}axis") for name in "xyz" if hasattr(axes, f"{name}axis"))


def words(figure: Figure) -> Iterator[Text]:
    """All text that is drawn."""
    hidden = {
        text
        for axis in axes_of(figure)
        for text in [*axis.get_majorticklabels(), *axis.get_minorticklabels()]
    }
    for text in figure.findobj(Text):
        if text not in hidden and text.get_visible() and text.get_text():
            yield text
    for axis in axes_of(figure):
        if axis.axes.name != "3d":
            yield from (text for text in ticks(axis) if text.get_text())


def drawn(figure: Figure) -> Any:
    """A renderer after the figure is laid out as `save_figure` does."""
    canvas = FigureCanvasAgg(figure)
    figure.draw_without_rendering()
    return canvas.get_renderer()


@cache
def page(case: str) -> tuple[Figure, Any]:
    """A figure that is laid out, and its renderer."""
    figure = CASES[case]()
    return figure, drawn(figure)


def outside(figure: Figure, renderer: Any) -> list[str]:
    page = figure.bbox.padded(TOUCH)
    found = [(text.get_text(), box(text, renderer)) for text in words(figure)]
    in_space = [
        axis for axis in axes_of(figure) if axis.axes.name == "3d"
    ]  # which know where their numbers are
    found += [(f"numbers of {axis.get_label_text()}", axis.get_tightbbox(renderer)) for axis in in_space]
    return [
        f"{name!r} at {b.extents.round(1)}"
        for name, b in found
        if b.x0 < page.x0 or b.y0 < page.y0 or b.x1 > page.x1 or b.y1 > page.y1
    ]


def overlaps(figure: Figure, renderer: Any) -> list[str]:
    """Labels of axes that stand over numbers at ticks, of their own panel or of another."""
    flat = [axis for axis in axes_of(figure) if axis.axes.name != "3d"]  # boxes of turned text say nothing
    labels, numbers = (
        [(text.get_text(), box(text, renderer)) for text in texts if text.get_text()]
        for texts in ([axis.label for axis in flat], [text for axis in flat for text in ticks(axis)])
    )
    pairs = itertools.product(labels, numbers)
    return [f"{label!r} over {number!r}" for (label, a), (number, b) in pairs if a.padded(-TOUCH).overlaps(b)]


@pytest.mark.parametrize("case", CASES)
def test_words_are_on_the_page_and_labels_beside_the_ticks(case: str) -> None:
    figure, renderer = page(case)
    assert figure.dpi == DPI
    assert not outside(figure, renderer)
    assert not overlaps(figure, renderer)


def test_what_is_outside_or_over_a_tick_is_found() -> None:
    figure = plot_states(pendulum(num_steps=20))
    drawn(figure)
    figure.set_layout_engine("none")
    axes = figure.axes[0]
    axes.xaxis.set_label_coords(0.01, -0.02)  # over the first number
    figure.text(0.99, 0.5, "beyond the edge")
    renderer = drawn(figure)
    assert [name for name in outside(figure, renderer) if "beyond" in name]
    assert [name for name in overlaps(figure, renderer) if "time" in name]


def test_the_page_has_a_margin() -> None:
    """Words do not touch the edge: at other resolutions letters are wider, by up to half a pixel each."""
    figure, renderer = page(f"reach-{SCALES[-1]:g}")
    left = min(box(axes.yaxis.label, renderer).x0 for axes in figure.axes)
    assert left / figure.dpi > 0.03  # [inch]

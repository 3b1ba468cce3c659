"""How every picture of mbocp looks: colours, fonts, legends, axes, files."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import MaxNLocator, NullFormatter

from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue, ResultFileError
from mbocp.solution import Solution
from mbocp.solution.atomic import replace_file

# Okabe and Ito's palette, which people with any colour vision can tell apart; yellow is too pale for a line.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#222222")
GREY = "#8A8A8A"
WARNING = "#B03A00"
SUFFIXES = (".png", ".pdf", ".svg")
DPI = 160  # of files and of the layout: how wide text is in inches depends on it
_FLOOR = 0.09  # of the axes' height, for the names of phases
_LETTER, _HANDLE, _BESIDE_AXES = 0.056, 0.45, 0.8  # [inch] of legends; of labels and ticks beside a panel
_GAP = 0.06  # [inch] between a panel with its labels and its neighbours or the edge of the page

_DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1, 1.2)), (0, (5, 1.2, 1, 1.2)))
_STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 8.5,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8.5,
    "axes.labelpad": 6.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#555555",
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#E3E3E3",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "xtick.color": "#444444",
    "ytick.color": "#444444",
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "mathtext.fontset": "dejavusans",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "pdf.fonttype": 42,
    "svg.fonttype": "path",
}


class LineStyle(NamedTuple):
    """Colour and dashes of a line."""

    color: str
    linestyle: Any


def line_style(index: int) -> LineStyle:
    """Return the style of the `index`-th line: seven colours, then the same dashed, dotted, dash-dotted."""
    return LineStyle(PALETTE[index % len(PALETTE)], _DASHES[index // len(PALETTE) % len(_DASHES)])


@contextmanager
def house_style(style: str | Path | None = None) -> Iterator[None]:
    """Set matplotlib's defaults within this context.

    Parameters
    ----------
    style : str or Path, optional
        Name of a style of matplotlib, or a file with one (.mplstyle): what it says takes the place of what
        mbocp does, but for colours and dashes of curves.

    Raises
    ------
    InvalidValue
        If there is no such style, or it cannot be read.
    """
    with matplotlib.rc_context(_STYLE):
        if style is not None:
            _use(style)
        yield


def _use(style: str | Path) -> None:
    from matplotlib import style as styles  # it reads all styles that there are

    try:
        styles.use(style)
    except (OSError, ValueError, RuntimeError) as error:
        names = ", ".join(styles.available)
        raise InvalidValue("style", str(style), f"a file (.mplstyle) or one of {names}") from error


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure [inch] that no global state knows about."""
    return Figure((width, height), DPI, layout=ConstrainedLayoutEngine(w_pad=_GAP, h_pad=_GAP))


def plain_text(text: str) -> str:
    """Return `text` as a label that matplotlib neither reads as mathematics nor leaves out of legends."""
    escaped = text.replace("$", r"\$")
    return "\N{HAIR SPACE}" + escaped if escaped.startswith("_") else escaped


def shorten(names: Sequence[str]) -> tuple[str, list[str]]:
    """Split names into the beginning that they share, up to a separator, and what is left.

    >>> shorten(["root_joint.x", "root_joint.y"])
    ('root_joint', ['x', 'y'])
    >>> shorten(["distance of hand from box", "distance of hand from wall"])
    ('distance of hand from ...', ['box', 'wall'])
    """
    if len(names) < 2:
        return "", list(names)
    least, greatest = min(names), max(names)
    same = [a == b for a, b in zip(least, greatest, strict=False)]
    common = least[: same.index(False) if False in same else len(same)]
    cut = max(common.rfind(separator) for separator in "._:/ -") + 1
    # One letter is a name for a coordinate, but "1" alone is not one for a joint.
    rest = [name[cut:] for name in names]
    if cut < 2 or any(not r or r.isdigit() for r in rest):
        return "", list(names)
    beginning = names[0][: cut - 1]
    return (f"{beginning} ..." if names[0][cut - 1] == " " else beginning), rest


def strip_legend(axes: Axes, handles: Sequence[Any], names: Sequence[str], *, per_row: int = 4) -> None:
    """Put a legend between the title and the data, where it covers neither; `names` may hold mathematics.

    It is no wider than the panel: else the layout would make room for it at the cost of the others.
    """
    rows = math.ceil(len(names) / min(per_row, _most_per_row(axes, names)))
    axes.legend(
        handles,
        list(names),
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        ncols=math.ceil(len(names) / rows),
        borderaxespad=0.0,
        borderpad=0.15,
        handlelength=1.6,
        handletextpad=0.5,
        columnspacing=1.1,
    )
    axes.set_title(axes.get_title(loc="left"), loc="left", pad=5 + 11 * rows)


def _most_per_row(axes: Axes, names: Sequence[str]) -> int:
    """How many names a row of a panel's legend has room for."""
    place, figure = axes.get_subplotspec(), axes.figure
    assert place is not None  # panels are places of a grid
    assert isinstance(figure, Figure)
    part = len(place.colspan) / place.get_gridspec().ncols
    width = part * figure.get_size_inches()[0] - _BESIDE_AXES
    return max(1, int(width / (_LETTER * max(map(len, names)) + _HANDLE)))


def finish_axes(axes: Axes, *, title: str, ylabel: str, xlabel: str = "time $t$ [s]") -> None:
    """Label the axes and keep the ticks few."""
    axes.set_title(title, loc="left")
    axes.set_xlabel(xlabel)
    axes.set_ylabel(ylabel)
    if axes.get_yscale() == "log":
        _whole_decades(axes)
    else:
        axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
        axes.ticklabel_format(axis="y", useOffset=False, scilimits=(-3, 4))
        axes.yaxis.get_offset_text().set_horizontalalignment(
            "right"
        )  # over the ticks: the legend is beside it
    axes.xaxis.set_major_locator(MaxNLocator(6))


def note_beside_title(axes: Axes, words: str) -> None:
    """Write a few words at the right end above the axes."""
    axes.set_title(words, loc="right", fontsize=6.5, color=GREY, fontweight="normal", pad=3)


def note_in_corner(axes: Axes, words: str) -> None:
    """Write a few words within the axes, at the top right."""
    box = {"facecolor": matplotlib.rcParams["axes.facecolor"], "alpha": 0.85, "edgecolor": "none", "pad": 1.5}
    place: Any = {"xy": (0.99, 0.98), "xycoords": "axes fraction", "ha": "right", "va": "top"}
    axes.annotate(words, **place, fontsize=6.5, color=GREY, bbox=box)


def _whole_decades(axes: Axes) -> None:
    """Label powers of ten only, and show at least two of them."""
    low, high = (math.log10(y) for y in axes.get_ylim())
    if high - low < 2:
        middle = (low + high) / 2
        low, high = math.floor(middle - 1), math.ceil(middle + 1)
    axes.set_ylim(10**low, 10**high)
    axes.yaxis.set_minor_formatter(NullFormatter())


def mark_time(axes: Axes, t: Array) -> None:
    """Let the axes show the whole horizon and no more."""
    margin = 0.01 * (t[-1] - t[0])
    axes.set_xlim(t[0] - margin, t[-1] + margin)


def mark_phases(axes: Axes, solution: Solution | None) -> None:
    """Draw a line where each phase but the last ends, and write the phases' names below the curves."""
    if solution is None or not solution.phase_times:
        return
    low, high = axes.get_ylim()
    axes.set_ylim(low - _FLOOR * (high - low), high)
    start = float(solution.t[0])
    for i, (name, (begins, ends)) in enumerate(solution.phase_times.items()):
        if i:
            axes.axvline(start + begins, color=GREY, linewidth=0.8, linestyle=":")
        middle = start + (begins + ends) / 2
        place: Any = {"xy": (middle, 0.02), "xycoords": axes.get_xaxis_transform()}
        axes.annotate(plain_text(name), **place, ha="center", va="bottom", color=GREY, fontsize=6.5)


def calm_limits(axes: Axes, values: Array, zero: float = 1e-12) -> None:
    """Widen the axes of a constant curve, so that round-off does not fill them; `zero` is below any value."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return
    low, high = float(finite.min()), float(finite.max())
    middle, scale = (low + high) / 2, max(abs(low), abs(high))
    if high - low < 1e-6 * scale or scale < zero:
        half = 0.1 * scale if scale >= zero else 1.0
        axes.set_ylim(middle - half, middle + half)


def save_figure(figure: Figure, path: str | Path, *, dpi: int = DPI, style: str | Path | None = None) -> Path:
    """Write a figure as PNG, PDF or SVG, by the suffix; an interrupted write leaves the old file whole.

    `style` is that of the figure, see `plot_solution`.

    Raises
    ------
    ResultFileError
        If the suffix is none of these, or the file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        got = f"a picture cannot have the suffix {suffix!r}" if suffix else "a picture needs a suffix"
        raise ResultFileError(path, f"{got}: use {', '.join(SUFFIXES)}")
    drawn = io.BytesIO()
    with house_style(style):
        if suffix == ".png":
            _write_png(figure, drawn, dpi)
        else:
            figure.savefig(drawn, format=suffix[1:], dpi=dpi)
    return replace_file(path, drawn.getvalue())


def _write_png(figure: Figure, target: io.BytesIO, dpi: int) -> None:
    """Lay out and draw once; `Figure.savefig` does both twice."""
    before = figure.dpi
    figure.set_dpi(dpi)
    try:
        # What the layout drew on knows how large the texts are.
        canvas: Any = figure.canvas if isinstance(figure.canvas, FigureCanvasAgg) else FigureCanvasAgg(figure)
        canvas.print_png(target)
    finally:
        figure.set_dpi(before)

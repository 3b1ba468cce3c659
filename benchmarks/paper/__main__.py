"""`python -m benchmarks.paper`: the first paper's tables, on one core; `--docs` keeps them."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from mbocp_papers.machine import machine_line
from mbocp_papers.pendulums.figures import FIGURES, write_figure
from mbocp_papers.pendulums.tables import TITLES, check_table, make_table
from PIL import Image  # comes with matplotlib

from benchmarks.machine import header, one_core
from benchmarks.tables import show
from mbocp.cli.console import output

__all__ = ["DOCS", "TABLES", "main", "replaced"]

DOCS = Path(__file__).parents[2] / "docs"
TABLES = DOCS.parent / "benchmarks" / "measured" / "paper.md"
_DPI, _COLORS = 120, 256  # pictures of some 100 kB


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the tables, or rewrite the documentation with them."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.paper", description=__doc__)
    parser.add_argument("--table", type=int, action="append", metavar="N", help="default: all; repeatable")
    parser.add_argument("--markdown", action="store_true", help="print Markdown")
    parser.add_argument(
        "--docs", action="store_true", help="rewrite measured/paper.md and the figures in docs"
    )
    parser.add_argument("--quick", action="store_true", help="only the two coarsest step sizes")
    options = parser.parse_args(arguments)
    numbers = options.table or list(TITLES)
    for number in numbers:
        check_table(number)
    one_core()
    if options.docs:
        rewrite(numbers, quick=options.quick, figures=options.table is None)
        return
    show(header(), markdown=options.markdown)
    for number in numbers:
        table = make_table(number, quick=options.quick, say=_say)
        if options.markdown:
            print(f"## Table {number}: {table.title}\n\n{table.markdown()}", flush=True)
        else:
            table.print(output())


def rewrite(numbers: Sequence[int], *, quick: bool, figures: bool) -> None:
    """Put new tables, the line about the machine, and new figures into the documentation."""
    page = replaced(TABLES.read_text(encoding="utf-8"), "machine", machine_line() + ", one core used.\n")
    for number in numbers:
        page = replaced(page, f"table {number}", make_table(number, quick=quick, say=_say).markdown())
    TABLES.write_text(page, encoding="utf-8")
    for number in FIGURES if figures else ():
        for path in write_figure(number, DOCS / "images", dpi=_DPI, say=_say):
            with Image.open(path) as picture:
                small = picture.convert("RGB").quantize(_COLORS, kmeans=5, dither=Image.Dither.NONE)
            small.save(path, optimize=True)


def replaced(page: str, name: str, text: str) -> str:
    """Put `text` between the markers of that name."""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    pattern = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
    made, count = pattern.subn(lambda _: f"{begin}\n\n{text}\n{end}", page)
    if count != 1:
        raise SystemExit(f"documentation: found the markers of {name!r} {count} times, expected once")
    return made


def _say(words: str) -> None:
    print(words, file=sys.stderr)


if __name__ == "__main__":
    main()

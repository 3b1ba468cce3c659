"""`python -m benchmarks.paper.so3 --docs --results FILE`: rewrites measured/paper_so3.md and its figures."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from mbocp_papers.machine import machine_line
from mbocp_papers.so3 import CHOICES, Choices
from mbocp_papers.so3.figures import FIGURES, LATTICE_FIGURES, check_figure, write_figure
from mbocp_papers.so3.request import Request, lattice_outcomes
from mbocp_papers.so3.tables import TITLES, check_table, make_table, summary_table
from PIL import Image  # comes with matplotlib

from benchmarks.paper.__main__ import DOCS, TABLES, replaced

__all__ = ["PAGE", "choices_table", "main"]

PAGE = TABLES.with_name("paper_so3.md")
_DPI, _COLORS = 130, 128  # pictures of some 30 kB


def main(arguments: Sequence[str] | None = None) -> None:
    """Rewrite the page, or parts of it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.paper.so3", description=__doc__)
    parser.add_argument("--docs", action="store_true", required=True, help="rewrite measured/paper_so3.md")
    parser.add_argument("--results", type=Path, metavar="FILE.jsonl", help="rows of the lattice")
    parser.add_argument("--printed", type=Path, metavar="FILE.jsonl", help="rows of the variant as_printed")
    parser.add_argument("--table", type=int, action="append", metavar="N", help="default: all; repeatable")
    parser.add_argument("--figure", type=int, action="append", metavar="N", help="default: all; repeatable")
    parser.add_argument("--quick", action="store_true", help="fewer repetitions and steps")
    options = parser.parse_args(arguments)
    tables = list(TITLES) if options.table is None and options.figure is None else options.table or []
    figures = list(FIGURES) if options.table is None and options.figure is None else options.figure or []
    for number in tables:
        check_table(number)
    for number in figures:
        check_figure(number)
    if options.results is None:
        figures = [number for number in figures if number not in LATTICE_FIGURES]
    request = Request(folder=DOCS / "images" / "so3", results=options.results, quick=options.quick, dpi=_DPI)
    _rewrite(request, tables, options.printed)
    for number in figures:
        for path in write_figure(number, request, _say):
            _settle(path)


def choices_table() -> str:
    """Markdown table of what the paper leaves open, with the reasons that `Choices` gives."""
    attributes = (Choices.__doc__ or "").partition("Attributes")[2]
    entries = re.findall(r"^    (\w[\w, ]*) : float\n((?:        .+\n)+)", attributes, re.MULTILINE)
    lines = ["| number | value | why |", "| --- | --- | --- |"]
    for names, words in entries:
        each = names.split(", ")
        values = ", ".join(f"{getattr(CHOICES, name):.6g}" for name in each)
        symbols = ", ".join(f"`{name}`" for name in each)
        lines.append(f"| {symbols} | {values} | {' '.join(words.split())} |")
    return "\n".join(lines) + "\n"


def _rewrite(request: Request, tables: Sequence[int], printed: Path | None) -> None:
    page = PAGE.read_text(encoding="utf-8")
    page = replaced(page, "choices", choices_table())
    for number in tables:
        page = replaced(page, f"table {number}", make_table(number, request, _say).markdown())
        page = replaced(page, "machine", machine_line() + ", one core used.\n")
    for name, rows in (("lattice", request.results), ("lattice as printed", printed)):
        if rows is not None:
            summary = summary_table(lattice_outcomes(replace(request, results=rows)))
            notes = "".join(f"- {note}\n" for note in summary.notes)
            page = replaced(page, name, f"{summary.markdown()}\n{notes}")
    PAGE.write_text(page, encoding="utf-8")


def _settle(path: Path) -> None:
    """Make pictures small; what is no picture is not kept."""
    if path.suffix != ".png":
        path.unlink()
        return
    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(_COLORS, kmeans=5, dither=Image.Dither.NONE)
    small.save(path, optimize=True)


def _say(words: str) -> None:
    print(words, file=sys.stderr)


if __name__ == "__main__":
    main()

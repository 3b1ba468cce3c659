"""Rows of many tasks side by side, in a file that is gone on with."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pebble import ProcessPool

from tests.sent.cases import ROBOTS

Row = dict[str, Any]


def add_options(parser: argparse.ArgumentParser, count: int, out: str) -> None:
    """Add what says which rows there are, and where they stand."""
    parser.add_argument("--count", type=int, default=count, help="of each robot")
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("-o", "--out", type=Path, default=Path(out), help="rows; resumed")


def rows_of(options: argparse.Namespace, work: Callable[[str, int], Row]) -> list[Row]:
    """Return the rows of all robots and seeds; those that the file has are not worked out again."""
    options.out.parent.mkdir(parents=True, exist_ok=True)
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    rows = [json.loads(line) for line in lines]
    done = {(row["robot"], row["seed"]) for row in rows}
    seeds = range(options.first, options.first + options.count)
    left = [(name, k) for name in options.robots for k in seeds if (name, k) not in done]
    with options.out.open("a") as file, ProcessPool(max_workers=options.workers) as pool:
        for row in pool.map(work, *zip(*left, strict=True), chunksize=1).result() if left else ():
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()
    return rows

"""All pairs of features, made, compiled, solved, saved and solved again: `python -m tests.pairs`."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from tests.campaign.run import read_rows
from tests.pairs.features import FEATURES, ROBOTS
from tests.pairs.run import FAILED, run


def main(arguments: Sequence[str] | None = None) -> int:
    """Run or resume; 1 if a set of features crashes, or fails without having been refused."""
    parser = argparse.ArgumentParser(prog="python -m tests.pairs", description=__doc__)
    parser.add_argument("--robots", nargs="*", default=list(ROBOTS), choices=list(ROBOTS))
    parser.add_argument("--features", nargs="*", default=[], choices=list(FEATURES), metavar="NAME")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("-o", "--out", type=Path, default=Path("build/pairs.jsonl"), help="rows; resumed")
    options = parser.parse_args(arguments)
    os.environ.setdefault("MBOCP_FUNCTIONS", "compiled")  # that functions compile is what is looked at
    with tempfile.TemporaryDirectory() as folder:
        for robot in options.robots:
            for row in run(robot, options.out, Path(folder), options.workers, options.features):
                if row["kind"] == "solved":
                    print(robot, row["status"], *row["features"], file=sys.stderr, flush=True)
    rows = [row for row in read_rows(options.out) if row["robot"] in options.robots or row["kind"] == "made"]
    for robot in options.robots:
        counts = Counter((r["kind"], r["status"]) for r in rows if r["robot"] == robot)
        for (kind, status), count in sorted(counts.items()):
            print(f"{robot:8} {kind:8} {status:16} {count:6}")
    failed = [row for row in rows if row["status"] in FAILED]
    for row in failed:
        print(f"{row['status']}: {row['robot']} {' '.join(row['features'])}: {row['says'].splitlines()[-1]}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

"""Random problems within limits, sampled between nodes: `python -m tests.between_nodes --count 500`."""

from __future__ import annotations

import argparse
import json
import sys
from collections import defaultdict
from functools import partial
from pathlib import Path

import numpy as np
from pebble import ProcessPool

from tests.between_nodes.cases import RATE, TOLERANCE, row_of


def main() -> int:
    """Run or go on; 1 if a motion leaves a limit farther than its result says."""
    parser = argparse.ArgumentParser(prog="python -m tests.between_nodes", description=__doc__)
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rate", type=float, default=RATE, help="samples a second")
    parser.add_argument(
        "-o", "--out", type=Path, default=Path("build/between_nodes.jsonl"), help="rows; resumed"
    )
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    rows = [json.loads(line) for line in lines]
    left = sorted(set(range(options.count)) - {row["seed"] for row in rows})
    with options.out.open("a") as file, ProcessPool(max_workers=options.workers) as pool:
        for row in pool.map(partial(row_of, rate=options.rate), left, chunksize=1).result():
            rows.append(row)
            file.write(json.dumps(row) + "\n")
            file.flush()
            if len(rows) % 50 == 0:
                print(f"{len(rows)} of {options.count}", file=sys.stderr)
    groups = defaultdict(list)
    for row in rows:
        groups[row.get("controls", "refused")].append(row)
    print("| controls | problems | told nothing | converged | under-resolved | largest excess: told | so |")
    print("|---|---|---|---|---|---|---|")
    for name, members in sorted(groups.items()):
        followed = [row for row in members if "told" in row and not np.isnan(row["told"])]
        good = [row for row in followed if row["status"] == "converged"]
        coarse = sum(row["status"] == "under_resolved" for row in followed)
        told, true = (np.max([row[key] for row in good], initial=0.0) for key in ("told", "true"))
        silent = len(members) - len(followed)  # schemes of first order: the robot does something else anyway
        print(f"| {name} | {len(members)} | {silent} | {len(good)} | {coarse} | {told:.2%} | {true:.2%} |")
    beyond = [row for row in rows if row.get("is_beyond")]
    print(f"\nbeyond what is told by more than {TOLERANCE:.0%} of the limit: {len(beyond)} of {len(rows)}")
    for row in beyond:
        print(row)
    return 1 if beyond else 0


if __name__ == "__main__":
    sys.exit(main())

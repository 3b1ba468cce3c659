"""Random motions, written and read back: `python -m tests.sent --count 1000`."""

from __future__ import annotations

import argparse
import json
import sys
from functools import partial
from pathlib import Path

import numpy as np
from pebble import ProcessPool

from tests.sent.cases import ROBOTS, TOLERANCE, row_of


def main() -> int:
    """Run or go on; 1 if a converged motion leaves a limit as it is sent, or is faster than possible."""
    parser = argparse.ArgumentParser(prog="python -m tests.sent", description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="of each robot")
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument(
        "--torques", action="store_true", help="with limits of torques, which Ruckig has none of"
    )
    parser.add_argument("-o", "--out", type=Path, default=Path("build/sent.jsonl"), help="rows; resumed")
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    rows = [json.loads(line) for line in lines]
    with options.out.open("a") as file, ProcessPool(max_workers=options.workers) as pool:
        for name in options.robots:
            left = sorted(set(range(options.count)) - {row["seed"] for row in rows if row["robot"] == name})
            work = partial(row_of, name, with_torques=options.torques)
            for row in pool.map(work, left, chunksize=1).result():
                rows.append(row)
                file.write(json.dumps(row) + "\n")
                file.flush()
    print(
        "| robot | motions | converged | seconds: median, 90 % "
        "| sent, above the exact optimum: least, median, 90 %, most | largest violation |"
    )
    print("|---|---|---|---|---|---|")
    is_good = True
    for name in options.robots:
        own = [row for row in rows if row["robot"] == name]
        good = [row for row in own if row["status"] == "converged"]
        seconds = np.quantile([row["seconds"] for row in own], [0.5, 0.9])
        above = np.array([row["sent"] / row["least"] - 1.0 for row in good])
        worst = max(((v, kind, row["seed"]) for row in good for kind, v in row["violations"].items()))
        is_good &= worst[0] <= TOLERANCE and (options.torques or above.min() >= 0.0)
        print(
            f"| {name} | {len(own)} | {len(good)} | {seconds[0]:.2f}, {seconds[1]:.2f} | {above.min():.2%}, "
            f"{np.median(above):.2%}, {np.quantile(above, 0.9):.2%}, {above.max():.2%} "
            f"| {worst[0]:.1e} ({worst[1]}, {worst[2]}) |"
        )
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())

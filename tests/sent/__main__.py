"""Random motions, written and read back: `python -m tests.sent --count 1000 --controls stages`."""

from __future__ import annotations

import argparse
import sys
from functools import partial

import numpy as np

from mbocp.integrators.controls import CONTROLS
from tests.sent.cases import TOLERANCE, row_of
from tests.sent.rows import add_options, rows_of

_NEAR = 0.005  # of the exact optimum: motions above it by no more are counted


def main() -> int:
    """Run or go on; 1 if a converged motion leaves a limit as it is sent, or is faster than possible."""
    parser = argparse.ArgumentParser(prog="python -m tests.sent", description=__doc__)
    add_options(parser, 1000, "build/sent.jsonl")
    parser.add_argument(
        "--torques", action="store_true", help="with limits of torques, which Ruckig has none of"
    )
    parser.add_argument("--controls", choices=CONTROLS, default=CONTROLS[0])
    options = parser.parse_args()
    work = partial(row_of, controls=options.controls, with_torques=options.torques)
    rows = rows_of(options, work)
    print(
        "| robot | motions | converged | iterations | processor seconds: median, 90 % "
        f"| sent, above the exact optimum: least, median, 90 %, most, share within {_NEAR:.1%} "
        "| largest violation |"
    )
    print("|---|---|---|---|---|---|---|")
    is_good = True
    for name in options.robots:
        own = [row for row in rows if row["robot"] == name]
        good = [row for row in own if row["status"] == "converged"]
        seconds = np.quantile([row["seconds"] for row in own], [0.5, 0.9])
        above = np.array([row["sent"] / row["least"] - 1.0 for row in good])
        worst = max(((v, kind, row["seed"]) for row in good for kind, v in row["violations"].items()))
        is_good &= worst[0] <= TOLERANCE and (options.torques or above.min() >= 0.0)
        print(
            f"| {name} | {len(own)} | {len(good)} | {np.median([row['iterations'] for row in own]):.0f} "
            f"| {seconds[0]:.2f}, {seconds[1]:.2f} | {above.min():.2%}, {np.median(above):.2%}, "
            f"{np.quantile(above, 0.9):.2%}, {above.max():.2%}, {np.mean(above <= _NEAR):.0%} "
            f"| {worst[0]:.1e} ({worst[1]}, {worst[2]}) |"
        )
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())

"""Random valid problems, solved and verified: `python -m tests.campaign`."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from tests.campaign.classes import CLASSES
from tests.campaign.run import plan, read_rows, run, run_task
from tests.campaign.table import false_converged, show, worst


def main(arguments: Sequence[str] | None = None) -> int:
    """Run, resume or only show a campaign; 1 if something converged that is not."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaign", description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="tasks over all classes")
    parser.add_argument("--first", type=int, default=0, help="number of the first seed of each class")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("-o", "--out", type=Path, default=Path("build/campaign.jsonl"), help="rows; resumed")
    parser.add_argument("--classes", nargs="*", default=[], help=f"of {', '.join(CLASSES)}")
    parser.add_argument("--task", metavar="CLASS:SEED", help="solve one and print its row")
    parser.add_argument("--show", action="store_true", help="only print the table of the rows there are")
    parser.add_argument("--by", choices=("class", "family"), default="class")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        if options.task:
            name, seed = options.task.split(":")
            print(json.dumps(run_task(name, int(seed), Path(folder)), indent=1))
            return 0
        if not options.show:
            _follow(options, Path(folder))
    rows = read_rows(options.out)
    print(show(rows, options.by), "", worst(rows), "", sep="\n")
    wrong = false_converged(rows)
    for row in wrong:
        print(f"FALSE: {row['class']}:{row['seed']} {row.get('failures') or 'infeasible'}")
    failed = [r for r in rows if r["feasible"] and r["status"] not in ("converged", "under_resolved")]
    for row in failed:
        print(f"{row['status']}: {row['class']}:{row['seed']} {row.get('advice', '').splitlines()[-1:]}")
    return 1 if wrong or any(r["status"] == "crash" for r in rows) else 0


def _follow(options: argparse.Namespace, folder: Path) -> None:
    tasks, clock = plan(options.count, options.classes, options.first), time.perf_counter()
    for k, row in enumerate(run(tasks, options.out, folder, options.workers), start=1):
        note, seconds = " FALSE" if false_converged([row]) else "", time.perf_counter() - clock
        words = f"{k:5d} {seconds:7.1f} s  {row['class']}:{row['seed']} {row['status']}{note}"
        print(words, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())

"""Throw inputs, or replay one: `python -m tests.attack --help`."""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from random import Random

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy: the processes are forked, one for a processor


def main() -> int:
    """Return 0 if there is no finding, 1 if there is one."""
    options = _options()
    with tempfile.TemporaryDirectory(prefix="attack-cache-") as cache:
        os.environ.setdefault("MBOCP_CACHE_DIR", cache)
        if options.seed is not None:
            return _replay(options.kind[0], options.seed, options.save)
        return _attack(options)


def _options() -> argparse.Namespace:
    from .cases import KINDS

    parser = argparse.ArgumentParser(prog="python -m tests.attack", description=__doc__)
    parser.add_argument("--count", type=int, default=2000, help="inputs in all")
    parser.add_argument("--kind", action="append", choices=list(KINDS), help="only these kinds; repeatable")
    parser.add_argument("--first", type=int, default=0, help="number of the first seed")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--seed", type=int, help="replay the input of this number, of one --kind")
    parser.add_argument("--save", type=Path, help="with --seed: leave the input's files in this folder")
    parser.add_argument("--log", type=Path, help="write every finding into this file, JSON lines")
    parser.add_argument("--short", action="store_true", help="few of the kinds that take long")
    parser.add_argument("--guided", type=int, default=0, metavar="PERCENT", help="share guided by coverage")
    parser.add_argument("--quiet", action="store_true", help="the table and the findings alone")
    options = parser.parse_args()
    if options.seed is not None and len(options.kind or ()) != 1:
        parser.error("--seed: say with --kind of which kind")
    return options


def _attack(options: argparse.Namespace) -> int:
    from .cases import KINDS
    from .guided import guided
    from .report import Tally, shares
    from .runner import attack

    tally, begun = Tally(), time.monotonic()
    counts = shares(
        options.count - options.count * options.guided // 100, options.kind or KINDS, short=options.short
    )
    log = options.log.open("w") if options.log else None
    for outcome in attack(_inputs(counts, options.first), options.processes):
        tally.add(outcome)
        if outcome.is_finding and log:
            log.write(json.dumps(asdict(outcome)) + "\n")
            log.flush()
        if not options.quiet and tally.thrown % 1000 == 0:
            seconds = time.monotonic() - begun
            print(
                f"{tally.thrown} thrown, {tally.lost} findings, {seconds:.0f} s", file=sys.stderr, flush=True
            )
    if options.guided:
        wanted = options.count * options.guided // 100
        for outcome in guided(wanted, options.processes, seed=options.first + 1):
            tally.add(outcome)
    print(tally.table(time.monotonic() - begun))
    if tally.lost:
        print("\n" + tally.list_findings())
    return 1 if tally.lost else 0


def _inputs(counts: dict[str, int], first: int) -> Iterator[tuple[str, int]]:
    """All inputs, the kinds mixed, so that the processes always have something to do."""
    found = [(kind, first + i) for kind, count in counts.items() for i in range(count)]
    Random(0).shuffle(found)
    return iter(found)


def _replay(kind: str, seed: int, save: Path | None) -> int:
    from .cases import make_case
    from .runner import attack
    from .targets import TARGETS

    case = make_case(kind, seed)
    print(f"{case.entry}; loads {case.main}; {' '.join(case.arguments)}")
    for name, data in case.files.items():
        if data != case.originals[name]:
            print(f"--- {name} ({len(data)} bytes)\n{data[:3000].decode(errors='replace')}\n---")
    if save is not None:
        save.mkdir(parents=True, exist_ok=True)
        case.write(save)
    (outcome,) = attack(iter([(kind, seed)]), 1)
    print(f"{outcome.verdict}: {outcome.where}\n{outcome.text}")
    print(f"{outcome.seconds:.2f} s, {outcome.peak / 1e6:.0f} MB")
    if outcome.verdict == "traceback":  # once more in this process, for its lines
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            TARGETS[kind](case, case.write(Path(folder)))
    return 1 if outcome.is_finding else 0


sys.exit(main())

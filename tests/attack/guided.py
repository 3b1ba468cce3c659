"""Runs of coverage.py, one process for each kind, and what came of them."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from .coverage import GUIDED
from .runner import Outcome

__all__ = ["guided"]

_MISSING = 3  # exit status of coverage.py without atheris
_COVERED = re.compile(r"^#\d+\s.*?\bcov: (\d+)", re.MULTILINE)
_LOG = Path("attack-coverage")
_NOTHING = "atheris threw nothing"
_SEARCHES, _NEXT = 5, 1_000_000  # of a kind that are begun, and from one's seed to the next


def guided(count: int, processes: int, log: Path = _LOG, seed: int = 1) -> Iterator[Outcome]:
    """Outcomes of `count` inputs that coverage guides; none, with a word, if atheris is missing.

    Says on stderr of each kind from how many edges of mbocp's code to how many the inputs came.
    """
    each = count // len(GUIDED)
    with ThreadPoolExecutor(processes) as pool:
        for outcomes in pool.map(lambda kind: _run(kind, each, log, seed), GUIDED):
            yield from outcomes


def _run(kind: str, count: int, folder: Path, seed: int) -> list[Outcome]:
    """What came of every input; a search that an input ends begins anew with another seed."""
    found: list[Outcome] = []
    for further in range(_SEARCHES):
        found += _search(kind, count - len(found), folder, seed + further * _NEXT)
        if not found or found[-1].where == _NOTHING or len(found) >= count:
            break
    return found


def _search(kind: str, count: int, folder: Path, seed: int) -> list[Outcome]:
    """What came of the inputs of one process."""
    folder.mkdir(exist_ok=True)
    log = Path(tempfile.mkdtemp(prefix=f"{kind}-", dir=folder))
    command = [sys.executable, "-m", "tests.attack.coverage", "--kind", kind]
    done = subprocess.run(
        [*command, "--count", str(count), "--seed", str(seed), "--log", str(log)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        check=False,
    )
    if done.returncode == _MISSING:
        print(f"{kind}: not guided, since {done.stdout.strip()}", file=sys.stderr)
        return []
    lines = (log / f"{kind}.jsonl").read_text().splitlines() if (log / f"{kind}.jsonl").exists() else []
    found = [_outcome(kind, json.loads(line)) for line in lines]
    if done.returncode != 0:
        left = ", ".join(str(path) for path in log.glob(f"{kind}-crash-*")) or "no input"
        told = f"exit {done.returncode}, left {left}"
        found.append(Outcome(f"{kind}, guided", 0, "crash", told, done.stdout[-500:]))
    if not lines:
        found.append(Outcome(f"{kind}, guided", 0, "crash", _NOTHING, done.stdout[-500:]))
    covered = [int(number) for number in _COVERED.findall(done.stdout)]
    if covered:
        print(f"{kind}: {len(lines)} inputs, {covered[0]} to {covered[-1]} edges", file=sys.stderr)
    return found


def _outcome(kind: str, line: dict[str, Any]) -> Outcome:
    """One input; a finding says where its file is."""
    kept = line.pop("input")
    outcome = Outcome(**line)
    outcome.kind = f"{kind}, guided"
    if kept:
        outcome.where = f"{outcome.where} in {kept}"
    return outcome

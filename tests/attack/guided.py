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

from .coverage import GUIDED
from .runner import Outcome

__all__ = ["guided"]

_MISSING = 3  # exit status of coverage.py without atheris
_RUNS = re.compile(r"stat::number_of_executed_units: (\d+)")
_LAST = re.compile(r"^#(\d+)", re.MULTILINE)
_LOG = Path("attack-coverage")


def guided(count: int, processes: int) -> Iterator[Outcome]:
    """Outcomes of `count` inputs that coverage guides; none, with a word, if atheris is missing.

    What was no finding is told as "accepted": how many of them were refused is not known.
    """
    each = count // len(GUIDED)
    with ThreadPoolExecutor(processes) as pool:
        for kind, (runs, findings) in zip(GUIDED, pool.map(lambda k: _run(k, each), GUIDED), strict=True):
            yield from findings
            yield from (
                Outcome(f"{kind}, guided", i, "accepted") for i in range(max(0, runs - len(findings)))
            )


def _run(kind: str, count: int) -> tuple[int, list[Outcome]]:
    """Inputs thrown, and findings."""
    _LOG.mkdir(exist_ok=True)
    log = Path(tempfile.mkdtemp(prefix=f"{kind}-", dir=_LOG))
    command = [sys.executable, "-m", "tests.attack.coverage", "--kind", kind]
    done = subprocess.run(
        [*command, "--count", str(count), "--log", str(log)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        check=False,
    )
    if done.returncode == _MISSING:
        print(f"{kind}: not guided, since {done.stdout.strip()}", file=sys.stderr)
        return 0, []
    name, lines = f"{kind}, guided", (log / f"{kind}.jsonl").read_text().splitlines()
    findings = [
        Outcome(name, found["seed"], found["verdict"], f"{found['where']} in {found['input']}", found["text"])
        for found in map(json.loads, lines)
    ]
    if done.returncode != 0:
        left = ", ".join(str(path) for path in log.glob(f"{kind}-crash-*")) or "no input"
        findings.append(Outcome(name, 0, "crash", f"exit {done.returncode}, left {left}", done.stdout[-500:]))
    runs = _RUNS.search(done.stdout) or [*_LAST.finditer(done.stdout), None][-2]
    return int(runs[1]) if runs else 0, findings

"""What was thrown and what was lost, as a table, and the findings, each kind of them once."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from .cases import KINDS
from .runner import LIMITS, Outcome

__all__ = ["Tally", "shares"]

_SHORT = {"solve": 0.2, "command": 0.2, "mesh": 0.5}
_EXAMPLES = 3  # seeds of a finding that are named


class Tally:
    """Counts of outcomes; findings are kept, the others only as numbers."""

    def __init__(self) -> None:
        self.verdicts: dict[str, Counter[str]] = defaultdict(Counter)
        self.seconds: dict[str, list[float]] = defaultdict(list)
        self.peaks: dict[str, int] = defaultdict(int)
        self.findings: dict[tuple[str, str, str], list[Outcome]] = defaultdict(list)

    def add(self, outcome: Outcome) -> None:
        """Count one."""
        self.verdicts[outcome.kind][outcome.verdict] += 1
        self.seconds[outcome.kind].append(outcome.seconds)
        self.peaks[outcome.kind] = max(self.peaks[outcome.kind], outcome.peak)
        if outcome.is_finding:
            self.findings[outcome.kind, outcome.verdict, outcome.where].append(outcome)

    @property
    def thrown(self) -> int:
        """Number of inputs."""
        return sum(sum(counts.values()) for counts in self.verdicts.values())

    @property
    def lost(self) -> int:
        """Number of findings."""
        return sum(len(found) for found in self.findings.values())

    def table(self, seconds: float) -> str:
        """What became of each kind of input, in Markdown."""
        rows = [_row(kind, self) for kind in sorted(self.verdicts, key=_order)]
        counts = [sum(self.verdicts[k][v] for k in self.verdicts) for v in ("accepted", "refused")]
        rows.append(("all", self.thrown, *counts, self.lost, "", "", ""))
        seconds_each = f"{LIMITS.cpu:g} s ({LIMITS.patience * LIMITS.cpu:g} s if it is solved)"
        limits = f"{seconds_each}, {LIMITS.memory >> 20} MB, {LIMITS.message} letters"
        return "\n".join(
            (
                "| input | thrown | a result | refused | findings | ms, median | ms, longest | MB, most |",
                "|---|---:|---:|---:|---:|---:|---:|---:|",
                *("| " + " | ".join(str(word) for word in row) + " |" for row in rows),
                "",
                f"{self.thrown} inputs in {seconds:.0f} s; each within {limits} of a message.",
            )
        )

    def list_findings(self) -> str:
        """A line or two on each kind of finding, the most frequent first, and how to replay it."""
        lines: list[str] = []
        for (kind, verdict, where), found in sorted(self.findings.items(), key=lambda item: -len(item[1])):
            seeds = ", ".join(str(outcome.seed) for outcome in found[:_EXAMPLES])
            lines.append(f"{len(found)} x {kind}: {verdict}: {where}")
            lines.append(f"    {_line(found[0].text)}")
            lines.append(f"    python -m tests.attack --kind {kind} --seed {found[0].seed}   (seeds {seeds})")
        return "\n".join(lines)


def _line(text: str) -> str:
    return " ".join(text.split())[:240]


def _row(kind: str, tally: Tally) -> Sequence[object]:
    counts, seconds = tally.verdicts[kind], np.array(tally.seconds[kind])
    lost = sum(len(found) for (name, _, _), found in tally.findings.items() if name == kind)
    times = (f"{1e3 * np.median(seconds):.0f}", f"{1e3 * seconds.max():.0f}", tally.peaks[kind] >> 20)
    return (f"`{kind}`", sum(counts.values()), counts["accepted"], counts["refused"], lost, *times)


def shares(count: int, kinds: Iterable[str], *, short: bool = False) -> dict[str, int]:
    """How many inputs of each kind make up `count`; in the short form few of those that take long."""
    weights = {kind: KINDS[kind] * (_SHORT.get(kind, 1.0) if short else 1.0) for kind in kinds}
    total = sum(weights.values())
    found = {kind: int(count * weight / total) for kind, weight in weights.items()}
    found[next(iter(found))] += count - sum(found.values())
    return found


def _order(kind: str) -> tuple[bool, int]:
    """Kinds as they are listed, then those that were guided."""
    name, guided, _ = kind.partition(",")
    return bool(guided), list(KINDS).index(name)

"""The progress table, on a terminal and in a log."""

from __future__ import annotations

import io

from rich.console import Console

from mbocp.cli.progress import Progress
from mbocp.solution import IterationRecord


def _drive(console: Console, count: int, *, quiet: bool = False) -> None:
    with Progress("arm", quiet=quiet, console=console) as progress:
        progress.say("loading the robot")
        for k in range(count):
            progress(IterationRecord(k, residual=10.0**-k, cost=float(k)))


def test_plain_lines_in_a_log() -> None:
    out = io.StringIO()
    _drive(Console(file=out, width=100), 45)
    lines = out.getvalue().splitlines()
    assert lines[0].split() == ["iteration", "cost", "residual", "increment", "step", "time"]
    assert lines[1].split()[:5] == ["0", "0", "1.00e+00", "-", "-"]
    assert [int(line.split()[0]) for line in lines[1:]] == [*range(20), 29, 39, 44]


def test_live_on_a_terminal_leaves_the_last_iterations() -> None:
    out = io.StringIO()
    _drive(Console(file=out, width=100, force_terminal=True), 30)
    text = out.getvalue()
    assert "loading the robot" in text
    tail = text[text.rindex("iteration") :]
    assert "... 18 more" in tail
    assert "1.00e-29" in tail


def test_quiet() -> None:
    out = io.StringIO()
    _drive(Console(file=out, width=100, force_terminal=True), 3, quiet=True)
    assert out.getvalue() == ""

"""The progress table, on a terminal and in a log."""

from __future__ import annotations

import io
import re
import time

import pytest
from rich.console import Console

from mbocp.cli.progress_table import ProgressCallback
from mbocp.solution import IterationRecord


def _drive(console: Console, count: int, *, quiet: bool = False) -> None:
    """One run without a name, as of a solver that has no phases."""
    with ProgressCallback("arm", quiet=quiet, console=console) as progress:
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


@pytest.mark.parametrize("width", [40, 50, 60, 67, 68, 80])
def test_narrow_terminals_have_fewer_columns(width: int) -> None:
    out = io.StringIO()
    _drive(Console(file=out, width=width, force_terminal=True), 30)
    text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", out.getvalue()).replace("\r", "")
    names, *rows = text[text.rindex("iteration") :].splitlines()
    assert names.split()[:3] == ["iteration", "cost", "residual"]
    assert ("increment" in names) == (width >= 68)
    assert ("time" in names) == (width >= 47)
    assert len(rows) == 13  # none is folded
    assert all(len(row.rstrip()) <= width for row in (names, *rows))
    assert rows[-1].split()[:3] == ["29", "29", "1.00e-29"]


def test_quiet() -> None:
    out = io.StringIO()
    _drive(Console(file=out, width=100, force_terminal=True), 3, quiet=True)
    assert out.getvalue() == ""


def _drive_phases(console: Console) -> None:
    """A hybrid that begins with a gradient method, and a second run of the same name."""
    with ProgressCallback("arm", console=console) as progress:
        for phase, first, count in (("fbsm_bb", 0, 30), ("monolithic", 30, 3), ("monolithic", 33, 2)):
            for k in range(count + 1):
                length = float("nan") if k == 0 else 1.0
                progress(IterationRecord(first + k, residual=1.0, step_length=length, phase=phase))


def test_phases_are_apart_in_a_log() -> None:
    out = io.StringIO()
    _drive_phases(Console(file=out, width=100))
    lines = [line.split() for line in out.getvalue().splitlines()]
    assert [line[0] for line in lines if len(line) == 1] == ["fbsm_bb", "monolithic", "monolithic"]
    newton = lines.index(["monolithic"])
    assert [int(line[0]) for line in lines[2:newton]] == [*range(20), 29, 30]  # its last one, too
    assert [int(line[0]) for line in lines[newton + 1 : newton + 5]] == [30, 31, 32, 33]
    assert [int(line[0]) for line in lines[-3:]] == [33, 34, 35]


def test_long_phases_thin_out_in_a_log() -> None:
    out = io.StringIO()
    _drive(Console(file=out, width=100), 1234)
    shown = [int(line.split()[0]) for line in out.getvalue().splitlines()[1:]]
    assert shown == [*range(20), *range(29, 200, 10), *range(299, 1234, 100), 1233]


def test_phases_are_apart_on_a_terminal() -> None:
    out = io.StringIO()
    _drive_phases(Console(file=out, width=80, force_terminal=True, no_color=True, highlight=False))
    text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", out.getvalue())
    lines = text[text.rindex("iteration ") :].replace("\r", "").splitlines()
    heads = [i for i, line in enumerate(lines) if line.strip() in ("fbsm_bb", "monolithic")]
    assert [lines[i].strip() for i in heads] == ["fbsm_bb", "monolithic", "monolithic"]
    gradient = [line.split() for line in lines[heads[0] + 1 : heads[1]]]
    assert [row[0] for row in gradient] == ["0", "...", "30"]  # where it began and where it came to
    assert gradient[1] == ["...", "29", "more"]
    last = [line.split()[0] for line in lines[heads[2] + 1 :] if line.strip()]
    assert last == ["33", "34", "35"]
    assert max(map(len, lines)) <= 80


def _switch(progress: ProgressCallback, switches: int) -> None:
    """Drive an interior-point method that goes into its restoration and back all the time, two rows each."""
    for n in range(switches):
        phase = "ipopt (restoration)" if n % 2 else "ipopt"
        for k in range(2):
            progress(IterationRecord(2 * n + k, residual=1.0, step_length=1.0, phase=phase))


def _lines(text: str) -> list[str]:
    plain = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text).replace("\r", "")
    return [line for line in plain.splitlines() if line.strip()]


def test_pictures_do_not_grow_with_the_phases(monkeypatch: pytest.MonkeyPatch) -> None:
    out, pictures = io.StringIO(), []
    draw = ProgressCallback._picture
    monkeypatch.setattr(ProgressCallback, "_picture", lambda self: pictures.append(0) or draw(self))
    console = Console(file=out, width=80, height=40, force_terminal=True)
    clock = time.perf_counter()
    with ProgressCallback("arm", console=console) as progress:
        _switch(progress, 1000)
        assert len(console.render_lines(draw(progress))) <= console.height
    pace = 4.0 * (time.perf_counter() - clock)  # pictures a second, whatever comes in
    assert len(pictures) <= pace + 4
    assert len(_lines(out.getvalue())) <= (len(pictures) + 1) * console.height + 80


@pytest.mark.parametrize("height", [10, 24, 60])
def test_the_picture_fits_the_terminal_and_shows_the_phase_at_work(height: int) -> None:
    console = Console(file=io.StringIO(), width=80, height=height, force_terminal=True)
    with ProgressCallback("arm", console=console) as progress:
        _switch(progress, 50)
        for k in range(100, 130):
            progress(IterationRecord(k, residual=1.0, step_length=1.0, phase="ipopt"))
        lines = ["".join(part.text for part in line) for line in console.render_lines(progress._picture())]
    assert len(lines) <= height
    assert lines[-1].split()[-1] == "ipopt"  # the spinner's
    assert lines[-2].split()[0] == "129"


def test_many_phases_end_in_a_short_table() -> None:
    out = io.StringIO()
    with ProgressCallback("arm", console=Console(file=out, width=80, force_terminal=True)) as progress:
        _switch(progress, 300)
    text = out.getvalue()
    lines = _lines(text[text.rindex("iteration ") :])
    assert "... 284 phases with 568 rows more" in lines
    assert len(lines) < 70
    assert lines[-1].split()[0] == "599"


def test_many_phases_thin_out_in_a_log() -> None:
    out = io.StringIO()
    with ProgressCallback("arm", console=Console(file=out, width=80)) as progress:
        _switch(progress, 300)
    lines = _lines(out.getvalue())
    assert len(lines) < 200
    assert "... 99 phases more" in lines
    assert lines[-1].split()[0] == "599"


def test_the_clock_of_the_table_begins_with_the_solver() -> None:
    out = io.StringIO()
    with ProgressCallback("arm", console=Console(file=out, width=80)) as progress:
        time.sleep(0.05)  # [s] imports, compiling
        progress(IterationRecord(0, residual=1.0))
    assert _lines(out.getvalue())[-1].endswith("0.00 s")

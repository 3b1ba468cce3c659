"""Ctrl-C, SIGTERM and closed pipes at any moment: the right exit status, and never a traceback."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mbocp._processes import signal_handler, signals_wait
from mbocp.solution import Solution, Status

from .conftest import ARM, FakeSolver, Run

EXAMPLES = Path(__file__).parents[2] / "examples"
# It says when the handlers stand: before, in Python's own start, a signal is Python's business.
RUN = """
import os
from mbocp.cli import main, signals
leave_at_once = signals.leave_at_once
def told():
    leave_at_once()
    os.write(1, b">")
signals.leave_at_once = told
main()
"""


def _start(*arguments: str, program: tuple[str, ...] = ("-c", RUN), cwd: Path) -> subprocess.Popen[str]:
    """Run the command line as from a terminal: in a shell's background Ctrl-C is ignored."""
    return subprocess.Popen(
        [sys.executable, *program, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def _interrupted(number: signal.Signals, delay: float, folder: Path) -> tuple[int, str]:
    process = _start("solve", "arm.toml", "-q", "-o", "arm.h5", cwd=folder)
    assert process.stdout is not None
    assert process.stdout.read(1) == ">"
    time.sleep(delay)
    process.send_signal(number)
    _, errors = process.communicate(timeout=100)
    return process.returncode, errors


# [s] first typer is imported, then NumPy, CasADi and Pinocchio; at last the robot is loaded.
_DELAYS = (0.0, 0.01, 0.05, 0.1, 0.3, 0.6)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_at_any_moment(tmp_path: Path, number: signal.Signals) -> None:
    (tmp_path / "arm.toml").write_text(ARM)
    for delay in _DELAYS if number is signal.SIGINT else _DELAYS[::3]:
        status, errors = _interrupted(number, delay, tmp_path)
        if status in (0, -signal.SIGTERM):  # it was done; or SIGTERM came before the handlers stood
            assert not errors
        else:
            assert status == 128 + number, (delay, errors)
            assert errors == "interrupted: stopped before there was a result\n", delay


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_for_the_end_of_a_block(number: int) -> None:
    """Native modules begin in such blocks: broken off there, they end the process."""
    heard, done = [], []
    with signal_handler(number, lambda number, frame: heard.append(number)):
        with signals_wait():
            signal.raise_signal(number)
            assert not heard
            done.append(number)
        assert heard == done == [number]


@pytest.mark.slow
def test_a_signal_at_hundreds_of_moments(tmp_path: Path) -> None:
    (tmp_path / "arm.toml").write_text(ARM)
    for number in (signal.SIGINT, signal.SIGTERM):
        for k in range(100):
            status, errors = _interrupted(number, 0.002 + 0.02 * k, tmp_path)
            # The last: all was done, and the interpreter gives its handlers back before it ends.
            assert status in (128 + number, 0, -number), (k, errors)
            assert "Traceback" not in errors
            assert "ignored" not in errors


SLOW_SOLVE = """
import os, signal, sys, threading
import mbocp
from mbocp.cli import main
real, number, waits = mbocp.solve, getattr(signal, sys.argv.pop(1)), []
def solve(problem, callback, accuracy):
    def count(record):
        callback(record)
        waits.append(record)
        if len(waits) == 4:
            os.kill(os.getpid(), number)
    return real(problem, callback=count)
mbocp.solve = solve
main()
"""


@pytest.mark.parametrize(("name", "method"), [("SIGINT", "ipopt"), ("SIGTERM", "monolithic")])
def test_a_signal_in_the_solver_keeps_the_best_iterate(tmp_path: Path, name: str, method: str) -> None:
    file, result = EXAMPLES / "paper" / "rigid_pendulum.toml", tmp_path / "a.h5"
    arguments = (name, "solve", str(file), "--solver", method, "--set", "horizon.steps=20", "-o", str(result))
    process = _start(*arguments, program=("-c", SLOW_SOLVE), cwd=tmp_path)
    out, errors = process.communicate(timeout=100)
    assert process.returncode == 128 + getattr(signal, name), errors
    assert "Traceback" not in errors
    assert "interrupted" in out
    assert Solution.load(result).status is Status.INTERRUPTED


ENDLESS = """
robot = "double_pendulum"
horizon = { duration = 1.0, steps = 10 }
goal = { q = [1.0, 0.5], v = 0 }
cost = { effort = 1e-9, velocity = 0.1 }
solver = { method = "fatrop" }
limits = { power = 1e-300 }
"""
LATE = """
import os, signal, sys, threading
import mbocp
from mbocp.cli import main
real = mbocp.solve
def solve(problem, callback, accuracy):
    def press_later(record):
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGTERM)).start()
    return real(problem, callback=press_later)
mbocp.solve = solve
main()
"""


def test_sigterm_ends_a_solver_that_asks_for_nothing(tmp_path: Path) -> None:
    (tmp_path / "endless.toml").write_text(ENDLESS)
    process = _start("solve", "endless.toml", "-o", "a.h5", program=("-c", LATE), cwd=tmp_path)
    out, errors = process.communicate(timeout=100)
    assert process.returncode == 128 + signal.SIGTERM, errors
    assert "Traceback" not in errors
    assert "interrupted after 0 iterations" in " ".join(out.split())
    assert Solution.load(tmp_path / "a.h5").status is Status.INTERRUPTED


def test_interrupted_is_130_with_a_result(folder: Path, run: Run, solver: FakeSolver) -> None:
    solver.status = Status.INTERRUPTED
    assert run("solve", "arm.toml", "-o", "a.h5").exit_code == 130
    assert Solution.load(folder / "a.h5").status is Status.INTERRUPTED


@pytest.mark.parametrize("arguments", [("robots",), ("robots", "ur5"), ("robots", "--json"), ("--help",)])
def test_a_reader_that_goes_away(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    reader, writer = os.pipe()
    command = [sys.executable, "-m", "mbocp", *arguments]
    process = subprocess.Popen(command, stdout=writer, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    os.close(writer)
    os.close(reader)
    _, errors = process.communicate(timeout=100)
    assert process.returncode in (141, -signal.SIGPIPE), errors  # a shell says 141 for both
    assert errors == ""


def test_python_m_mbocp(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "mbocp", "--version"], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    assert done.stdout.startswith("mbocp ")


def test_handlers_stand_before_anything_takes_time(tmp_path: Path) -> None:
    """What is imported before them is part of Python's own start, or a module of a few lines."""
    code = (
        "import sys, signal; before = set(sys.modules)\n"
        "signal.signal = lambda *_: (print(*sorted(set(sys.modules) - before)), sys.exit())\n"
        "from mbocp.cli import main; main()"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=True
    )
    found = set(done.stdout.split())
    assert {name for name in found if name.startswith("mbocp")} == {"mbocp", "mbocp.cli", "mbocp.cli.signals"}
    assert not found & {"typing", "typer", "numpy", "rich", "pathlib"}


WHERE_NOTHING_CAN_BE_RAISED = """
import os, signal, time
from mbocp.cli.signals import leave_at_once, leave_in_order, status_of_signal
class Dies:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
leave_at_once()
leave_in_order()
one = Dies()
try:
    del one
    time.sleep(60.0)
except KeyboardInterrupt:
    print("caught", status_of_signal())
"""


def test_a_signal_where_nothing_can_be_raised_comes_back() -> None:
    """As in a finalizer: the interpreter would print what was raised there, and go on."""
    done = subprocess.run(
        [sys.executable, "-c", WHERE_NOTHING_CAN_BE_RAISED], capture_output=True, text=True, timeout=30.0
    )
    assert (done.stdout, done.stderr) == (f"caught {128 + signal.SIGTERM}\n", "")

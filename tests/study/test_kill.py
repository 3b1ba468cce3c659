"""Processes killed at random moments: no row is lost, none is written twice, nobody is left behind."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from mbocp.cli.app import app
from mbocp.study import Study, StudyResult, run_study

from .conftest import EXAMPLES

# As from a terminal: what runs in a shell's background inherits that Ctrl-C is ignored.
RUN = """import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from mbocp.cli import main
main()"""
MBOCP = [sys.executable, "-c", RUN, "study"]
PATIENCE = 60.0  # [s] for what takes a second or two


def write_study(folder: Path, tasks: int) -> Path:
    file = folder / "goals.toml"
    file.write_text(
        f'problem = "{EXAMPLES}/paper/rigid_pendulum.toml"\n'
        f'[sample]\ncount = {tasks}\n"start.p" = {{ uniform = [[0, 5, -5], [0, 15, 5]] }}\n'
    )
    return file


def start(file: Path, rows: Path) -> subprocess.Popen[str]:
    command = [*MBOCP, str(file), "-o", str(rows), "--resume", "--workers", "2", "--quiet"]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)


def count(rows: Path) -> int:
    return max(rows.read_bytes().count(b"\n") - 1, 0) if rows.exists() else 0


def wait_for(rows: Path, number: int, process: subprocess.Popen[str]) -> None:
    """Wait until there are so many rows, or the process is done."""
    end = time.monotonic() + PATIENCE
    while count(rows) < number and process.poll() is None:
        assert time.monotonic() < end
        time.sleep(0.005)


def descendants(pid: int) -> Iterator[tuple[int, int]]:
    """Processes below `pid` that live, and how deep."""
    table: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            state, parent = _state(int(entry.name))
            if state not in ("Z", "X", ""):
                table.setdefault(parent, []).append(int(entry.name))
    found = [(child, 1) for child in table.get(pid, [])]
    for child, depth in found:
        found += [(grandchild, depth + 1) for grandchild in table.get(child, [])]
    return iter(found)


def _state(pid: int) -> tuple[str, int]:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return "", 0
    return fields[0], int(fields[1])


def workers(pid: int) -> list[int]:
    """Processes that solve: children of the server process."""
    return [child for child, depth in descendants(pid) if depth == 2]


def rows_of(rows: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in rows.read_text().splitlines()[1:]]


def some_workers(process: subprocess.Popen[str]) -> list[int]:
    """Workers of a study, waited for: one that resumes has its rows before it has any."""
    end = time.monotonic() + PATIENCE
    while not (found := workers(process.pid)):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end, "a study has no workers"
        time.sleep(0.01)
    return found


def kill_and_resume(folder: Path, tasks: int, main_kills: int, worker_kills: int, seed: int) -> list[str]:
    """Run a study to its end through deaths at random moments; statuses of its rows."""
    generator = random.Random(seed)
    file, rows = write_study(folder, tasks), folder / "rows.jsonl"
    moments = sorted(generator.sample(range(2, tasks - 4), main_kills + worker_kills))
    kinds = ["main"] * main_kills + ["worker"] * worker_kills
    generator.shuffle(kinds)
    process = start(file, rows)
    for moment, kind in zip(moments, kinds, strict=True):
        wait_for(rows, moment, process)
        time.sleep(0.05 * generator.random())
        assert process.poll() is None, process.communicate()
        if kind == "worker":
            os.kill(generator.choice(some_workers(process)), signal.SIGKILL)
            continue
        family = [child for child, _ in descendants(process.pid)]
        before = rows.read_bytes()
        process.kill()
        process.communicate()
        end = time.monotonic() + PATIENCE
        while any(_state(child)[0] not in ("Z", "X", "") for child in family):
            assert time.monotonic() < end, "a process was left behind"
            time.sleep(0.01)
        assert rows.read_bytes().startswith(before)
        process = start(file, rows)
    _, errors = process.communicate(timeout=PATIENCE + tasks)
    found = rows_of(rows)
    has_crashed = any(row["status"] == "crashed" for row in found)
    assert process.returncode == int(has_crashed), errors
    assert sorted(row["index"] for row in found) == list(range(tasks))
    assert len(StudyResult.load(rows)) == tasks
    return [row["status"] for row in found]


def test_deaths_lose_nothing(tmp_path: Path) -> None:
    statuses = kill_and_resume(tmp_path, tasks=24, main_kills=1, worker_kills=2, seed=1)
    assert statuses.count("converged") + statuses.count("crashed") == 24
    assert statuses.count("crashed") <= 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_many_deaths_lose_nothing(tmp_path: Path, seed: int) -> None:
    statuses = kill_and_resume(tmp_path, tasks=200, main_kills=5, worker_kills=8, seed=seed)
    assert statuses.count("converged") + statuses.count("crashed") == 200
    assert statuses.count("crashed") <= 8


CTRL_C_TASKS = 50  # more than are solved between two looks at the file
LASTING_TASKS = 1000  # more than are solved while a second process begins and ends


def test_ctrl_c_says_how_to_go_on(tmp_path: Path) -> None:
    """Ctrl-C reaches all processes of the terminal's group at once."""
    file, rows = write_study(tmp_path, CTRL_C_TASKS), tmp_path / "rows.jsonl"
    process = start(file, rows)
    wait_for(rows, 5, process)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130
    done = count(rows)
    assert 5 <= done < CTRL_C_TASKS
    told = f"mbocp study {file} -o {rows} --resume --workers 2"
    assert errors.splitlines() == [
        f"interrupted: {done} of {CTRL_C_TASKS} tasks are in {rows}; go on with",
        f"  {told}",
    ]
    with ThreadPoolExecutor(1) as executor:
        assert run_study(Study.load(file), rows, resume=True, executor=executor).is_complete
    assert sorted(row["index"] for row in rows_of(rows)) == list(range(CTRL_C_TASKS))


def test_two_at_once_are_refused(tmp_path: Path) -> None:
    file, rows = write_study(tmp_path, LASTING_TASKS), tmp_path / "rows.jsonl"
    first = start(file, rows)
    wait_for(rows, 1, first)
    second = CliRunner().invoke(app, ["study", str(file), "-o", str(rows), "--resume"])
    assert second.exit_code == 2
    assert "another process is writing it" in second.stderr
    wait_for(rows, count(rows) + 5, first)
    assert first.poll() is None
    os.killpg(first.pid, signal.SIGINT)
    first.communicate(timeout=PATIENCE)
    indices = [row["index"] for row in rows_of(rows)]
    assert len(set(indices)) == len(indices) < LASTING_TASKS

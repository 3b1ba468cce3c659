"""Transcripts on pages are of commands that run, and that print what the page says, but for its numbers."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from tests.test_documented_code import DOCS, ROOT, load_tool


@pytest.fixture(scope="module")
def transcripts() -> ModuleType:
    return load_tool("transcripts")


def mbocp(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    program, *words = shlex.split(command)
    assert program == "mbocp", command
    return subprocess.run(
        [sys.executable, "-m", "mbocp", *words],
        cwd=folder,
        env={**os.environ, "COLUMNS": "100"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )


def test_what_a_step_lacks_is_named(transcripts: ModuleType) -> None:
    page = "A.\n\n    $ mbocp info a.h5 \\\n        --json\n    cost  1.25\n    ...\n    done in 3 s\n\nB.\n"
    (step,) = transcripts.steps_of(page)
    assert step.command == "mbocp info a.h5 --json"
    assert step.missing("cost 1.31\nsteps 7\ndone in 4.5 s") == []
    assert step.missing("cost 1.31\nsteps 7") == ["done in #"]
    assert step.missing("done in 3 s, cost 2") == ["done in #"]  # in their order


@pytest.mark.slow
def test_three_robots(transcripts: ModuleType, tmp_path: Path) -> None:
    transcripts.lay_out_robots(tmp_path)
    steps = [*transcripts.steps_of((DOCS / "three_robots.md").read_text("utf-8"))]
    assert len(steps) > 12
    for step in steps:
        done = mbocp(step.command, tmp_path)
        assert done.returncode == 0, (step.command, done.stdout)
        printed = done.stdout.replace(f"{tmp_path}/", "")
        assert step.missing(printed) == [], (step.command, printed)
    assert (tmp_path / "so101.html").stat().st_size > 1e5


@pytest.mark.slow
def test_explanations(transcripts: ModuleType) -> None:
    steps = [*transcripts.steps_of((DOCS / "getting_started.md").read_text("utf-8"))]
    assert len(steps) == 1
    for step in steps:
        done = mbocp(step.command, ROOT)
        assert step.missing(done.stdout) == [], (step.command, done.stdout)

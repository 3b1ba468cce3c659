"""Output that cannot be written, names that are no UTF-8, variables that say nonsense: a line, or nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from mbocp.cli.app import app
from mbocp.solution import Solution

SWING = """
robot = "double_pendulum"
horizon = { duration = 1.0, steps = 10 }
goal = { q = [1.0, 0.5], v = 0 }
"""
FULL = "/dev/full"
NO_SPACE = "error: No space left on device\n"
pytestmark = pytest.mark.skipif(not Path(FULL).exists(), reason="needs a device that is full")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "swing.toml").write_text(SWING)
    return tmp_path


def run(folder: Path, words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a command of a shell, in which MBOCP is the command line."""
    return subprocess.run(
        words,
        shell=True,
        cwd=folder,
        env={**os.environ, "MBOCP": f"{sys.executable} -m mbocp", **variables},
        capture_output=True,
        text=True,
        errors="surrogateescape",
        check=False,
    )


@pytest.mark.parametrize(
    "words",
    ["solve swing.toml -q --json -o a.h5", "solve no.toml -q --json", "robots", "--help", "--version"],
)
def test_a_full_device_is_one_line(folder: Path, words: str) -> None:
    done = run(folder, f"$MBOCP {words} > {FULL}")
    missing = "error: no.toml" if "no.toml" in words else NO_SPACE
    assert done.stderr.startswith(missing)
    assert len(done.stderr.splitlines()) == 1
    assert done.returncode == 2
    assert (folder / "a.h5").exists() == ("a.h5" in words)


def test_nowhere_to_tell_of_an_error(folder: Path) -> None:
    assert run(folder, f"$MBOCP solve no.toml > {FULL} 2> {FULL}").returncode == 2


def test_closed_streams_are_no_matter(folder: Path) -> None:
    """Nor are they written to files which get their numbers."""
    for closed in (">&- 2>&-", "<&- >&- 2>&-"):
        done = run(folder, f"$MBOCP solve swing.toml -o a.h5 {closed}")
        assert done.returncode == 0
        assert Solution.load(folder / "a.h5").converged
        (folder / "a.h5").unlink()
    assert run(folder, "$MBOCP solve no.toml -o a.h5 >&- 2>&-").returncode == 2


def test_names_that_are_no_utf8(folder: Path) -> None:
    name = os.fsdecode(b"a\xff")
    (folder / name).mkdir()
    (folder / name / f"{name}.toml").write_text(SWING)
    for words in (
        f"solve {name}.toml -q -o {name}.h5",
        f"info {name}.h5",
        f"export {name}.h5 -o {name}.csv",
        f"replay {name}.h5",
        f"solve {name}.h5 -q",
    ):
        done = run(folder / name, f"$MBOCP {words}")
        assert done.returncode == 0, done.stderr
    assert Solution.load(folder / name / f"{name}.h5").problem_name == r"a\udcff"


def test_umlauts_where_the_locale_has_none(folder: Path) -> None:
    (folder / "ä.toml").write_text(SWING)
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    for words in ("solve ä.toml -o ö.h5", "info ö.h5", "export ö.h5 -o ü.csv"):
        done = run(folder, f"$MBOCP {words}", **plain)
        assert done.returncode == 0, done.stderr


def test_a_backend_that_is_none_is_no_matter(folder: Path) -> None:
    done = run(folder, "$MBOCP solve swing.toml -q --plot a.png", MPLBACKEND="nonsense")
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("limit", ["nan", "-1", "inf", "much"])
def test_a_limit_that_is_no_number_is_refused(
    folder: Path, limit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MBOCP_CACHE_LIMIT", limit)
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(folder))
    done = CliRunner().invoke(app, ["solve", str(folder / "swing.toml"), "-q"])
    assert done.exit_code == 2
    assert done.stderr == f"error: MBOCP_CACHE_LIMIT: got {limit!r}, expected a number of megabytes\n"

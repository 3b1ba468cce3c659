"""Each robot has its row: how far it came, and why not farther."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.robot_files import main


def test_rows_say_how_far_robots_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MBOCP_FUNCTIONS", "tapes")  # as `main` does, for this test alone
    file = tmp_path / "robots.csv"
    main(["double_pendulum", "nobody", "--load", "-o", str(file)])
    head, _, loaded, refused = file.read_text(encoding="utf-8").splitlines()
    assert head.startswith("# ")
    assert loaded == "double_pendulum,example-robot-data,2,2,0,yes,,,,"
    assert refused.startswith("nobody,example-robot-data,,,,no,,,,")
    assert "nobody" in refused.rpartition(",,")[2]

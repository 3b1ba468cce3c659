"""`mbocp schema`."""

from __future__ import annotations

import json
from pathlib import Path

from mbocp.problem.file.read_tables import problem_schema

from .conftest import Run


def test_it_writes_the_schema_of_problem_files(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "mbocp.schema.json"
    assert run("schema", "-o", str(file)).stdout == ""
    assert json.loads(file.read_text()) == json.loads(run("schema").stdout) == problem_schema()


def test_it_writes_nothing_else(run: Run, tmp_path: Path) -> None:
    done = run("schema", "-o", str(tmp_path / "mbocp.toml"))
    assert done.exit_code == 2
    assert ".json" in done.stderr

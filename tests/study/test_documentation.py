"""docs/studies.md says what is so."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from mbocp.study import Study
from mbocp.study.run_task import CRASHED, ERROR, FIELDS, TIMEOUT
from mbocp.study.study_schema import StudyTable, SummaryTable
from mbocp.study.table import read_table
from mbocp.study.values import _DRAWS, _RANGES

from .conftest import EXAMPLES

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PAGE = (EXAMPLES.parent / "docs/studies.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    return str(found)


def test_the_study_file_loads() -> None:
    tables = tomllib.loads(block("toml"))
    study = Study.from_tables(tables, source=EXAMPLES / "studies/some.toml")
    assert len(study) == 600
    assert "600 tasks" in PAGE


def test_the_python_example_runs(tmp_path: Path) -> None:
    """With a few tasks of the study that it names: `mbocp study` runs all of them in tests/cli."""
    study = tmp_path / "examples" / "studies" / "pendulum_goals.toml"
    study.parent.mkdir(parents=True)
    few = re.sub(
        r"(?<=linspace = ).*(?= }  # s)", "[0.8, 1.2, 1]", (EXAMPLES / "studies" / study.name).read_text()
    )
    study.write_text(few.replace('"../', f'"{EXAMPLES}/').replace("= 40", "= 10"))
    (tmp_path / "script.py").write_text(block("python"))
    subprocess.run([sys.executable, "script.py"], cwd=tmp_path, check=True)
    assert len(read_table(tmp_path / "rows.jsonl")[1]) == 15
    assert (tmp_path / "rows.csv").exists()


def test_keys_columns_and_statuses_are_explained() -> None:
    for key in StudyTable.model_fields:
        if key != "summary":
            assert re.search(rf"^- `\[*{key}\]*`(?: \(|:)", PAGE, re.MULTILINE), key
    for key in SummaryTable.model_fields:
        assert f"\n- `summary.{key}` (" in PAGE
    for word in (*FIELDS, ERROR, TIMEOUT, CRASHED):
        assert f"`{word}`" in PAGE, word
    for word in (*_DRAWS, *_RANGES):
        assert f"{{ {word} = [" in PAGE, word

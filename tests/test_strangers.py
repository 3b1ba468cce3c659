"""A folder of somebody else, and texts of somebody else: nothing of them is run, and they only print."""

from __future__ import annotations

import csv
import gzip
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

import mbocp
from mbocp._processes import python_command
from mbocp._text import printable
from mbocp.problem import parse_problem
from mbocp.solution.export_formats import export_motion
from tests.solution.fabricated import limited

SHADOWS = ("json", "multiprocessing", "pickle", "struct")
EVIL = 'x\npopup("not yours")\n#\x1b]0;title\x07\u202e'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """One with modules that say that they have been run."""
    for name in SHADOWS:
        (tmp_path / f"{name}.py").write_text(f"open('ran_{name}.txt', 'w').close()\nraise ImportError\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def runs(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.glob("ran_*.txt"))


def test_a_process_of_ours_runs_no_module_of_the_folder(folder: Path) -> None:
    code = "import json, multiprocessing, mbocp\nprint(json.dumps(sys.argv[1:]), mbocp.__file__)"
    done = subprocess.run(python_command(code, "a", "b"), capture_output=True, text=True, check=True)
    assert done.stdout.split()[:2] == ['["a",', '"b"]']
    assert done.stdout.split()[2] == mbocp.__file__
    assert not runs(folder)
    plain = subprocess.run([sys.executable, "-c", "import json"], capture_output=True, check=False)
    assert plain.returncode  # which the folder is made to catch
    assert runs(folder) == ["ran_json.txt"]


def test_an_old_result_is_read_without_it(folder: Path) -> None:
    stored = Path(__file__).parent / "data" / "result_of_format_2.h5.gz"
    (folder / "old.h5").write_bytes(gzip.decompress(stored.read_bytes()))
    assert mbocp.Solution.load(folder / "old.h5").converged
    assert not runs(folder)


@pytest.mark.skipif(sys.version_info < (3, 11), reason="Python 3.10 has no safe path for its own processes")
def test_a_study_is_run_without_it(folder: Path) -> None:
    code = (
        "from mbocp.study.pools import LocalPool\n"
        "pool = LocalPool(1)\nprint(pool.submit(max, 1, 2).result())\npool.close()\n"
    )
    done = subprocess.run(python_command(code), capture_output=True, text=True, check=False)
    assert done.stdout == "2\n", done.stderr
    assert not runs(folder)


def test_texts_only_print() -> None:
    assert printable("a name, with ümlauts and 日本") == "a name, with ümlauts and 日本"
    shown = printable(EVIL + "\udcff")
    assert shown == r'x\npopup("not yours")\n#\x1b]0;title\x07\u202e\udcff'
    assert printable(shown) == shown


def test_a_result_has_no_text_that_does_more(tmp_path: Path) -> None:
    foreign = replace(limited(), problem_name=EVIL, robot_name=EVIL, advice=EVIL, guess_used=EVIL)
    read = mbocp.Solution.load(foreign.save(tmp_path / "foreign.h5"))
    for name in ("problem_name", "robot_name", "guess_used"):
        assert getattr(read, name) == printable(EVIL)
    assert read.advice == printable(EVIL, keep="\n")


def test_a_problem_is_called_by_what_prints_of_its_file(tmp_path: Path) -> None:
    text = 'robot = "double_pendulum"\n[horizon]\nduration = 1\nsteps = 4\n[goal]\nq = [1, 0]\n'
    file = tmp_path / "x\npopup('not yours').toml"
    assert parse_problem(text, source=file).name == r"x\npopup('not yours')"


def test_a_name_is_no_line_of_a_program(tmp_path: Path) -> None:
    arm = mbocp.load_problem(Path(__file__).parents[1] / "examples" / "arms" / "ur5_reach.toml")
    s = mbocp.solve(arm.with_(solver={"max_iterations": 1}))
    path = export_motion(replace(s, problem_name=EVIL), tmp_path / "a.script")
    first, second = path.read_text().splitlines()[:2]
    assert first.startswith(r"# x\npopup")
    assert second.startswith("def ")


def test_names_with_commas_and_quotes_are_one_column(tmp_path: Path) -> None:
    s = limited()
    label = s.labels.q[0]._replace(name='a",b')
    rate = s.labels.v[0]._replace(name=label.name)
    labels = replace(s.labels, q=(label, *s.labels.q[1:]), v=(rate, *s.labels.v[1:]))
    path = export_motion(replace(s, labels=labels), tmp_path / "a.csv")
    with path.open(newline="") as file:
        header, row = list(csv.reader(file))[:2]
    assert len(header) == len(row)
    assert any('a",b' in name for name in header)

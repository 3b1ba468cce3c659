"""What commands import: what they do not need is what they need not wait for."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from typer.main import get_command

from mbocp.cli.app import COMMANDS, app, app_for
from mbocp.cli.error_report import BUG
from tests.solution.fabricated import limited

from .conftest import Run

UR5 = Path(__file__).parents[2] / "examples" / "arms" / "ur5_reach.toml"
MECHANICS = {"casadi", "coal", "pinocchio"}
NEVER = {"h5py", "matplotlib", "meshcat", "scipy", "yaml"}  # for a solve that writes nothing
HEAVY = MECHANICS | NEVER | {"numpy", "pydantic", "rich"}
SHELL = """
import json, sys
from mbocp.cli.app import app
sys.argv = ["mbocp", *{words!r}]
try:
    app()
except SystemExit as done:
    assert not done.code, done.code
"""
HELPS = f"""
import json, os, sys
from mbocp.cli.app import app
for name in {list(COMMANDS)!r}:
    child = os.fork()
    if child:
        assert os.waitpid(child, 0)[1] == 0, name
        continue
    sys.argv, sys.stdout = ["mbocp", name, "--help"], open(os.devnull, "w")
    try:
        app()
    except SystemExit as done:
        print(json.dumps([name, sorted(sys.modules)]), file=sys.__stdout__, flush=True)
        os._exit(done.code or 0)
"""
TOLD = "\nimport json, sys\nprint(json.dumps(sorted(sys.modules)))\n"


def modules(code: str) -> set[str]:
    """All modules that are there after some code."""
    done = subprocess.run([sys.executable, "-c", code + TOLD], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return set(json.loads(done.stdout.splitlines()[-1]))


def heavy(code: str) -> set[str]:
    return {name.partition(".")[0] for name in modules(code)} & HEAVY


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With limits, and a path."""
    return limited().save(tmp_path_factory.mktemp("startup") / "limited.h5")


def test_the_package_alone_imports_nothing_heavy() -> None:
    assert not heavy("import mbocp")
    assert not heavy("import mbocp\ndir(mbocp)")


def test_modules_are_there_when_they_are_asked_for() -> None:
    assert "mbocp.identification.exciting" in modules("import mbocp\nmbocp.identification.information")
    assert not heavy("import mbocp\nassert not hasattr(mbocp, 'nothing') and not hasattr(mbocp, '__path')")


def test_help_imports_nothing_heavy() -> None:
    assert heavy(SHELL.format(words=["--help"])) <= {"rich"}


def test_info_needs_no_mechanics(result: Path) -> None:
    assert heavy(SHELL.format(words=["info", str(result)])) == {"h5py", "numpy", "pydantic", "rich"}


def test_check_needs_neither_scipy_nor_files() -> None:
    used = heavy(SHELL.format(words=["check", str(UR5), "--quiet"]))
    assert not used & NEVER
    assert used >= MECHANICS  # else the test would see nothing


def test_a_solve_needs_neither_scipy_nor_files() -> None:
    """Nor does what it prints: only `-o` needs HDF5."""
    used = heavy("import mbocp.solving, mbocp.cli.solution_summary, mbocp.accuracy")
    assert not used & NEVER
    assert used >= MECHANICS


def test_speeds_are_followed_between_nodes_without_scipy() -> None:
    code = "import numpy as np, mbocp.problem.step_flow as looks\nlooks.exponentials(np.eye(2)[None])"
    assert not heavy(code) & NEVER


def test_a_solve_imports_what_its_problem_takes_when_it_takes_it() -> None:
    """Formulations, solvers of others, several starts, files, and what writes C."""
    there = modules("import mbocp.solving, mbocp.cli.solution_summary")
    assert "mbocp.formulation.build" in there  # else the test would see nothing
    for name in (
        *(f"formulation.schemes.{scheme}" for scheme in ("natural", "explicit", "implicit", "symplectic")),
        *("solvers.nlp.interior_point", "solvers.staggered.fbsm_newton", "solvers.staggered.fbsm_gradient"),
        *("solvers.strategies.within_limits", "programme.c_files", "accuracy.refining"),
        *("guesses.several", "solution.file_content", "solution.files"),
        "robot.loading.readers.robot_yaml",
    ):
        assert find_spec(f"mbocp.{name}") is not None, f"there is no {name}, so that none could be imported"
        assert f"mbocp.{name}" not in there, name


@pytest.mark.slow
def test_nothing_of_that_comes_while_it_solves() -> None:
    assert not heavy(SHELL.format(words=["solve", str(UR5)])) & NEVER


def test_plots_and_replays_do_not_need_each_other() -> None:
    assert "meshcat" not in heavy("import mbocp.view.plots")
    assert not heavy("import mbocp.view.of_solution") & {"matplotlib", "scipy"}


def test_pictures_of_a_result_need_no_problem() -> None:
    """They read its text; only who solves it again makes a `Problem` of it."""
    there = modules("import mbocp.view.plots, mbocp.view.of_solution, mbocp.solution.its_robot")
    assert "mbocp.robot.robot" in there  # else the test would see nothing
    assert not there & {"mbocp.problem.problem", "mbocp.problem.file.read_tables", "mbocp.terms.kinds"}


def test_a_result_leaves_most_of_the_package_alone() -> None:
    """A fifth of the modules is enough to read one."""
    everything = len(list(Path(UR5.parents[2], "mbocp").rglob("*.py")))
    read = [name for name in modules("from mbocp.solution import Solution") if name.startswith("mbocp.")]
    assert len(read) < everything / 5


@pytest.fixture(scope="module")
def helped() -> dict[str, set[str]]:
    """Modules that are there after the help of each command, each in a fork of one process."""
    done = subprocess.run([sys.executable, "-c", HELPS], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return {name: set(there) for name, there in map(json.loads, done.stdout.splitlines())}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_help_of_a_command_needs_neither_numbers_nor_mechanics(
    name: str, helped: dict[str, set[str]]
) -> None:
    there = helped[name]
    assert f"mbocp.cli.{COMMANDS[name][0]}" in there  # else the test would see nothing
    assert not {name.partition(".")[0] for name in there} & (MECHANICS | NEVER | {"numpy"})


def test_a_command_that_cannot_be_imported_is_reported(monkeypatch: pytest.MonkeyPatch, run: Run) -> None:
    monkeypatch.setitem(COMMANDS, "info", ("no_such_module", ""))
    done = run("info", "a.h5", "--json")
    assert done.exit_code == BUG
    assert json.loads(done.stdout)["error"] == "ModuleNotFoundError"
    assert "this is a bug in mbocp" in done.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_of_its_own_needs_no_others(name: str) -> None:
    assert app_for([name, "--quiet"]) is app


@pytest.mark.parametrize("words", [[], ["--help"], ["--version"], ["sovle", "solve"], ["Solve"]])
def test_other_words_see_all_commands(words: list[str]) -> None:
    """And those that other packages add."""
    known = get_command(app_for(words)).commands  # type: ignore[attr-defined]
    assert list(known)[: len(COMMANDS)] == list(COMMANDS)

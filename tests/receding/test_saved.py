"""A horizon in a folder: a C++ program without Python steps it as Python does."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import ProblemError, ResultFileError
from mbocp.problem import Bounds, Problem
from mbocp.receding import HEADERS, HorizonStep, RecedingHorizon

pytestmark = pytest.mark.usefixtures("compiled")

HERE = Path(__file__).parent
FOLLOW = HERE.parents[1] / "examples" / "receding" / "ur5_follow.toml"
STEPS = 50


def compiled(source: Path, made: Path) -> Path:
    """A C++ program, by the flag that the package prints."""
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler")
    words = [sys.executable, "-m", "mbocp.receding"]
    flag = subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()
    assert flag == f"-I{HEADERS}"
    options = [flag, "-std=c++17", "-Wall", "-Wextra", "-Werror", "-o", str(made)]
    subprocess.run([compiler, *options, str(source), "-ldl"], check=True)
    return made


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> Path:
    """The C++ program, compiled."""
    return compiled(HERE / "saved.cpp", tmp_path_factory.mktemp("program") / "saved")


@pytest.fixture(scope="module")
def problem() -> Problem:
    return mbocp.load_problem(FOLLOW)


def run(program: Path, folder: Path, rows: list[np.ndarray]) -> list[str]:
    """Lines that the program prints; nothing of Python is in its environment."""
    text = "\n".join(" ".join(float(x).hex() for x in row) for row in rows)
    done = subprocess.run(
        [program, folder], input=text, env={}, capture_output=True, text=True, check=True, timeout=60.0
    )
    return done.stdout.splitlines()


def numbers(horizon: RecedingHorizon, found: HorizonStep) -> np.ndarray:
    states = np.hstack([found.q, found.v])
    status = [found.status.iterations, found.status.increment]
    held = [horizon.control_for(share * horizon.problem.dt) for share in (0.2, 1.0, 9.0)]
    return np.concatenate([status, found.u, found.K.ravel(), states.ravel(), *held])


def is_loaded_with(program: Path, word: str) -> bool:
    """Whether a program, or a library, needs one of a name."""
    return word in subprocess.run(["ldd", program], capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("has_limits", [True, False])
def test_fifty_steps_are_those_of_python(program, problem, tmp_path, has_limits):
    """Within torque limits and without, with states that are off, goals that move, and steps of the clock."""
    horizon = RecedingHorizon(problem if has_limits else problem.with_(limits=Bounds()), iterations=2)
    rng, robot = np.random.default_rng(3), problem.robot
    goal = np.array(problem.q_start)
    horizon.step(problem.q_start, problem.v_start, goal=goal + 0.2, target=goal + 0.2, dt=0.003)
    folder = horizon.save(tmp_path / "controller")
    rows, expected = [], []
    q, v = np.array(horizon.first.q[0]), np.array(horizon.first.v[0])
    for k in range(STEPS):
        goal = None if k % 5 == 4 else problem.q_start + 0.5 * np.sin(0.1 * k) + 0.3
        dt = [0.004, 0.0, 0.02, problem.dt][k % 4]
        found = horizon.step(q, v, goal=goal, target=goal, dt=dt)
        told = np.full(robot.nq, np.nan) if goal is None else goal
        rows.append(np.concatenate([[dt], q, v, told]))
        expected.append((found.status.state, numbers(horizon, found)))
        q = found.q[1] + 1e-3 * rng.standard_normal(robot.nq)
        v = found.v[1] + 1e-2 * rng.standard_normal(robot.nv)
    lines = run(program, folder, rows)
    assert len(lines) == STEPS + 2
    for line, (state, values) in zip(lines, expected, strict=False):
        word, *found_values = line.split()
        assert word == state
        np.testing.assert_array_equal([float.fromhex(x) for x in found_values], values)
    assert lines[-2] == "bad_input: q: none given, or of a wrong size"
    assert lines[-1] == "mbocp: period: expected a time above 0 [s]"


def test_the_example_arrives(problem, tmp_path):
    example = compiled(FOLLOW.with_name("controller.cpp"), tmp_path / "example")
    folder = RecedingHorizon(problem).save(tmp_path / "ur5")
    told = subprocess.run([example, folder], env={}, capture_output=True, text=True, check=True).stdout
    assert float(told.split(": ")[-1].split()[0]) < 1e-2


def test_the_block_of_the_page_compiles(tmp_path):
    page = (HERE.parents[1] / "docs" / "receding_horizon.md").read_text("utf-8")
    (block,) = re.findall(r"^```cpp\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    include, _, body = block.partition("\n\n")
    before = "void command(const double *) {}\nint main() {\nstd::vector<double> q, v, goal;\n"
    (tmp_path / "page.cpp").write_text(f"{include}\n#include <vector>\n{before}{body}}}\n")
    assert compiled(tmp_path / "page.cpp", tmp_path / "page").exists()


def test_a_horizon_that_remembers_controls_goes_on(program, tmp_path):
    """States have the controls before behind (q, v), and the first step learns that it has one before it."""
    cart_pole = FOLLOW.parents[1] / "optima" / "cart_pole.toml"
    problem = mbocp.load_problem(cart_pole, {"horizon.steps": 20, "cost.control_rate": 1e-4})
    horizon = RecedingHorizon(problem)
    folder = horizon.save(tmp_path)
    rows, expected = [], []
    for k in range(6):
        q, v = problem.q_start + 0.01 * k, problem.v_start
        found = horizon.step(q, v, dt=0.004)
        rows.append(np.concatenate([[0.004], q, v, np.full(2, np.nan)]))
        expected.append(numbers(horizon, found))
    for line, values in zip(run(program, folder, rows), expected, strict=False):
        np.testing.assert_array_equal([float.fromhex(x) for x in line.split()[1:]], values)


def test_bad_numbers_are_told(program, problem, tmp_path):
    horizon = RecedingHorizon(problem)
    folder = horizon.save(tmp_path)
    good = [0.004, *problem.q_start, *problem.v_start, *problem.q_start]
    wrong_q, wrong_goal, wrong_dt = list(good), list(good), list(good)
    wrong_q[1], wrong_goal[14], wrong_dt[0] = np.nan, np.inf, -1.0
    lines = run(program, folder, [np.array(row) for row in (wrong_q, wrong_goal, wrong_dt, good)])
    assert [line.split()[0] for line in lines[:4]] == ["bad_input"] * 3 + ["improved"]


def test_what_is_no_horizon_is_refused_with_words(program, problem, tmp_path):
    assert run(program, tmp_path, [])[0].startswith("refused: mbocp: ")
    folder = RecedingHorizon(problem).save(tmp_path / "horizon")
    text = (folder / "controller.txt").read_text()
    (folder / "controller.txt").write_text(text.replace("version 1 0x1", "version 1 0x2"))
    assert "of another version" in run(program, folder, [])[0]
    (folder / "controller.txt").write_text(text.replace("\nturning ", "\nturned "))
    assert "no turning" in run(program, folder, [])[0]
    (folder / "controller.txt").write_text(text.replace("\neffort_upper ", "\nupper "))
    assert "no limits of efforts; save the horizon again" in run(program, folder, [])[0]
    (folder / "controller.txt").unlink()
    assert "there is no controller.txt in it" in run(program, folder, [])[0]


def test_the_folder_needs_neither_python_nor_casadi(program, problem, tmp_path):
    folder = RecedingHorizon(problem).save(tmp_path)
    assert {file.name for file in folder.iterdir()} == {
        "controller.txt",
        "end.so",
        "libmbocp_receding.so",
        "stages.so",
    }
    for file in (program, *folder.glob("*.so")):
        assert not is_loaded_with(file, "python")
        assert not is_loaded_with(file, "casadi")


def test_interpreted_functions_are_refused(problem, tmp_path, monkeypatch):
    monkeypatch.setenv("MBOCP_FUNCTIONS", "tapes")
    with pytest.raises(ProblemError, match="no C compiler"):
        RecedingHorizon(problem).save(tmp_path)


def test_states_that_are_no_configurations_are_refused(tmp_path, monkeypatch):
    monkeypatch.setenv("MBOCP_FUNCTIONS", "tapes")  # it is looked at before the compiler is missed
    problem = mbocp.load_problem(FOLLOW, {"coordinates": "natural", "limits": {}})
    with pytest.raises(ProblemError, match="are not"):
        RecedingHorizon(problem).save(tmp_path)


def test_a_folder_that_cannot_be_written_is_told(problem, tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ResultFileError, match="cannot be written"):
        RecedingHorizon(problem).save(tmp_path / "file")


def test_a_save_that_fails_leaves_the_numbers_of_before(problem, tmp_path, monkeypatch):
    horizon = RecedingHorizon(problem)
    before = {file.name: file.read_bytes() for file in horizon.save(tmp_path).iterdir()}

    def fill_the_disk(path: Path, content: bytes) -> None:
        with path.open("wb") as file:
            file.write(content[: len(content) // 2])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", fill_the_disk)
    with pytest.raises(ResultFileError, match="No space left"):
        horizon.save(tmp_path)
    monkeypatch.undo()
    assert {name: (tmp_path / name).read_bytes() for name in before} == before

"""Tapes at once, and a compiler beside the solves: when it runs, how it fails, how it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbocp
from mbocp.exceptions import InvalidValue
from mbocp.programme import background, cache, compilation, tapes
from mbocp.programme.cache import seal
from mbocp.programme.compilation import (
    BackgroundCompilerWarning,
    CompiledFunctions,
    NoCompilerWarning,
    load_functions,
)
from mbocp.programme.compiler import compiler
from mbocp.receding import RecedingHorizon

EXAMPLES = Path(__file__).parents[2] / "examples"
PATIENCE = 60.0  # [s] for a compiler on a busy machine
SLOW = """#!/bin/sh
sleep 60 &
echo $$ $! > "$PIDS.part"
mv "$PIDS.part" "$PIDS"
wait
"""
WORKS = """
import sys, time
from pathlib import Path
from tests.programme.test_background import PATIENCE, execute, load
from mbocp.programme import tapes
tapes._INSTRUCTION = 1.0
execute(load())
load()
limit = time.monotonic() + PATIENCE
while not Path(sys.argv[1]).exists() and time.monotonic() < limit:
    time.sleep(0.02)
print("compiles", flush=True)
{}
"""
# Two processes, one after the other, that import everything once.
CALLS = """
import os
from tests.programme.test_background import execute, load
for _ in range(2):
    child = os.fork()
    if not child:
        execute(load())
        break
    assert os.waitpid(child, 0)[1] == 0
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("MBOCP_FUNCTIONS", "auto")
    for told in (compilation._warn_no_compiler, compilation._warn_failure):
        told.cache_clear()
    yield tmp_path / "cache" / "stages"
    background._stop()


@pytest.fixture
def pays(monkeypatch: pytest.MonkeyPatch) -> None:
    """An instruction of a tape takes a second, it is said."""
    monkeypatch.setattr(tapes, "_INSTRUCTION", 1.0)


def doubling() -> dict[str, ca.Function]:
    x = ca.SX.sym("x", 2)
    inner = ca.Function("inner", [x], [2 * x, ca.sin(x)], {"never_inline": True})
    double, sines = inner(x)
    X = ca.MX.sym("x", 2)
    return {
        "f": ca.Function("f", [x], [double]),
        "g": ca.Function("g", [x], [sines * double]),
        "outer": ca.Function("outer", [X], [inner(X)[0] + 1]),
    }


def never() -> dict[str, ca.Function]:
    raise AssertionError("built although it is in the cache")


def load() -> CompiledFunctions:
    return load_functions("key", doubling)


def execute(functions: CompiledFunctions) -> None:
    """Let the kernel read a tape and call it once, as a solve does."""
    functions.stage_function("f").evaluate([np.zeros(2)], 1, True)


def works(functions: CompiledFunctions) -> bool:
    x = np.array([0.3, -0.2])
    expected = {"f": 2 * x, "g": 2 * x * np.sin(x), "outer": 2 * x + 1}
    return all(np.allclose(functions.function(n)(x).full().ravel(), v) for n, v in expected.items())


def compiled_beside() -> CompiledFunctions:
    """What is loaded once the compiler is through."""
    limit = time.monotonic() + PATIENCE
    while (found := load()).library is None and time.monotonic() < limit:
        time.sleep(0.02)
    return found


def forget() -> None:
    """Know no more than another process does."""
    compilation._place.cache_clear()


def script(path: Path, text: str) -> str:
    path.write_text(text)
    path.chmod(0o755)
    return str(path)


def test_functions_are_tapes_at_once_and_kept(folder: Path) -> None:
    first = load()
    assert first.library is None
    assert works(first)
    assert load().opened is first.opened
    assert [path.suffix for path in folder.iterdir()] == [".tape"]
    forget()
    again = load_functions("key", never)
    assert again.tapes.held == first.tapes.held
    assert works(again)


@pytest.mark.parametrize("damage", ["truncated", "overwritten", "link", "foreign"])
def test_tapes_that_are_damaged_or_not_ones_own_are_written_anew(folder: Path, damage: str) -> None:
    load()
    (file,) = folder.glob("*.tape")
    content = file.read_bytes()
    file.unlink()
    if damage == "link":
        target = folder.parent / "elsewhere"
        target.write_bytes(content)
        file.symlink_to(target)
    else:
        wrong = {
            "truncated": content[:-100],
            "overwritten": content[:200] + b"\0" * 50 + content[250:],
            "foreign": seal(b"no archive"),
        }
        file.write_bytes(wrong[damage])
    forget()
    assert works(load())
    assert not file.is_symlink()
    forget()
    assert works(load_functions("key", never))


@pytest.mark.usefixtures("pays")
def test_a_compiler_runs_beside_once_that_pays(folder: Path) -> None:
    first = load()
    load()
    assert not background._running  # nothing was executed so far
    execute(first)
    assert load().library is None
    (beside,) = background._running
    found = compiled_beside()
    assert found.library is not None
    assert works(found)
    assert not background._running
    assert beside._group is not None
    with pytest.raises(ChildProcessError):  # somebody has waited for the process
        os.waitpid(beside._group, os.WNOHANG)
    assert not list(folder.glob("build-*"))
    forget()
    assert load_functions("key", never).library == found.library


def choosing() -> dict[str, ca.Function]:
    """What is no tape: rows of a table by their numbers, in a loop."""
    table, which = ca.MX.sym("table", 3, 4), ca.MX.sym("which", 1, 5)
    x = ca.SX.sym("x", 3)
    squares = ca.Function("squares", [x], [x * x])
    return {"f": ca.Function("f", [table, which], [squares.map(5)(table[:, which])])}


def test_functions_that_choose_by_an_index_wait_for_no_compiler_either(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def load_them() -> CompiledFunctions:
        return load_functions("choosing", choosing)

    def evaluate(functions: CompiledFunctions) -> np.ndarray:
        """In the kernel, at two stages."""
        copy = functions.stage_function("f")
        return np.asarray(copy.evaluate([np.tile(tables, 2), np.tile(which, 2)], 2, False)).reshape(2, -1)

    tables, which = np.arange(12.0), np.array([3.0, 0.0, 1.0, 1.0, 2.0])
    expected = (tables.reshape(4, 3)[which.astype(int)] ** 2).ravel()
    first = load_them()
    assert first.library is None
    np.testing.assert_array_equal(evaluate(first), [expected, expected])
    executed = first.opened["f"].num_executed
    assert executed >= 2 * 15 // 2  # two stages of fifteen products, and what leads there
    evaluate(first)
    assert first.opened["f"].num_executed == 2 * executed  # copies count together
    assert not background._running
    monkeypatch.setattr(tapes, "_INSTRUCTION", 1.0)
    limit = time.monotonic() + PATIENCE
    while (found := load_them()).library is None and time.monotonic() < limit:
        time.sleep(0.02)
    assert found.library is not None
    np.testing.assert_array_equal(
        found.function("f")(tables.reshape(4, 3).T, which).full().T.ravel(), expected
    )


@pytest.mark.usefixtures("pays")
def test_the_library_is_the_one_that_is_compiled_at_once(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    execute(load())
    beside = compiled_beside().library
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "other"))
    at_once = load_functions("key", doubling, at_once=True).library
    assert beside is not None
    assert at_once is not None
    assert beside.name == at_once.name


def test_processes_that_called_tapes_for_long_let_the_next_one_compile(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each says at its end how many instructions it has executed; the file has what is compiled."""
    subprocess.run([sys.executable, "-c", CALLS], cwd=EXAMPLES.parent, check=True)
    for seconds, suffixes in ((1e-9, {".tape", ".executed"}), (1.0, {".tape", ".executed", ".key", ".so"})):
        monkeypatch.setattr(tapes, "_INSTRUCTION", seconds)
        forget()
        assert (load_functions("key", never).library is not None) == (seconds == 1.0)
        assert {path.suffix for path in folder.iterdir()} == suffixes


def test_a_solve_that_would_run_out_of_time_goes_on_with_tapes(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    subprocess.run([sys.executable, "-c", CALLS], cwd=EXAMPLES.parent, check=True)
    monkeypatch.setattr(tapes, "_INSTRUCTION", 1e9)
    for compiler_time, has_library in ((1e6, False), (0.1, True)):
        monkeypatch.setattr(tapes, "_COMPILER", compiler_time)
        forget()
        found = load_functions("key", never, deadline=time.perf_counter() + 60.0)
        assert (found.library is not None) == has_library


def test_few_instructions_do_not_pay() -> None:
    made = tapes.Tapes({}, operations=10_000, built={})
    assert not made.pay_compiling(10_000_000)
    assert made.pay_compiling(200_000_000)


@pytest.mark.usefixtures("pays")
def test_the_compiler_has_low_priority(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (real, *_) = compiler() or ()
    seen = tmp_path / "nice"
    monkeypatch.setenv("CC", script(tmp_path / "cc", f'#!/bin/sh\nnice > {seen}\nexec {real} "$@"\n'))
    execute(load())
    assert compiled_beside().library is not None
    assert int(seen.read_text()) == 19


@pytest.mark.usefixtures("pays")
def test_a_compiler_that_fails_is_told_once(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", script(tmp_path / "cc", "#!/bin/sh\necho out of order\nexit 3\n"))
    first = load()
    execute(first)
    load()
    (beside,) = background._running
    beside.wait(PATIENCE)
    with pytest.warns(BackgroundCompilerWarning, match=r"out of order.*they stay tapes"):
        assert works(load())
    assert works(load())  # says nothing any more: warnings are errors
    assert not list(folder.glob("build-*"))


@pytest.mark.usefixtures("pays")
def test_without_a_compiler_a_warning_says_so_once_it_would_pay(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "")
    monkeypatch.setenv("PATH", "/nowhere")
    execute(load())
    with pytest.warns(NoCompilerWarning):
        load()
    assert works(load())


def pids(path: Path) -> list[int]:
    return [int(word) for word in path.read_text().split()]


def gone(pid: int) -> bool:
    """Whether a process has ended; one that nobody has waited for yet has, too."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def begun(folder: Path, tmp_path: Path, then: str) -> tuple[subprocess.Popen[str], Path]:
    """A process whose compiler runs beside it and takes a minute."""
    seen = tmp_path / "pids"
    own = {**os.environ, "CC": script(tmp_path / "cc", SLOW), "PIDS": str(seen)}
    command = [sys.executable, "-c", WORKS.format(then), str(seen)]
    process = subprocess.Popen(
        command, env=own, cwd=EXAMPLES.parent, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "compiles\n"
    return process, seen


def all_gone(seen: Path) -> bool:
    limit = time.monotonic() + PATIENCE
    while time.monotonic() < limit:
        if all(map(gone, pids(seen))):
            return True
        time.sleep(0.02)
    return False


def left_in(folder: Path) -> list[Path]:
    """What the next process finds, which removes what those leave that had no time to do so."""
    cache._sweep.cache_clear()
    with cache.scratch_folder(folder):
        pass
    return list(folder.iterdir())


def test_a_process_that_ends_ends_its_compiler(folder: Path, tmp_path: Path) -> None:
    process, seen = begun(folder, tmp_path, "")
    before = time.monotonic()
    _, said = process.communicate(timeout=PATIENCE)
    assert time.monotonic() - before < 30.0  # and not the compiler's minute
    assert (process.returncode, said) == (0, "")
    assert all_gone(seen)
    assert {path.suffix for path in left_in(folder)} == {".tape", ".executed"}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_process_that_is_killed_ends_its_compiler(folder: Path, tmp_path: Path, number: int) -> None:
    process, seen = begun(folder, tmp_path, "time.sleep(60)")
    process.send_signal(number)
    process.communicate(timeout=PATIENCE)
    assert process.returncode == -number
    assert all_gone(seen)
    assert not list(folder.glob("*.so"))


@pytest.mark.usefixtures("pays")
def test_compilers_run_one_after_another_and_all_are_stopped(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = tmp_path / "pids"
    monkeypatch.setenv("PIDS", str(seen))
    monkeypatch.setenv("CC", script(tmp_path / "cc", SLOW))
    for key in ("one", "another"):
        for _ in range(2):
            execute(load_functions(key, doubling))
    both = list(background._running)
    assert len(both) == 2
    limit = time.monotonic() + PATIENCE
    while not seen.exists() and time.monotonic() < limit:
        time.sleep(0.02)
    background._stop()
    for beside in both:
        beside.wait(PATIENCE)
    assert not background._running
    assert all_gone(seen)
    assert {path.suffix for path in left_in(folder)} == {".tape"}


def test_policies(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MBOCP_FUNCTIONS", "tapes")
    assert load_functions("key", doubling, at_once=True).library is None
    assert load().compile().library is None
    monkeypatch.setenv("MBOCP_FUNCTIONS", "compiled")
    assert load().compiled_now
    monkeypatch.setenv("MBOCP_FUNCTIONS", "tapes")
    assert load().library is None
    monkeypatch.setenv("MBOCP_FUNCTIONS", "auto")
    assert load().library is not None  # from the cache
    monkeypatch.setenv("MBOCP_FUNCTIONS", "fast")
    with pytest.raises(InvalidValue, match="MBOCP_FUNCTIONS: got 'fast', expected one of auto, comp"):
        load()


def test_tapes_can_be_compiled_when_that_is_asked_for(folder: Path) -> None:
    made = load()
    assert made.library is None
    assert made.compile().compiled_now
    assert works(made.compile())


def test_a_solve_needs_no_compiler_and_a_horizon_has_one(folder: Path, tmp_path: Path) -> None:
    problem = mbocp.load_problem(EXAMPLES / "paper" / "rigid_pendulum.toml", ["horizon.steps=10"])
    assert mbocp.solve(problem).status == "converged"
    assert not list(folder.glob("*.so"))
    swing = mbocp.Problem.create("double_pendulum", 0.5, 10, goal={"q": [0.2, 0.1]}, cost={"velocity": 1.0})
    horizon = RecedingHorizon(swing)
    assert len(list(folder.glob("*.so"))) == 2
    horizon.save(tmp_path / "saved")


@pytest.mark.usefixtures("pays")
def test_solves_take_over_what_is_compiled_beside_them(folder: Path) -> None:
    problem = mbocp.load_problem(EXAMPLES / "paper" / "rigid_pendulum.toml", ["horizon.steps=10"])
    by_tapes = mbocp.solve(problem)
    limit = time.monotonic() + PATIENCE
    while len(list(folder.glob("*.so"))) < 2 and time.monotonic() < limit:
        mbocp.solve(problem)  # the first of them starts the compiler
    compiled = mbocp.solve(problem)
    assert mbocp.formulation.transcribe(problem).functions.library is not None
    assert compiled.iterations == by_tapes.iterations
    assert np.allclose(compiled.us, by_tapes.us, atol=1e-12)


def test_interior_point_methods_call_compiled_functions(folder: Path) -> None:
    problem = mbocp.load_problem(
        EXAMPLES / "paper" / "rigid_pendulum.toml", ["horizon.steps=10", 'solver.method="ipopt"']
    )
    programme = mbocp.formulation.transcribe(problem)
    assert programme.functions.library is not None
    assert programme.functions.with_name("gradient").library is not None

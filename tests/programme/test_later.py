"""Functions that are compiled when they are asked for: by sweeps, interior-point methods and Hamiltonians."""

from __future__ import annotations

import pickle
import threading
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbocp
from mbocp.exceptions import CompilationTimeout
from mbocp.formulation import transcribe
from mbocp.problem import Problem
from mbocp.programme.compilation import CompiledFunctions, LateFunctions
from mbocp.programme.compiler import compiler
from mbocp.programme.kernel import kernel_programme

pytestmark = pytest.mark.usefixtures("compiled")

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler")
LIBRARIES = 2  # of a shape: the functions of its stages, and those of its end


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache" / "stages"


def swing(scheme: str = "gauss2", duration: float = 1.0) -> Problem:
    goal = {"q": [0.4, -0.3], "v": [0.0, 0.0]}
    return Problem.create("double_pendulum", duration, 8, goal=goal, cost={"velocity": 1.0}, scheme=scheme)


def num_libraries(folder: Path) -> int:
    return len(list(folder.glob("*.so")))


@needs_compiler
def test_a_solve_compiles_what_it_asks_for(folder: Path) -> None:
    solution = mbocp.solve(swing())
    assert solution.converged
    assert num_libraries(folder) == LIBRARIES
    assert np.isfinite(solution.control_hamiltonians).all()  # of `lengthening`
    assert num_libraries(folder) == LIBRARIES
    swept = mbocp.solve(swing(), solver="fbsm_newton")
    assert np.allclose(swept.us, solution.us, atol=1e-6)
    assert num_libraries(folder) == LIBRARIES + 1


def test_sweeps_build_nothing_more_where_functions_are_tapes(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MBOCP_FUNCTIONS", "tapes")
    kernel_programme(transcribe(swing()), sweeps=True)
    assert len(list(folder.glob("*.tape"))) == LIBRARIES


@pytest.mark.parametrize("scheme", ["se1", "gauss2", "rk4"])
def test_sweeps_are_the_same_with_either_function(scheme: str) -> None:
    programme = transcribe(swing(scheme, duration=0.1))
    found = []
    for sweeps in (False, True):
        native = kernel_programme(programme, sweeps=sweeps)
        random = np.random.default_rng(0)
        native.u = 0.1 * random.standard_normal(native.u.size)
        native.eta = random.standard_normal(native.eta.size)
        native.x = np.tile(programme.x_start, programme.num_steps + 1)
        assert native.simulate(1e-12, 50).ok
        assert native.gradient().finite
        found.append(np.hstack([native.x, native.y, native.m, native.control_gradient]))
    assert np.abs(found[1]).max() > 0.01
    assert np.allclose(found[0], found[1], rtol=1e-9, atol=1e-9)


def functions_of(name: str) -> CompiledFunctions:
    x = ca.SX.sym("x")
    return CompiledFunctions.interpret({name: ca.Function(name, [x], [2 * x])})


def test_another_process_gets_what_is_compiled_here() -> None:
    """It does not know how to build the functions."""
    times = []

    def load() -> CompiledFunctions:
        times.append(1)
        return functions_of("g")

    sent = pickle.dumps(functions_of("f").with_later(LateFunctions(["g"], load)))
    received = pickle.loads(sent)
    assert float(received.function("g")(2.0)) == float(received.function("f")(2.0)) == 4.0
    assert len(times) == 1


def test_threads_wait_for_the_one_that_compiles() -> None:
    times = []
    begun = threading.Barrier(4, timeout=60)

    def load() -> CompiledFunctions:
        times.append(1)
        return functions_of("g")

    later = functions_of("f").with_later(LateFunctions(["g"], load))
    found: list[CompiledFunctions] = []

    def ask() -> None:
        begun.wait()
        found.append(later.with_name("g"))

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(times) == 1
    assert len(found) == 4
    assert len(set(map(id, found))) == 1


def test_what_stands_for_a_function_is_called_where_its_time_is_over() -> None:
    def load() -> CompiledFunctions:
        raise CompilationTimeout("the C compiler ran")

    functions = functions_of("g").with_later(LateFunctions(["g"], load))
    assert functions.with_name("g") is functions
    assert float(functions.function("g")(1.0)) == 2.0
    assert float(pickle.loads(pickle.dumps(functions)).function("g")(1.0)) == 2.0

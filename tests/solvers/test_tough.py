"""Stage functions that go wrong at random calls: NaN, infinite, noise, or no value at all.

Whatever happens, a solve ends in time, with an honest status and with a finite motion no worse than the
guess; and what it calls converged is so by functions that are sound.
"""

from __future__ import annotations

import ctypes
import math
import subprocess
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import MbocpError
from mbocp.formulation import build, transcribe
from mbocp.problem import Problem
from mbocp.programme.compilation import CompiledFunctions, load_functions
from mbocp.solution import Solution, Status

pytestmark = pytest.mark.usefixtures("compiled")

EXAMPLES = Path(__file__).parents[2] / "examples"
METHODS = ("monolithic", "fbsm_newton", "fbsm_bb", "fbsm_bb+monolithic", "fbsm_bb+fbsm_newton", "auto")
INTERIOR_POINT = ("ipopt", "fatrop")
MODES = {"nan": 0, "inf": 1, "noise": 2, "failure": 3}
OFTEN = 3e-2
RATES = (3e-4, 3e-3, OFTEN)  # of calls; an iteration makes some dozens; OFTEN spoils what is read back, too
ONE_PHASE = 4  # beside compile, guess and diagnostics
TIME_LIMIT = 5.0  # [s]
REDUNDANT_ROW_TOLERANCE = 5.0  # [s] for what is not iterating, on a busy machine
HOLDS = 1e-4  # relative change of the controls of what is called converged, by sound functions

Spoil = Callable[[str, float, int], None]


class Tough:
    """Libraries whose functions go wrong; `spoil` says how."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.libraries: dict[Path, ctypes.CDLL] = {}

    def load(self, key: str, build: Any, **options: Any) -> CompiledFunctions:
        """Take the place of `load_functions`."""
        sound = load_functions(key, build, **options)
        assert sound.library is not None
        path = self.folder / f"tough-{sound.library.name}"
        if path not in self.libraries:
            self._compile(sound.library, path)
            self.libraries[path] = ctypes.CDLL(str(path))
        return CompiledFunctions(path, None, compiled_now=False)

    def spoil(self, mode: str, rate: float, seed: int) -> None:
        for library in self.libraries.values():
            size = ctypes.c_double(10.0 ** -(seed % 5))
            library.tough_set(ctypes.c_uint64(seed), ctypes.c_double(rate), MODES[mode], size)

    @property
    def spoilt(self) -> int:
        """Number of calls that went wrong."""
        return sum(library.tough_spoilt() for library in self.libraries.values())

    @staticmethod
    def _compile(library: Path, path: Path) -> None:
        command = ["nm", "-D", "--defined-only", "--format=just-symbols", str(library)]
        symbols = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
        names = [symbol.removesuffix("_n_in") for symbol in symbols if symbol.endswith("_n_in")]
        defined = ["-DFUNCTIONS=" + "".join(f"F({name})" for name in names), f'-DLIBRARY="{library}"']
        source = str(Path(__file__).with_name("tough.c"))
        subprocess.run(
            ["cc", "-O1", "-fPIC", "-shared", "-o", str(path), *defined, source, "-ldl"], check=True
        )


@pytest.fixture(scope="module")
def tough(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tough]:
    made = Tough(tmp_path_factory.mktemp("tough"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "load_functions", made.load)
        yield made


def pendulum() -> Problem:
    return mbocp.load_problem(EXAMPLES / "paper/elastic_pendulum.toml", ["horizon.steps=20"])


def rod() -> Problem:
    return mbocp.load_problem(EXAMPLES / "paper/rigid_pendulum.toml", ["horizon.steps=10"])


def arm() -> Problem:
    settings = [
        "integrator.scheme=se1",
        "horizon.steps=20",
        "horizon.duration=1.0",
        "start.q=[0, 0]",
        "goal.q=[1.0, 0.5]",
        "goal.v=[0, 0]",
    ]
    return mbocp.load_problem(
        EXAMPLES / "arms/ur5_reach.toml",
        [*settings, 'robot="double_pendulum"', "cost.velocity=0.1"],
    )


SYSTEMS: dict[str, Callable[[], Problem]] = {"pendulum": pendulum, "rod": rod, "arm": arm}


def solve_spoilt(
    tough: Tough, problem: Problem, method: str, mode: str, rate: float, seed: int
) -> Solution | None:
    """Solve; None if it is refused, as when the guess's simulation meets what is wrong."""
    options = replace(problem.solver, time_limit=TIME_LIMIT, method=method, max_iterations=300)
    spoilt = problem.with_(solver=options)
    transcribe(spoilt)  # compiled before the clock is looked at
    tough.spoil(mode, rate, seed)
    begun = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            solution = mbocp.solve(spoilt)
    except MbocpError as error:
        print(error)
        return None
    finally:
        print("spoilt calls:", tough.spoilt)
        tough.spoil(mode, 0.0, seed)
        assert time.perf_counter() - begun < TIME_LIMIT + REDUNDANT_ROW_TOLERANCE
    return solution


def check_honest(solution: Solution, problem: Problem, rate: float) -> None:
    """Multipliers are computed once more when the motion is read back: there, too, a call may go wrong."""
    for name in ("qs", "vs", "ps", "us"):
        assert np.isfinite(getattr(solution, name)).all(), name
    assert solution.advice
    assert solution.status is not Status.SWITCHED
    guess = next(record for record in solution.history if record.is_guess)
    is_known = math.isfinite(guess.residual) and math.isfinite(guess.cost)
    if is_known and rate < OFTEN:
        assert math.isfinite(solution.cost)
    if not solution.converged:
        if rate < OFTEN and is_known and len(solution.phases) == ONE_PHASE:
            assert solution.residual <= guess.residual or solution.solver in ("IPOPT", "fatrop")
        return
    known = {name: np.nan_to_num(getattr(solution, name)) for name in ("lams", "mus", "zetas", "eta")}
    again = mbocp.solve(problem, solver="monolithic", warm_start=replace(solution, **known))
    assert again.converged, again.advice
    np.testing.assert_allclose(again.us, solution.us, atol=HOLDS * np.abs(solution.us).max())


def attack(tough: Tough, system: str, method: str, seed: int) -> str:
    """Status, or "refused"."""
    problem = SYSTEMS[system]()
    mode, rate = list(MODES)[seed % len(MODES)], RATES[seed // len(MODES) % len(RATES)]
    solution = solve_spoilt(tough, problem, method, mode, rate, seed)
    if solution is not None:
        check_honest(solution, problem, rate)
    return str(solution.status) if solution is not None else "refused"


@pytest.mark.parametrize("method", [*METHODS, *INTERIOR_POINT])
def test_spoilt_functions(tough: Tough, method: str) -> None:
    """The guess of the arm is a line: a function that gives no value first does so within a solver."""
    statuses = [attack(tough, "pendulum", method, seed) for seed in range(12) if seed % 4 != 3]
    if method not in INTERIOR_POINT:  # generated code never fails, and CasADi raises where it did
        statuses += [attack(tough, "arm", method, seed) for seed in (3, 7, 11)]
    assert "converged" in statuses


@pytest.mark.slow
@pytest.mark.parametrize("system", SYSTEMS)
@pytest.mark.parametrize("method", [*METHODS, *INTERIOR_POINT])
def test_many_spoilt_functions(tough: Tough, system: str, method: str) -> None:
    for seed in range(100, 148):
        if list(MODES)[seed % len(MODES)] != "failure" or method not in INTERIOR_POINT:
            attack(tough, system, method, seed)


def test_sound_functions_converge(tough: Tough) -> None:
    """The wrapper itself spoils nothing, and what it spoils it counts."""
    problem = pendulum()
    solution = solve_spoilt(tough, problem, "monolithic", "nan", 0.0, 1)
    assert solution is not None
    assert solution.converged
    assert tough.spoilt == 0

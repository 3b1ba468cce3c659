"""Solvers that another package adds by an entry point."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp.exceptions import InvalidValue, ProblemError
from mbocp.problem import SolverOptions
from mbocp.solvers.added import GROUP, find_added_solvers

EXAMPLE = Path(__file__).parents[2] / "examples" / "paper" / "rigid_pendulum.toml"
SOLVER = """
from dataclasses import dataclass
from mbocp.solvers import PureNewton

@dataclass(frozen=True)
class Damped(PureNewton):
    name: str = "damped (a package's own)"

def make(settings):
    return Damped(settings.options.tolerance, settings.newton_iterations)
"""

Install = Callable[[str], None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Put a package with the solver `damped` where Python finds it."""

    def put(entry: str) -> None:
        (tmp_path / "own_solver.py").write_text(SOLVER)
        facts = tmp_path / "own_solver-1.0.dist-info"
        facts.mkdir()
        (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: own-solver\nVersion: 1.0\n")
        (facts / "entry_points.txt").write_text(f"[{GROUP}]\ndamped = {entry}\n")
        monkeypatch.syspath_prepend(tmp_path)
        find_added_solvers.cache_clear()

    yield put
    find_added_solvers.cache_clear()


def test_its_name_is_a_method(install: Install) -> None:
    install("own_solver:make")
    problem = mbocp.load_problem(EXAMPLE)
    found = mbocp.solve(problem.with_(solver={"method": "damped"}))
    assert found.solver == "damped (a package's own)"
    pure = mbocp.solve(problem.with_(solver={"method": "monolithic", "globalisation": "none"}))
    np.testing.assert_array_equal(found.qs, pure.qs)


def test_a_name_that_nobody_has_is_refused_with_those_there_are(install: Install) -> None:
    install("own_solver:make")
    with pytest.raises(InvalidValue, match=r'solver.method: .* "fatrop" \| "damped" \(did you mean'):
        SolverOptions(method="dampd")


def test_what_does_not_load_is_told(install: Install) -> None:
    install("own_solver:nothing")
    problem = mbocp.load_problem(EXAMPLE).with_(solver={"method": "damped"})
    with pytest.raises(InvalidValue, match=r"solver.method: got 'damped', expected .*own-solver: .*nothing"):
        mbocp.solve(problem)


def test_limits_are_left_to_methods_that_keep_them(install: Install) -> None:
    install("own_solver:make")
    with pytest.raises(ProblemError, match=r'"damped", which cannot keep \[limits\]'):
        mbocp.load_problem(EXAMPLE).with_(solver={"method": "damped"}, limits={"effort": 1.0})

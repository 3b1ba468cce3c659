"""What is worked out when it is asked for: the same as if it had been there from the begin."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.solution import Solution
from mbocp.solution import read_solution as reading
from mbocp.solution._values import same
from mbocp.solution.later import LateField, complete, is_complete, retold

EXAMPLES = Path(__file__).parents[2] / "examples"
PENDULUM = EXAMPLES / "paper/rigid_pendulum.toml"
_MEASURES = ("constraint_violation", "limit_violation", "manifold_drift", "manifold_drift_resimulated")
_NOW = ("status", "cost", "qs", "vs", "us", "t", "eta", "iterations", "advice", "solver", "wall_time_s")
_USES: dict[str, Callable[[Solution], Any]] = {
    "adjoints": lambda solution: solution.mus,
    "text": lambda solution: solution.problem_text,
    "labels": lambda solution: solution.labels,
    "summary": lambda solution: solution.to_dict(),
    "comparison": lambda solution: solution == copy.copy(solution),
    "pickle": lambda solution: pickle.loads(pickle.dumps(solution)),
    "replace": lambda solution: dataclasses.replace(solution, advice="other"),
}


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[int]]:
    """How often the diagnostics were worked out, a number for each time."""
    taken, old = list[int](), reading.read_trajectory

    def counted(*arguments: Any) -> Any:
        taken.append(1)
        return old(*arguments)

    monkeypatch.setattr(reading, "read_trajectory", counted)
    return iter([taken])


def test_a_solve_works_out_no_diagnostics(asked: Iterator[list[int]]) -> None:
    taken = next(asked)
    solution = mbocp.solve(PENDULUM)
    values = [getattr(solution, name) for name in _NOW]
    assert solution.converged
    assert "converged" in repr(solution)
    assert not taken
    assert not is_complete(solution)
    assert solution.mus.shape == (solution.num_steps + 1, 2 * solution.nv)
    assert is_complete(solution)
    assert solution.lams.size
    assert solution.control_momenta is not None
    assert len(taken) == 1
    assert all(getattr(solution, name) is value for name, value in zip(_NOW, values, strict=True))


@pytest.mark.parametrize("file", ["paper/rigid_pendulum", "so3/unicycle_pendulum"])
def test_measures_are_had_one_by_one_and_are_those_of_the_whole(
    file: str, asked: Iterator[list[int]]
) -> None:
    taken = next(asked)
    path = EXAMPLES / f"{file}.toml"
    solution, other = mbocp.solve(path), mbocp.solve(path)
    complete(other)
    taken.clear()
    values = {name: getattr(solution, name) for name in _MEASURES}
    assert not taken
    assert not is_complete(solution)
    assert values == {name: getattr(other, name) for name in _MEASURES}
    assert {type(value) for value in values.values()} == {float}
    assert solution.ps.shape == other.ps.shape
    assert len(taken) == 1


@pytest.mark.parametrize("use", _USES)
def test_every_use_has_all_fields(use: str) -> None:
    solution = mbocp.solve(PENDULUM)
    found = _USES[use](solution)
    assert is_complete(solution)
    if isinstance(found, Solution):
        assert is_complete(found)
        assert found == dataclasses.replace(solution, advice=found.advice)


def test_fields_that_are_there_have_the_types_of_checked_ones() -> None:
    solution = mbocp.solve(PENDULUM)
    names = {field.name for field in dataclasses.fields(solution)}
    given = {name: value for name, value in vars(solution).items() if name in names}
    complete(solution)
    whole = Solution(**{field.name: getattr(solution, field.name) for field in dataclasses.fields(solution)})
    for name, value in given.items():
        checked = getattr(whole, name)
        assert type(value) is type(checked), name
        assert same(value, checked), name
        if isinstance(value, np.ndarray):
            assert not value.flags.writeable, name


def test_another_word_needs_no_diagnostics(asked: Iterator[list[int]]) -> None:
    taken = next(asked)
    solution = mbocp.solve(PENDULUM)
    other = retold(solution, advice="other")
    assert (other.advice, other.qs is solution.qs, taken) == ("other", True, [])
    assert other.mus.tobytes() == solution.mus.tobytes()
    assert other.advice == "other"
    assert solution.advice != "other"


def test_a_name_that_is_no_field_is_missing() -> None:
    with pytest.raises(AttributeError):
        LateField("mus").__get__(None)
    with pytest.raises(AttributeError, match="nonsense"):
        mbocp.solve(PENDULUM).nonsense  # noqa: B018

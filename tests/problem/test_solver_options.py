"""Options of the solver check themselves where a user makes them, without a file."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from mbocp.exceptions import InvalidValue
from mbocp.problem import SolverOptions
from mbocp.solvers.options import Options


@pytest.mark.parametrize(
    ("option", "value", "expected"),
    [
        ("method", "monolitic", "did you mean 'monolithic'"),
        ("loop", 3, r'"auto" \| "open" \| "closed"'),
        ("tolerance", -1e-9, "a positive number"),
        ("switch_cost", -0.5, "0 switches the criterion off"),
        ("switch_iterations", 2.5, "a whole number of at least 1"),
        ("time_limit", float("inf"), "a finite number"),
    ],
)
def test_what_cannot_be_is_refused_by_name(option: str, value: Any, expected: str) -> None:
    with pytest.raises(InvalidValue, match=rf"solver\.{option}: .*{expected}"):
        SolverOptions(**{option: value})
    with pytest.raises(InvalidValue, match=rf"solver\.{option}: "):
        replace(SolverOptions(), **{option: value})


def test_numbers_become_those_of_the_solver() -> None:
    options = SolverOptions(theta_max=1, switch_residual=0, time_limit=30)
    assert isinstance(options, Options)
    for value in (options.theta_max, options.switch_residual, options.time_limit):
        assert type(value) is float

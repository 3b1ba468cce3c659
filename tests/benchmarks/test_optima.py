"""Problems whose optimum is known."""

from __future__ import annotations

import pytest

from benchmarks.optima import CASES, Optimum


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_the_known_optimum_is_found(case: Optimum) -> None:
    found = [case.solve(steps) for steps in case.steps]
    assert all(solution.converged for solution in found)
    assert case.extrapolated([s.cost for s in found]) == pytest.approx(case.value, rel=case.tolerance)

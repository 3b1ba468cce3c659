"""A ball that an arm lets go lands in a bucket: twenty of twenty, on the parabola, held until then."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent.parent.parent))  # not part of the package

import mbocp
from benchmarks.throws import AWAY, LET_GO, STEP, TOLERANCE, Flight, buckets, flight_of, throw
from mbocp import Problem, Solution
from mbocp._arrays import Array

pytestmark = pytest.mark.slow

STICK = np.array([0.0, 0.0, 0.6])  # m: the ball in the frame of the tool
EXAMPLE = Path(__file__).parents[2] / "examples" / "arms" / "throw_into_bucket.toml"


def thrown(bucket: Array, **options: object) -> tuple[Problem, Solution, Flight]:
    problem = throw(bucket, **options)  # type: ignore[arg-type]
    solution = mbocp.solve(problem, check=True)
    return problem, solution, flight_of(problem, solution, bucket)


def test_twenty_of_twenty_land() -> None:
    for bucket in buckets(20):
        assert np.hypot(*bucket[:2]) == pytest.approx(AWAY)
        problem, solution, flight = thrown(bucket)
        assert flight.off < 1e-12
        assert flight.beside < TOLERANCE + 1e-6
        assert abs(solution.qs[-1, 8] - bucket[2]) < 0.005 + 1e-6
        assert flight.falls > 4.0  # steeply, from above
        np.testing.assert_allclose(solution.vs[-1, :6], 0.0, atol=1e-9)
        assert solution.limit_violation < 1e-6
        for n, q in enumerate(solution.qs):
            end = problem.robot.frame_placement("arm/tool0", q).act(STICK)
            apart = float(np.linalg.norm(end - q[6:9]))
            assert apart < 1e-9 if n <= LET_GO + 1 else apart > 1e-3
        np.testing.assert_allclose(solution.lams[LET_GO + 1 :], 0.0, atol=1e-12)  # after the parting
        assert flight.slips < 1e-9


def test_a_scheme_of_first_order_is_off_by_its_order() -> None:
    bucket = next(buckets(1))
    off = [thrown(bucket, scheme="se1", finer=finer)[2].off for finer in (1, 2)]
    assert off[0] == pytest.approx(9.81 / 2.0 * STEP * 0.8, rel=1e-6)
    assert off[1] == pytest.approx(off[0] / 2.0, rel=1e-6)


def test_ipopt_agrees() -> None:
    bucket = next(buckets(1))
    problem, solution, _ = thrown(bucket)
    other = mbocp.solve(problem, solver="ipopt", check=True, warm_start=solution)
    assert other.cost == pytest.approx(solution.cost, rel=1e-6)


def test_the_example_throws_into_its_bucket() -> None:
    """The ball leaves with the velocity of the stick, and falls into the opening."""
    problem = mbocp.load_problem(EXAMPLE)
    solution = mbocp.solve(problem, check=True)
    bucket = np.array([4.0, 0.0, 0.4])
    flight = flight_of(problem, solution, bucket)
    assert flight.slips < 1e-9
    assert flight.off < 1e-9
    assert flight.beside <= TOLERANCE + 1e-9
    assert flight.falls > 0.0

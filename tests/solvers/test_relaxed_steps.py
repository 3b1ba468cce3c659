"""Newton steps that nobody judges: taken as long as they lead somewhere, and taken back where they do not."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import mbocp

SPHERE = Path(__file__).parents[2] / "examples" / "paper" / "rigid_pendulum.toml"


@pytest.mark.parametrize("slide", [0.0, 1e-6, 1e-3, 5e-2, -5e-2])
def test_a_run_goes_on_while_it_halves_the_residual(slide: float) -> None:
    """The end condition is nearly singular at the guess, and the first step leads far out."""
    start = [0.0, 5.406947424340803 + slide, 4.261553452260436]
    s = mbocp.solve(mbocp.load_problem(SPHERE, {"start.p": start}), solver="monolithic")
    assert s.converged, s.advice
    relaxed = [r.residual for r in s.history[1:7]]
    assert max(relaxed) > 1e4
    assert all(after < before for before, after in pairwise(relaxed))


def test_random_throws_across_a_sphere_arrive() -> None:
    rng = np.random.default_rng(5)
    for start in rng.uniform([0.0, 5.0, -5.0], [0.0, 15.0, 5.0], (30, 3)):
        s = mbocp.solve(mbocp.load_problem(SPHERE, {"start.p": start.tolist(), "horizon.steps": 40}))
        assert s.converged, (start, s.advice)

"""Stages in lanes are those one by one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue
from mbocp.formulation import formulate
from mbocp.guesses import guess_candidates, make_guess
from mbocp.programme import StagewiseProgramme
from mbocp.programme.kernel import kernel_programme
from mbocp.programme.native_modules import has_avx2, has_lanes, number_of_lanes

EXAMPLES = Path(__file__).parents[2] / "examples"
needs_lanes = pytest.mark.skipif(not has_lanes(), reason="the processor has no vectors that are known")


def test_the_number_of_lanes_can_be_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MBOCP_LANES", "1")
    assert number_of_lanes() == 1
    monkeypatch.setenv("MBOCP_LANES", "3")
    with pytest.raises(InvalidValue, match="one of the numbers 1, 4, 8"):
        number_of_lanes()
    monkeypatch.delenv("MBOCP_LANES")
    assert number_of_lanes() in ((4, 8) if has_lanes() else (1,))


def test_another_kind_of_processor_has_no_avx2(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    assert not has_avx2()
    assert number_of_lanes() == 4  # of NEON
    monkeypatch.setattr("platform.machine", lambda: "riscv64")
    assert number_of_lanes() == 1


def evaluated(problem: mbocp.Problem, number: int, monkeypatch: pytest.MonkeyPatch) -> dict[str, Array]:
    """What the kernel makes of the problem's first guess, moved at random."""
    monkeypatch.setenv("MBOCP_LANES", str(number))
    formulation = formulate(problem)
    iterate, _ = make_guess(guess_candidates(problem)[0], formulation)
    programme: StagewiseProgramme = formulation.programme
    has_limits = not programme.bounds.is_empty or programme.num_guards > 0
    native = kernel_programme(programme, has_limits=has_limits)
    iterate.load_into(native)
    random = np.random.default_rng(3)
    native.u = native.u + 0.1 * random.normal(size=native.u.size)
    native.m = random.normal(size=native.m.size)
    if has_limits:
        native.start_limits(1e-2)
    found = native.evaluate()
    out = {"evaluation": np.array([found.cost, found.residual, found.violation, found.objective])}
    out["costates"], out["controls"] = native.costates, native.control_gradient
    native.factorise(1.0, 10.0)
    native.solve()
    trial = native.trial(1e-3)
    out["trial"] = np.array([trial.objective, trial.violation])
    return out


PROBLEMS = {
    "natural coordinates": ("paper/rigid_pendulum.toml", "horizon.steps=23"),
    "a closed loop": ("loops/four_bar.toml", "horizon.steps=21"),
    "a free flyer with path constraints": ("free_flyer/gates.toml", "integrator.scheme=se1"),
    "obstacles": ("arms/slalom.toml", "integrator.scheme=se1"),
}
EIGHT = [("a closed loop", 8), ("obstacles", 8)]


@needs_lanes
@pytest.mark.parametrize(("what", "number"), [*((what, 4) for what in PROBLEMS), *EIGHT])
def test_stages_in_lanes_are_those_one_by_one(
    what: str, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Residuals, derivatives and trial points, with a horizon that does not fill the last group."""
    file, *settings = PROBLEMS[what]
    problem = mbocp.load_problem(EXAMPLES / file, settings)
    one, together, again = (evaluated(problem, n, monkeypatch) for n in (1, number, number))
    for name, expected in one.items():
        size = max(1.0, float(np.abs(expected).max()))
        assert np.allclose(together[name], expected, rtol=1e-12, atol=1e-12 * size), name
        assert np.array_equal(again[name], together[name]), name


@needs_lanes
def test_a_stage_that_is_no_number_stays_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MBOCP_LANES", "4")
    problem = mbocp.load_problem(EXAMPLES / "loops" / "four_bar.toml", ["horizon.steps=21"])
    formulation = formulate(problem)
    iterate, _ = make_guess(guess_candidates(problem)[0], formulation)
    native = kernel_programme(formulation.programme)
    iterate.load_into(native)
    native.evaluate()
    before = native.control_gradient.reshape(21, -1)
    u = native.u.reshape(21, -1)
    u[9] = np.nan
    native.u = u.ravel()
    assert not native.evaluate().finite
    after = native.control_gradient.reshape(21, -1)
    assert np.isnan(after[9]).any()
    others = np.arange(21) != 9
    assert np.array_equal(after[others], before[others])

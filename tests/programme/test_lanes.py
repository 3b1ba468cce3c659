"""Functions at several stages at once: the numbers of one at a time, and lanes that never meet."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import mbocp
from mbocp._arrays import Array
from mbocp.exceptions import InvalidValue
from mbocp.formulation import formulate
from mbocp.guesses import guess_candidates, make_guess
from mbocp.programme import StagewiseProgramme, library
from mbocp.programme.compilation import load_functions
from mbocp.programme.kernel import kernel_programme
from mbocp.programme.lanes import in_lanes
from mbocp.programme.processor import has_avx2, number_of_lanes

EXAMPLES = Path(__file__).parents[2] / "examples"
needs_avx2 = pytest.mark.skipif(not has_avx2(), reason="the processor has no AVX2")


def function_of(
    unary: list[Callable[[ca.SX], ca.SX]], binary: list[Callable[[ca.SX, ca.SX], ca.SX]]
) -> ca.Function:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    values = [f(x) for f in unary] + [f(x, y) for f in binary]
    return ca.Function("f", [x, y], [ca.vertcat(*values), ca.SX(1, 2), ca.DM([0.0, 1.5])])


UNARY: list[Callable[[ca.SX], ca.SX]] = [
    *(ca.sin, ca.cos, ca.tan, ca.atan, ca.tanh, ca.sinh, ca.exp, ca.fabs, ca.sign, ca.floor, ca.ceil),
    *(ca.sqrt, ca.log, ca.log1p, ca.expm1, ca.asin, ca.acos, ca.logic_not, ca.erf, ca.asinh),
    *(lambda a: -a, lambda a: 2 * a, lambda a: 1 / a, lambda a: a * a, lambda a: ca.SX(0.25)),
]
BINARY: list[Callable[[ca.SX, ca.SX], ca.SX]] = [
    *(ca.atan2, ca.fmin, ca.fmax, ca.hypot, ca.fmod, ca.copysign, ca.logic_and, ca.logic_or),
    *(lambda a, b: a**b, lambda a, b: a < b, lambda a, b: a <= b, lambda a, b: a == b, lambda a, b: a != b),
    *(lambda a, b: ca.if_else(a < b, a, ca.sin(b)), lambda a, b: ca.if_else(b, a, 3), lambda a, b: a / b),
]


def at_once(library: Path, number: int, xs: Array, ys: Array, rows: int) -> Array:
    """Values of the first output, lane by lane."""
    f = ctypes.CDLL(str(library))
    assert f.f_num_lanes() == number
    pointer = ctypes.POINTER(ctypes.c_double)

    def aligned(size: int) -> Array:
        block = np.full(size * number + 8, np.nan)
        return block[-block.ctypes.data // 8 % 8 :][: size * number]

    inputs = [aligned(1), aligned(1)]
    inputs[0][:], inputs[1][:] = xs, ys
    outputs = [aligned(rows), aligned(1), aligned(2)]
    arg = (pointer * 2)(*(a.ctypes.data_as(pointer) for a in inputs))
    res = (pointer * 3)(*(a.ctypes.data_as(pointer) for a in outputs))
    f.f_in_lanes(arg, res)
    assert np.array_equal(outputs[2].reshape(2, number), np.outer([0.0, 1.5], np.ones(number)))
    return outputs[0].reshape(rows, number).T


@needs_avx2
@pytest.mark.parametrize(("number", "worth_optimising"), [(4, 1000), (8, 1000), (4, 10)])
def test_every_operation_in_lanes(
    number: int, worth_optimising: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each lane has the numbers of CasADi's virtual machine, whatever is in the others."""
    monkeypatch.setattr(library, "_LARGE", worth_optimising)
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("MBOCP_LANES", str(number))
    f = function_of(UNARY, BINARY)
    functions = load_functions("every operation", lambda: {"f": f}, in_lanes=["f"])
    assert functions.library is not None
    random = np.random.default_rng(1)
    usual = np.array([0.0, 1.0, -1.0, 0.5, 1e5, -1e5, 1e9, -3e22, 5e-324, 1e300, np.inf, -np.inf, np.nan])
    xs = np.concatenate([random.normal(size=19), usual, 100 * random.normal(size=24), usual])
    ys = np.concatenate(
        [random.normal(size=19), usual[::-1], xs[32:40], random.normal(size=16), np.zeros(13)]
    )
    xs, ys = xs[: xs.size // 8 * 8], ys[: ys.size // 8 * 8]
    compiled = functions.function("f")
    for i in range(0, xs.size, number):
        found = at_once(functions.library, number, xs[i : i + number], ys[i : i + number], f.nnz_out(0))
        for lane in range(number):
            expected = f(xs[i + lane], ys[i + lane])[0].full().ravel()
            scale = 4e-16 * np.where(np.isfinite(expected), np.abs(expected), 0.0)
            same = (found[lane] == expected) | (np.isnan(found[lane]) & np.isnan(expected))
            with np.errstate(invalid="ignore"):  # infinity less itself
                close = np.abs(found[lane] - expected) <= scale
            assert np.all(same | close)
            alone = compiled(xs[i + lane], ys[i + lane])[0].full().ravel()
            assert np.array_equal(alone, found[lane], equal_nan=True)


@needs_avx2
def test_sines_are_accurate_near_multiples_of_pi(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Relative errors of an ulp, also where almost all digits of the argument go."""
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("MBOCP_LANES", "4")
    f = function_of([ca.sin, ca.cos], [])
    library = load_functions("sines", lambda: {"f": f}, in_lanes=["f"]).library
    assert library is not None
    multiples = np.arange(-2000, 2000) * (np.pi / 2)
    random = np.random.default_rng(2)
    xs = np.concatenate([multiples, np.nextafter(multiples, np.inf), random.uniform(-1e5, 1e5, 4000)])
    found = np.array([at_once(library, 4, x, x, 2) for x in xs.reshape(-1, 4)]).reshape(-1, 2)
    for column, exact in zip(found.T, (np.sin(xs), np.cos(xs)), strict=True):
        assert np.all(np.abs(column - exact) <= np.spacing(np.abs(exact)))


def test_an_unknown_form_stays_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert in_lanes("a1[3]") is None
    assert in_lanes("(a1?a2:a3)") is None
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path))
    x = ca.MX.sym("x", 3)
    f = ca.Function("f", [x], [ca.norm_2(ca.sin(x))])  # loops over vectors
    library = load_functions("a loop", lambda: {"f": f}, in_lanes=["f"]).library
    assert library is not None
    assert not hasattr(ctypes.CDLL(str(library)), "f_in_lanes")


def test_the_number_of_lanes_can_be_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MBOCP_LANES", "1")
    assert number_of_lanes() == 1
    monkeypatch.setenv("MBOCP_LANES", "3")
    with pytest.raises(InvalidValue, match="one of the numbers 1, 4, 8"):
        number_of_lanes()
    monkeypatch.delenv("MBOCP_LANES")
    assert number_of_lanes() in ((4, 8) if has_avx2() else (1,))


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


@needs_avx2
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


@needs_avx2
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

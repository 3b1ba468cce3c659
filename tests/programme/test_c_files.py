"""Functions in C: the numbers of CasADi's virtual machine, and those of tapes to the last bit."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mbocp._arrays import Array
from mbocp.exceptions import CompilationError
from mbocp.programme import c_files, library
from mbocp.programme.compilation import load_functions
from mbocp.programme.compiler import compiler
from mbocp.programme.native_modules import has_lanes, kernel, number_of_lanes
from mbocp.programme.tapes import as_operations
from mbocp.symbolic.columns import STAYS_A_CALL, WHERE_ANY, add_chosen_columns, choose_columns
from tests.programme.test_tape import STEP, built

pytestmark = [
    pytest.mark.usefixtures("compiled"),
    pytest.mark.skipif(compiler() is None, reason="no C compiler"),
]
COUNT = 19  # stages, which no number of lanes divides
SIZES = (3, 2)  # of the inputs of `calling`


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path))


def compare(function: ca.Function, inputs: Sequence[Array], *, is_exact: bool) -> None:
    """In lanes and one by one, with a tape of as many lanes, and with CasADi."""
    compiled = load_functions(function.serialize(), lambda: {function.name(): function})
    assert compiled.library is not None
    tape = kernel().StageFunction.of(as_operations(function))
    native = compiled.stage_function(function.name())
    assert native.num_lanes == number_of_lanes()
    flat, count = [array.ravel() for array in inputs], len(inputs[0])
    in_lanes = native.evaluate(flat, count, True)
    for other in (native.evaluate(flat, count, False), native.copy().evaluate(flat, count, True)):
        assert_same(other, in_lanes)
    if is_exact:
        for is_in_lanes in (True, False):
            assert_same(tape.evaluate(flat, count, is_in_lanes), in_lanes)
    external, shapes = (
        compiled.function(function.name()),
        [function.sparsity_in(i) for i in range(len(inputs))],
    )
    for n, row in enumerate(zip(*inputs, strict=True)):
        stage = [ca.DM(shape, values) for shape, values in zip(shapes, row, strict=True)]
        together = zip(function.call(stage), external.call(stage), in_lanes, strict=True)
        for exact, alone, values in together:
            of_stage = values.reshape(count, -1)[n]
            assert alone.sparsity() == exact.sparsity()
            np.testing.assert_array_equal(np.array(alone.nonzeros()), of_stage)
            finite = np.isfinite(exact.nonzeros())
            np.testing.assert_array_equal(np.isfinite(of_stage), finite)
            expected = np.array(exact.nonzeros())[finite]
            np.testing.assert_allclose(of_stage[finite], expected, rtol=1e-9, atol=1e-11)


def assert_same(found: Sequence[Array], expected: Sequence[Array]) -> None:
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_array_equal(a, b)


def at_random(function: ca.Function, count: int = COUNT) -> list[Array]:
    rng = np.random.default_rng(count)
    return [rng.uniform(-3.0, 3.0, (count, function.nnz_in(i))) for i in range(function.n_in())]


@given(st.lists(STEP, max_size=900))
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_function_has_the_numbers_of_its_tape(steps: list[tuple[int, int, int]]) -> None:
    """Of several pieces, too."""
    function = built(steps)
    compare(function, at_random(function), is_exact=True)


UNARY: list[Callable[[ca.SX], ca.SX]] = [
    *(ca.sin, ca.cos, ca.tan, ca.atan, ca.tanh, ca.sinh, ca.cosh, ca.exp, ca.fabs, ca.sign, ca.floor),
    *(ca.sqrt, ca.log, ca.log1p, ca.expm1, ca.asin, ca.acos, ca.logic_not, ca.erf, ca.asinh, ca.acosh),
    *(ca.ceil, ca.atanh, lambda a: -a, lambda a: 2 * a, lambda a: 1 / a, lambda a: a * a),
]
BINARY: list[Callable[[ca.SX, ca.SX], ca.SX]] = [
    *(ca.atan2, ca.fmin, ca.fmax, ca.hypot, ca.fmod, ca.copysign, ca.logic_and, ca.logic_or, ca.remainder),
    *(lambda a, b: a**b, lambda a, b: a < b, lambda a, b: a <= b, lambda a, b: a == b, lambda a, b: a != b),
    *(lambda a, b: ca.if_else(a < b, a, ca.sin(b)), lambda a, b: ca.if_else(b, a, 3), lambda a, b: a / b),
]
SPECIAL = np.array([0.0, 1.0, -1.0, 0.5, 1e5, -1e5, 1e9, -3e22, 5e-324, 1e300, np.inf, -np.inf, np.nan])


@pytest.mark.parametrize("lanes", [1, 4, 8])
def test_every_operation(lanes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each lane has the numbers of CasADi's virtual machine, whatever is in the others."""
    if lanes > 1 and not has_lanes():
        pytest.skip("the processor has no vectors that are known")
    monkeypatch.setenv("MBOCP_LANES", str(lanes))
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    values = [f(x) for f in UNARY] + [f(x, y) for f in BINARY]
    f = ca.Function("f", [x, y], [ca.vertcat(*values), ca.SX(1, 2), ca.DM([0.0, 1.5])])
    random = np.random.default_rng(1)
    xs = np.concatenate([random.normal(size=19), SPECIAL, 100 * random.normal(size=24), SPECIAL])
    ys = np.concatenate(
        [random.normal(size=19), SPECIAL[::-1], xs[32:40], random.normal(size=16), 0 * xs[:13]]
    )
    compiled = load_functions("every operation", lambda: {"f": f})
    found = compiled.stage_function("f").evaluate([xs, ys], xs.size, True)
    alone = compiled.stage_function("f").evaluate([xs, ys], xs.size, False)
    assert_same(alone, found)
    for row, a, b in zip(found[0].reshape(xs.size, -1), xs, ys, strict=True):
        expected = np.array(f(a, b)[0].nonzeros())
        scale = 4e-16 * np.where(np.isfinite(expected), np.abs(expected), 0.0)
        same = (row == expected) | (np.isnan(row) & np.isnan(expected))
        with np.errstate(invalid="ignore"):  # infinity less itself
            assert np.all(same | (np.abs(row - expected) <= scale))
    assert np.array_equal(found[2].reshape(-1, 2), np.tile([0.0, 1.5], (xs.size, 1)))


def test_sines_are_accurate_near_multiples_of_pi() -> None:
    """Relative errors of an ulp, also where almost all digits of the argument go."""
    x = ca.SX.sym("x")
    f = ca.Function("f", [x], [ca.sin(x), ca.cos(x)])
    multiples = np.arange(-2000, 2000) * (np.pi / 2)
    random = np.random.default_rng(2)
    xs = np.concatenate([multiples, np.nextafter(multiples, np.inf), random.uniform(-1e5, 1e5, 4000)])
    found = load_functions("sines", lambda: {"f": f}).stage_function("f").evaluate([xs], xs.size, True)
    for values, exact in zip(found, (np.sin(xs), np.cos(xs)), strict=True):
        assert np.all(np.abs(values - exact) <= np.spacing(np.abs(exact)))


def calling() -> ca.Function:
    """A function that calls two others, one of which calls the other, with inputs, parts, and values."""
    a, b = ca.SX.sym("a", 2), ca.SX.sym("b", 2)
    inner = ca.Function("inner", [a, b], [ca.sin(a) * b, ca.densify(ca.diag(a * b)), ca.dot(a, b)])
    first, _, third = inner.call([b, a + 1], False, True)
    middle = ca.Function("middle", [a, b], [first - a, third * ca.cos(b)])
    x, y = ca.SX.sym("x", SIZES[0]), ca.SX.sym("y", SIZES[1])
    p, matrix, product = inner.call([x[:2], y], False, True)
    q, r = middle.call([ca.vertcat(p[1], 2 * product), x[1:]], False, True)
    p2, _, _ = inner.call([q, p + r], False, True)
    return ca.Function("f", [x, y], [p2 + y, matrix @ q, p - r * x[0], product])


@pytest.mark.parametrize("lanes", ["1", "4", "8"])
def test_calls_have_the_numbers_of_what_is_written_out(lanes: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if lanes != "1" and not has_lanes():
        pytest.skip("the processor has no vectors that are known")
    monkeypatch.setenv("MBOCP_LANES", lanes)
    # sines of more lanes than one are not the library's
    compare(calling(), at_random(calling()), is_exact=int(lanes) > 1 or not has_lanes())


def test_what_is_called_is_written_once() -> None:
    text = "".join(c_files.CText.of([calling()]).files(4, 1))
    assert text.count("=mbocp_sin(v") + text.count("=mbocp_sin(x") == 2  # both angles of the inner one
    assert text.count("void f_f0_0(") == 2  # declared and defined


def loops() -> ca.Function:
    """(x, which) -> values of a function of chosen columns, their sums, and what is added up by column."""
    columns, calls = 5, 7
    x, which = ca.MX.sym("x", 3), ca.MX.sym("which", calls)
    q = ca.SX.sym("q", 3)
    angles = (ca.SX(np.arange(1.0, columns + 1)) * q[0] + q[1]).T
    table = ca.Function("table", [q], [ca.vertcat(ca.sin(angles) * q[2], ca.cos(angles))])
    a, b = ca.SX.sym("a", 2), ca.SX.sym("b", 2)
    values = [a * b[0], ca.vertcat(a[0] + b[1], ca.cos(a[1]) * b[0])]
    part = ca.Function("part", [a, b], values, STAYS_A_CALL)
    chosen = choose_columns(table(x), which)
    found = part.map(calls)(chosen, ca.vertcat(which.T, 2.0 * which.T))
    added = add_chosen_columns(columns, which, found[0])
    return ca.Function("f", [x, which], [ca.horzcat(*found), ca.repsum(found[1], 1, calls), added.T])


@pytest.mark.parametrize("do_lanes_agree", [True, False])
def test_columns_are_chosen_in_each_lane(do_lanes_agree: bool) -> None:
    random = np.random.default_rng(0)
    which = random.integers(0, 5, (COUNT, 7)).astype(float)
    if do_lanes_agree:
        which[:] = which[0]
    compare(loops(), [random.normal(size=(COUNT, 3)), which], is_exact=True)


def test_numbers_beyond_the_columns_choose_nothing() -> None:
    which = np.tile([0.0, 4.0, 5.0, -1.0, np.nan, 1e300, 2.0], (COUNT, 1))
    x = np.random.default_rng(1).normal(size=(COUNT, 3))
    native = load_functions("loops", lambda: {"f": loops()}).stage_function("f")
    tape = kernel().StageFunction.of(as_operations(loops()))
    inputs = [x.ravel(), which.ravel()]
    assert_same(native.evaluate(inputs, COUNT, True), tape.evaluate(inputs, COUNT, True))


def test_what_is_zero_in_all_lanes_is_not_called() -> None:
    is_any, x = ca.SX.sym("is_any"), ca.SX.sym("x", 2)
    ahead = ca.Function(WHERE_ANY, [is_any, x], [x + 1], STAYS_A_CALL)  # not zero: so that it shows
    f = ca.Function("f", [is_any, x], [ahead.call([is_any, x], False, True)[0]])
    native = load_functions("ahead", lambda: {"f": f}).stage_function("f")
    lanes = max(native.num_lanes, 2)
    xs, flags = np.arange(4.0 * lanes).reshape(-1, 2), np.zeros(2 * lanes)
    flags[1] = 1.0
    (found,) = native.evaluate([flags, xs.ravel()], 2 * lanes, True)
    is_called = np.arange(2 * lanes) < native.num_lanes if native.num_lanes > 1 else flags > 0
    np.testing.assert_array_equal(found.reshape(-1, 2), np.where(is_called[:, None], xs + 1.0, 0.0))


def test_what_is_no_number_stays_in_its_lane() -> None:
    random = np.random.default_rng(1)
    x, which = random.normal(size=(COUNT, 3)), random.integers(0, 5, (COUNT, 7)).astype(float)
    native = load_functions("loops", lambda: {"f": loops()}).stage_function("f")
    before = [a.reshape(COUNT, -1) for a in native.evaluate([x.ravel(), which.ravel()], COUNT, True)]
    x[2, 0] = np.nan
    after = [a.reshape(COUNT, -1) for a in native.evaluate([x.ravel(), which.ravel()], COUNT, True)]
    others = np.arange(COUNT) != 2
    for found, expected in zip(after, before, strict=True):
        assert np.isnan(found[2]).any()
        assert np.array_equal(found[others], expected[others])


def test_arrays_may_be_missing() -> None:
    """Inputs that are not there are zero, and outputs need not be asked for."""
    f = calling()
    call = ctypes.CDLL(str(load_functions("missing", lambda: {"f": f}).library)).f
    pointer = ctypes.POINTER(ctypes.c_double)
    room = np.zeros(load_functions("missing", lambda: {"f": f}).function("f").sz_w() + 1)
    rng = np.random.default_rng(0)
    for given_inputs in ((True, False), (False, True), (False, False)):
        inputs = [rng.normal(size=n) if there else None for n, there in zip(SIZES, given_inputs, strict=True)]
        zeros = [np.zeros(n) if a is None else a for a, n in zip(inputs, SIZES, strict=True)]
        outputs = [np.full(f.nnz_out(i), np.nan) if i % 2 else None for i in range(f.n_out())]
        args, ress = (
            (pointer * len(arrays))(*(pointer() if a is None else a.ctypes.data_as(pointer) for a in arrays))
            for arrays in (inputs, outputs)
        )
        assert call(args, ress, None, room.ctypes.data_as(pointer), 0) == 0
        for found, expected in zip(outputs, f.call(zeros), strict=True):
            if found is not None:
                np.testing.assert_allclose(found, np.array(expected.nonzeros()), rtol=1e-13, atol=1e-13)


def with_table() -> ca.Function:
    """CasADi alone can write it."""
    x, y = ca.MX.sym("x", SIZES[0]), ca.MX.sym("y", SIZES[1])
    table = ca.interpolant("table", "linear", [np.linspace(-5.0, 5.0, 11)], np.linspace(0.0, 1.0, 11) ** 2)
    return ca.Function("g", [x, y], [table(x[0]) * y, ca.sin(x)])


def test_what_is_no_operation_is_written_by_casadi() -> None:
    """Beside others, in a file of its own."""
    functions = {"f": calling(), "g": with_table()}
    compiled = load_functions("both", lambda: functions)
    point = [np.linspace(0.1, 1.0, n) for n in SIZES]
    for name, function in functions.items():
        for found, expected in zip(compiled.function(name)(*point), function(*point), strict=True):
            np.testing.assert_allclose(np.asarray(found), np.asarray(expected), rtol=1e-13)
    assert compiled.stage_function("g").num_lanes == 1


def drawn_out() -> ca.Function:
    x, y = ca.SX.sym("x", SIZES[0]), ca.SX.sym("y", SIZES[1])
    values = [*ca.vertsplit(x), *ca.vertsplit(y)]
    for i in range(700):
        values.append(
            ca.sin(values[-1]) * values[i % 5] + values[-3] / (2 + ca.cos(values[(7 * i) % (i + 5)]))
        )
    return ca.Function("drawn_out", [x, y], [ca.vertcat(*values[-4:])])


def test_files_of_any_number_have_the_same_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(c_files, "_LEAST", 100)
    seen: list[int] = []
    run = library.run_compiler

    def counted(*arguments: object, **options: list[list[str]]) -> None:
        seen.append(len(options.get("before", [])))
        run(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(library, "run_compiler", counted)
    inputs, found = [a.ravel() for a in at_random(drawn_out())], []
    for count in (1, 3):
        monkeypatch.setattr(library, "available_threads", lambda count=count: count)
        monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path / str(count)))
        made = load_functions(f"in {count} files", lambda: {"drawn_out": drawn_out()})
        found.append(made.stage_function("drawn_out").evaluate(inputs, COUNT, True))
        load_functions("again, in one", lambda: {"drawn_out": drawn_out()})  # the same library
    assert seen == [0, 3]
    assert_same(*found)


@pytest.mark.parametrize("bad", ["stage0.c", "stage1.c", "stage0.o"])
def test_a_file_that_fails_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bad: str) -> None:
    cc, script = compiler(), tmp_path / "cc"
    assert cc is not None
    script.write_text(
        f'#!/bin/sh\nfor word in "$@"; do last=$word; case "$word" in */{bad}) is_bad=1;; esac; done\n'
        f'if [ "$is_bad" ] && {{ [ {bad} != stage0.o ] || [ "$last" = -lm ]; }}\n'
        f'then echo "no {bad} today"; exit 3; fi\nexec {cc[0]} "$@"\n'
    )
    script.chmod(0o700)
    monkeypatch.setenv("CC", str(script))
    monkeypatch.setattr(c_files, "_LEAST", 100)
    monkeypatch.setattr(library, "available_threads", lambda: 2)
    with pytest.raises(CompilationError, match=rf"(?s)C compiler .*/cc failed .*exit 3.*no {bad} today"):
        load_functions("several", lambda: {"drawn_out": drawn_out()})

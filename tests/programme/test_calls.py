"""Functions of known statements that call others: in pieces, in lanes, and with fewer divisions and sines."""

from __future__ import annotations

import ctypes
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from mbocp._arrays import Array
from mbocp.programme.compilation import load_functions
from mbocp.programme.compiler import compiler
from mbocp.programme.generated import Function, Statement
from mbocp.programme.lanes import Lanes
from mbocp.programme.processor import has_avx2
from mbocp.programme.rewriting import with_reciprocals, with_sines
from mbocp.programme.splitting import split_functions

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler")
SIZES = (3, 2)


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


def text_of(function: ca.Function) -> str:
    generator = ca.CodeGenerator("f.c")
    generator.add(function)
    return str(generator.dump())


@needs_compiler
@pytest.mark.parametrize("lanes", ["1", "4", "8"])
def test_calls_give_the_numbers_of_the_virtual_machine(
    lanes: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("MBOCP_LANES", lanes)
    f = calling()
    compiled = load_functions("calls", lambda: {"f": f}, in_lanes=["f"]).function("f")
    random = np.random.default_rng(0)
    for _ in range(20):
        inputs = [random.uniform(-2, 2, size) for size in SIZES]
        for found, wanted in zip(compiled.call(inputs), f.call(inputs), strict=True):
            assert np.allclose(found.full(), wanted.full(), rtol=1e-14, atol=1e-14)


@pytest.mark.skipif(not has_avx2(), reason="the processor has no AVX2")
def test_every_lane_has_calls_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MBOCP_CACHE_DIR", str(tmp_path))
    monkeypatch.setenv("MBOCP_LANES", "4")
    f = calling()
    functions = load_functions("calls in lanes", lambda: {"f": f}, in_lanes=["f"])
    library = ctypes.CDLL(str(functions.library))
    random, pointer = np.random.default_rng(1), ctypes.POINTER(ctypes.c_double)
    inputs = [aligned(random.uniform(-2, 2, (size, 4))) for size in SIZES]
    outputs = [aligned(np.zeros((f.numel_out(i), 4))) for i in range(f.n_out())]
    passed = [(pointer * len(a))(*(one.ctypes.data_as(pointer) for one in a)) for a in (inputs, outputs)]
    assert library.f_in_lanes(*passed) == 0
    for lane in range(4):
        for found, wanted in zip(outputs, f(*(a[:, lane] for a in inputs)), strict=True):
            assert np.allclose(found[:, lane], np.array(wanted).ravel(order="F"), rtol=1e-14, atol=1e-14)


def aligned(values: Array) -> Array:
    block = np.zeros(values.size + 8)
    found = block[-block.ctypes.data // 8 % 8 :][: values.size].reshape(values.shape)
    found[:] = values
    return found


def test_what_is_called_is_written_once() -> None:
    """Three calls, two of them in one function, and one copy of the sines."""
    for split in (split_functions(text_of(calling()), 3), in_lanes(text_of(calling()))):
        assert split.count("=sin(a") + split.count("=mbocp_sin(a") == 2


def in_lanes(text: str) -> str:
    return split_functions(text, 3, Lanes(4, frozenset(["f"])))


@pytest.mark.parametrize(
    "line", ["if (casadi_f9(arg+1, res+2, iw, w+10, 0)) return 1;", "arg[3]=w+1;", "w[2] = a0;"]
)
def test_calls_of_another_form_leave_a_function_as_it_is(line: str) -> None:
    text = text_of(calling())
    start = text.index("/* f:")
    changed = text[:start] + text[start:].replace("  return 0;\n", f"  {line}\n  return 0;\n", 1)
    own = changed[changed.index("static int", start) : changed.index("CASADI_SYMBOL_EXPORT int f(")]
    for split in (split_functions(changed), in_lanes(changed)):
        assert own in split
        assert "f_in_lanes" not in split


def function(*lines: tuple[str, str]) -> Function:
    """Statements of `target`, `value`."""
    variables = {target for target, _ in lines}
    made = [
        Statement(target, value, target, tuple(v for v in sorted(variables) if v in value))
        for target, value in lines
    ]
    return Function("f", tuple(made), (), ())


def values(function: Function) -> list[str]:
    return [s.value for s in function.statements]


def test_divisions_by_one_number_are_products_as_long_as_it_is_the_same() -> None:
    given = [
        ("a0", "x0[0]"),
        ("a1", "x0[1]"),
        *[("a2", "(a1/a0)")] * 3,
        ("a0", "x0[2]"),
        *[("a3", "(a2/a0)")] * 2,
    ]
    found = values(with_reciprocals(function(*given)))
    assert found.count("(1./a0)") == 1
    assert sum("*" in value for value in found) == 3
    assert found[-2:] == ["(a2/a0)"] * 2  # another number, and not often


def test_a_divisor_that_divides_itself_is_another_one_afterwards() -> None:
    found = values(with_reciprocals(function(("a0", "x0[0]"), *[("a0", "(a0/a0)")] * 4)))
    assert found == ["x0[0]", *["(a0/a0)"] * 4]


def test_sine_and_cosine_of_an_angle_are_one_call_as_long_as_it_is_the_same() -> None:
    sine, cosine = "mbocp_sin(a0)", "mbocp_cos(a0)"
    both = with_sines(function(("a0", "x0[0]"), ("a1", cosine), ("a2", sine)))
    assert values(both) == ["x0[0]", "mbocp_cos_and_sin(a0,c+0)", "c[0]"]
    assert both.num_passed == 1
    apart = function(("a0", "x0[0]"), ("a1", cosine), ("a0", "x0[1]"), ("a2", sine))
    assert with_sines(apart) == apart
    own = function(("a0", "x0[0]"), ("a0", cosine), ("a1", sine))  # the sine of a cosine
    assert with_sines(own) == own

"""Generated C in pieces: the same numbers, and nothing that is not known is touched."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbocp._arrays import Array
from mbocp.programme.compiler import compiler
from mbocp.programme.splitting import split_functions

needs_compiler = pytest.mark.skipif(compiler() is None, reason="no C compiler")
SIZES = (3, 2)  # of the inputs of `tangled`


def generated(functions: Sequence[ca.Function], folder: Path) -> str:
    generator = ca.CodeGenerator("f.c")
    for function in functions:
        generator.add(function)
    generator.generate(f"{folder}/")
    return (folder / "f.c").read_text()


def tangled() -> ca.Function:
    """Every operation that stage functions have, with values that live long, short and never end."""
    x, y = ca.SX.sym("x", SIZES[0]), ca.SX.sym("y", SIZES[1])
    values = [*ca.vertsplit(x), *ca.vertsplit(y), ca.SX(0.25), ca.SX(0.0)]
    unary = [ca.sin, ca.cos, ca.fabs, ca.sign, lambda a: ca.sqrt(a * a + 1), lambda a: -a, lambda a: 2 * a]
    for i in range(60):
        a, b, c = values[-1], values[(7 * i) % len(values)], values[(3 * i + 1) % len(values)]
        values.append(ca.if_else(a < b, unary[i % len(unary)](a), ca.fmin(b, 3) * c / (1 + b * b)))
        values.append(ca.atan2(values[-1], 1 + c * c) + ca.logic_and(a > 0, b <= c) - 1 / (2 + ca.cos(b)))
    sums = ca.vertcat(*values[-4:])
    outputs = [sums, ca.jacobian(ca.sum1(sums), x), ca.SX(1, 3), ca.DM([0.0, 1.5])]
    return ca.Function("tangled", [x, y], outputs)


@dataclass(frozen=True)
class Library:
    """A compiled function that is called with or without its arrays."""

    function: ca.Function
    path: Path

    def __call__(self, inputs: Sequence[Array | None], wanted: Sequence[bool]) -> list[Array | None]:
        call = getattr(ctypes.CDLL(str(self.path)), self.function.name())
        pointer, f = ctypes.POINTER(ctypes.c_double), self.function
        nowhere = pointer()
        results = [np.full(f.nnz_out(i), np.nan) if w else None for i, w in enumerate(wanted)]
        arg = [nowhere if a is None else a.ctypes.data_as(pointer) for a in inputs]
        res = [nowhere if r is None else r.ctypes.data_as(pointer) for r in results]
        args, ress = (pointer * max(1, f.sz_arg()))(*arg), (pointer * max(1, f.sz_res()))(*res)
        assert call(args, ress, None, None, 0) == 0  # known lines use no work arrays
        return results


@pytest.fixture(scope="module", params=[1, 7, 10_000])
def library(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Library:
    folder, function = tmp_path_factory.mktemp("split"), tangled()
    text = generated([function], folder)
    split = split_functions(text, request.param)
    assert "if (res[" not in split
    assert split.count("_part0(") == 2  # defined and called
    source, built = folder / "split.c", folder / "split.so"
    source.write_text(split)
    cc = compiler()
    assert cc is not None
    command = [*cc, "-O1", "-Wall", "-Wno-unused-but-set-variable", "-Werror"]
    command += ["-ffp-contract=off", "-fPIC", "-shared"]
    subprocess.run([*command, "-o", str(built), str(source), "-lm"], check=True)
    return Library(function, built)


elements = st.floats(-3, 3, allow_subnormal=False)
an_input = [st.none() | st.lists(elements, min_size=n, max_size=n).map(np.array) for n in SIZES]


@needs_compiler
@given(inputs=st.tuples(*an_input), wanted=st.lists(st.booleans(), min_size=4, max_size=4))
@settings(max_examples=200, deadline=None)
def test_arrays_may_be_missing(library: Library, inputs: Sequence[Array | None], wanted: list[bool]) -> None:
    zeros = [np.zeros(n) if a is None else a for a, n in zip(inputs, SIZES, strict=True)]
    expected = [np.array(e.nonzeros()) for e in library.function(*zeros)]
    for e, found in zip(expected, library(inputs, wanted), strict=True):
        assert found is None or np.allclose(found, e, rtol=1e-13, atol=1e-13, equal_nan=True)


@needs_compiler
def test_missing_inputs_stay_zero_when_outputs_are_missing(library: Library) -> None:
    """What is written to replace an output never comes back as an input."""
    here = [np.array([0.3, -1.0, 2.0]), np.array([0.7, 0.1])]
    expected = library([None, None], [True] * 4)
    library(here, [False] * 4)
    for a, b in zip(library([None, None], [True] * 4), expected, strict=True):
        assert a is not None
        assert np.array_equal(a, b, equal_nan=True)


def lines_of_body(text: str) -> list[str]:
    return text[text.index(") {\n") : text.index("return 0;\n}")].splitlines()[1:]


@pytest.mark.parametrize(
    "line",
    [
        "for (i=0; i<3; ++i) {}",
        "if (casadi_f1(arg, res, iw, w, 0)) return 1;",
        "a0=w[3];",
        "a0=casadi_dot(3, arg[0], w);",
        "a0=(a1=2.);",
        "a0=casadi_of(&a1);",
        "if (res[0]!=0) res[1][0]=a0;",
        "a0=arg[0]? arg[1][0] : 0;",
        "a0=never_declared(a99999);",
        "return 0;",
    ],
)
def test_unknown_lines_leave_a_function_as_it_is(tmp_path: Path, line: str) -> None:
    text = generated([tangled()], tmp_path)
    last = lines_of_body(text)[-2]
    strange = text.replace(last, f"{last}\n  {line}", 1)
    assert strange != text
    assert split_functions(strange) == strange


def test_functions_that_call_others_are_left_alone(tmp_path: Path) -> None:
    """Their parts are split all the same."""
    x, y = ca.MX.sym("x", SIZES[0]), ca.MX.sym("y", SIZES[1])
    inner = tangled()
    outer = ca.Function("outer", [x, y], [inner(x, y)[0] + inner(2 * x, y)[0]])
    text = generated([outer], tmp_path)
    split = split_functions(text, 20)
    head = text[text.index("/* outer:") :]
    assert head in split
    assert "_part1(" in split


def test_texts_of_something_else_stay() -> None:
    for text in ("", "int main(void) {\n  return 0;\n}\n", "\n\n"):
        assert split_functions(text) == text

"""Functions that call others, in lanes: the numbers of one stage at a time, whatever other lanes hold."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbocp._arrays import Array
from mbocp.programme.compilation import load_functions
from mbocp.programme.generated import exported_names
from mbocp.programme.lanes import Lanes
from mbocp.programme.processor import has_avx2
from mbocp.programme.splitting import split_functions

pytestmark = pytest.mark.skipif(not has_avx2(), reason="the processor has no AVX2")
COLUMNS, CALLS = 5, 7


def loops() -> ca.Function:
    """(x, which) -> values of a function of chosen columns, their sums, and what is added up by column."""
    x, which = ca.MX.sym("x", 3), ca.MX.sym("which", CALLS)
    q = ca.SX.sym("q", 3)
    angles = (ca.SX(np.arange(1.0, COLUMNS + 1)) * q[0] + q[1]).T
    table = ca.Function("table", [q], [ca.vertcat(ca.sin(angles) * q[2], ca.cos(angles))])
    a, b = ca.SX.sym("a", 2), ca.SX.sym("b", 2)
    part = ca.Function("part", [a, b], [a * b[0], ca.vertcat(a[0] + b[1], ca.cos(a[1]) * b[0])])
    found = part.map(CALLS)(table(x)[:, which], ca.vertcat(which.T, 2.0 * which.T))
    plain = ca.MX.sym("plain", 2, COLUMNS)
    added = ca.jtimes(plain[:, which], plain, found[0], True)
    both = ca.horzcat(found[0].T, found[1].T)
    sparse = ca.diagcat(ca.MX(1, 1), both[:2, :2])
    return ca.Function("f", [x, which], [both, ca.repsum(found[1], 1, CALLS), added, sparse.T])


class Library:
    """The function in a library, for so many lanes."""

    def __init__(self, folder: Path, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("MBOCP_CACHE_DIR", str(folder))
        monkeypatch.setenv("MBOCP_LANES", str(number))
        self.plain, self.number = loops(), number
        found = load_functions("loops", lambda: {"f": self.plain}, in_lanes=["f"]).library
        assert found is not None
        self._library = ctypes.CDLL(str(found))
        assert self._library.f_num_lanes() == number

    def __call__(self, inputs: Sequence[Array]) -> list[Array]:
        """Outputs, shape (lanes, numbers) each, for inputs of this shape."""
        pointer = ctypes.POINTER(ctypes.c_double)
        given = [self._aligned(array.shape[1]) for array in inputs]
        for block, array in zip(given, inputs, strict=True):
            block[:] = array.T.ravel()
        taken = [self._aligned(self.plain.nnz_out(i)) for i in range(self.plain.n_out())]
        arg = (pointer * len(given))(*(a.ctypes.data_as(pointer) for a in given))
        res = (pointer * len(taken))(*(a.ctypes.data_as(pointer) for a in taken))
        assert self._library.f_in_lanes(arg, res) == 0
        return [a.reshape(-1, self.number).T for a in taken]

    def _aligned(self, size: int) -> Array:
        block = np.full(size * self.number + 8, np.nan)
        return block[-block.ctypes.data // 8 % 8 :][: size * self.number]

    def one_by_one(self, inputs: Sequence[Array]) -> list[Array]:
        """The same by CasADi's virtual machine."""
        each = [self.plain.call(list(of_lane)) for of_lane in zip(*inputs, strict=True)]
        return [
            np.array([np.array(found[i].nonzeros()) for found in each]) for i in range(self.plain.n_out())
        ]


@pytest.fixture(scope="module", params=[4, 8])
def library(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Library:
    with pytest.MonkeyPatch.context() as monkeypatch:
        return Library(tmp_path_factory.mktemp("cache"), request.param, monkeypatch)


columns = st.lists(st.integers(0, COLUMNS - 1), min_size=CALLS, max_size=CALLS)


@given(which=columns, seed=st.integers(0, 10**6))
@settings(max_examples=50, deadline=None)
def test_lanes_that_agree(library: Library, which: list[int], seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=(library.number, 3))
    inputs = [x, np.tile(np.array(which, dtype=float), (library.number, 1))]
    for found, expected in zip(library(inputs), library.one_by_one(inputs), strict=True):
        assert np.allclose(found, expected, rtol=1e-13, atol=1e-13)


@given(data=st.data(), seed=st.integers(0, 10**6))
@settings(max_examples=50, deadline=None)
def test_lanes_that_choose_other_columns(library: Library, data: st.DataObject, seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=(library.number, 3))
    which = np.array([data.draw(columns) for _ in range(library.number)], dtype=float)
    for found, expected in zip(library([x, which]), library.one_by_one([x, which]), strict=True):
        assert np.allclose(found, expected, rtol=1e-13, atol=1e-13)


def test_what_is_no_number_stays_in_its_lane(library: Library) -> None:
    x = np.random.default_rng(1).normal(size=(library.number, 3))
    which = np.tile(np.arange(CALLS) % COLUMNS, (library.number, 1)).astype(float)
    before = library([x, which])
    x[2, 0] = np.nan
    others = np.arange(library.number) != 2
    for found, expected in zip(library([x, which]), before, strict=True):
        assert np.isnan(found[2]).any()
        assert np.array_equal(found[others], expected[others])


def written(function: ca.Function) -> str:
    generator = ca.CodeGenerator("stage.c")
    generator.add(function)
    return str(generator.dump())


@pytest.mark.parametrize(
    "line",
    [
        "casadi_dot(3, w00, w00);",
        "w00[0] = w01;",
        "if (casadi_f99(arg1, res1, iw, w, 0)) return 1;",
        "for (i=0; i<3; ++i) something(i);",
        "casadi_real x = 3;",
        "return 1;",
        "w02 = sqrt( w02 );",
    ],
)
def test_unknown_lines_leave_a_function_alone(line: str) -> None:
    """It keeps its text, and gets no entry for lanes."""
    text = written(loops())
    wide = Lanes(4, frozenset({"f"}))
    assert "int f_in_lanes(" in split_functions(text, of_lanes=wide)
    name = next(static for static, exported in exported_names(text).items() if exported == "f")
    start = text.index(f"static int {name}(")
    end = text.index("  return 0;\n}", start)
    strange = f"{text[:end]}  {line}\n{text[end:]}"
    split = split_functions(strange, of_lanes=wide)
    assert strange[start : strange.index("\n}", start)] in split
    assert "f_in_lanes" not in split


def test_what_calls_such_a_function_is_left_alone() -> None:
    x = ca.MX.sym("x", 2)
    inner = ca.Function("inner", [x], [ca.sqrt(x)])  # a loop of another form
    outer = ca.Function("f", [x], [inner(inner(x))])
    text = written(outer)
    assert "casadi_f1(" in text
    assert "f_in_lanes" not in split_functions(text, of_lanes=Lanes(4, frozenset({"f"})))

"""Functions without a compiler: the kernel executes CasADi's instructions, for many stages at a time."""

from __future__ import annotations

from contextlib import suppress

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mbocp._arrays import Array
from mbocp.programme.native_modules import kernel
from mbocp.programme.tapes import as_operations
from mbocp.symbolic.columns import STAYS_A_CALL, WHERE_ANY, add_chosen_columns, choose_columns

UNARY = (
    *(ca.sin, ca.cos, ca.fabs, ca.sqrt, ca.exp, ca.tanh, ca.sign, ca.floor, ca.logic_not),
    *(lambda x: -x, lambda x: 1 / x, lambda x: x + x, lambda x: x * x),
)
BINARY = (
    *(ca.atan2, ca.fmin, ca.fmax, ca.copysign, lambda x, y: ca.if_else(x, y, 0)),
    *(lambda x, y: x + y, lambda x, y: x - y, lambda x, y: x * y, lambda x, y: x / y),
    *(lambda x, y: x < y, lambda x, y: x <= y, lambda x, y: x == y, lambda x, y: x != y),
)
Step = tuple[int, int, int]
STEP = st.tuples(st.integers(0, len(UNARY) + len(BINARY) - 1), st.integers(0, 9), st.integers(0, 9))


def built(steps: list[Step]) -> ca.Function:
    """Each step takes two of the last ten values; outputs are some of them, an input and a constant, too."""
    x, y = ca.SX.sym("x", 4), ca.SX.sym("y", 3)
    values = [*ca.vertsplit(x), *ca.vertsplit(y), ca.SX(0.5), ca.SX(-2.0), ca.SX(0.0)]
    for kind, i, j in steps:
        a, b = values[-1 - i], values[-1 - j]
        values.append(UNARY[kind](a) if kind < len(UNARY) else BINARY[kind - len(UNARY)](a, b))
    pattern = ca.blockcat([[values[-1], 0], [0, values[-2] + values[-1] * values[-3]]])
    return ca.Function("f", [x, y], [ca.vertcat(*values[-4:], x[1], 3.0), ca.sparsify(pattern)])


def compare(function: ca.Function, count: int) -> None:
    """With CasADi, stage by stage."""
    rng = np.random.default_rng(count)
    inputs = [rng.uniform(-3.0, 3.0, (count, function.nnz_in(i))) for i in range(function.n_in())]
    patterns = [function.sparsity_in(i) for i in range(function.n_in())]
    stages = [[ca.DM(p, row[n]) for p, row in zip(patterns, inputs, strict=True)] for n in range(count)]
    expected = [function.call(stage) for stage in stages]
    tape = kernel().StageFunction.of(as_operations(function))
    for own in (tape, tape.copy(), kernel().StageFunction.from_tape(tape.as_tape())):
        for is_in_lanes in (True, False):
            found = own.evaluate([row.ravel() for row in inputs], count, is_in_lanes)
            for i, values in enumerate(found):
                exact = np.array([stage[i].nonzeros() for stage in expected]).reshape(values.shape)
                same(values, exact)


def same(values: Array, exact: Array) -> None:
    finite = np.isfinite(exact)
    np.testing.assert_array_equal(np.isfinite(values), finite)
    np.testing.assert_allclose(values[finite], exact[finite], rtol=1e-9, atol=1e-11)


@given(steps=st.lists(STEP, min_size=4, max_size=25), count=st.sampled_from([1, 7, 9, 17, 33, 70]))
@settings(max_examples=60)
def test_tapes_compute_what_casadi_does(steps: list[Step], count: int) -> None:
    compare(built(steps), count)


def test_functions_that_call_others_are_written_out() -> None:
    x = ca.SX.sym("x", 3)
    inner = ca.Function("inner", [x], [ca.sin(x), x[0] * x[1]], {"never_inline": True})
    once, product = inner(x)
    outer = ca.Function("outer", [x], [inner(once)[0], product * inner(2 * once)[1]], {"never_inline": True})
    X = ca.MX.sym("X", 3, 5)
    for function in (outer, ca.Function("rows", [X], list(outer.map(5)(X)))):
        assert as_operations(function).is_a("SXFunction")
        compare(function, 40)


@pytest.mark.parametrize("count", [1, 9, 17, 40])
def test_columns_that_numbers_choose(count: int) -> None:
    """Each stage chooses its own, some of which there are not; what is chosen is a value or an input."""
    table, which = ca.MX.sym("table", 3, 4), ca.MX.sym("which", 5)
    shares = ca.MX.sym("shares", 3, 5)
    chosen = choose_columns(ca.horzcat(table, ca.sin(table[:, 1:3])), which)
    sums = add_chosen_columns(2, which, shares)
    again = choose_columns(2.0 * sums, ca.fmod(which, 2.0))
    function = ca.Function("f", [table, which, shares], [chosen, sums, again + chosen, sums[0, 1]])
    assert as_operations(function).is_a("SXFunction")
    compare(function, count)


def test_all_stages_choose_the_same_columns() -> None:
    table, which, shares = ca.MX.sym("table", 2, 3), ca.MX.sym("which", 4), ca.MX.sym("shares", 2, 4)
    outputs = [choose_columns(table, which), add_chosen_columns(3, which, shares)]
    written = as_operations(ca.Function("f", [table, which, shares], outputs))
    own, rng = kernel().StageFunction.of(written), np.random.default_rng(0)
    tables, given, numbers = rng.normal(size=(40, 2, 3)), rng.normal(size=(40, 2, 4)), [2, 0, 2, 1]
    inputs = [tables.transpose(0, 2, 1).ravel(), np.tile(numbers, 40), given.transpose(0, 2, 1).ravel()]
    columns, sums = own.evaluate([np.asarray(values, dtype=float) for values in inputs], 40, True)
    np.testing.assert_array_equal(columns.reshape(40, 4, 2).transpose(0, 2, 1), tables[:, :, numbers])
    expected = np.stack([given[:, :, 1], given[:, :, 3], given[:, :, 0] + given[:, :, 2]], axis=2)
    np.testing.assert_array_equal(sums.reshape(40, 3, 2).transpose(0, 2, 1), expected)


def test_what_is_zero_in_all_lanes_is_left_out() -> None:
    flag, x = ca.SX.sym("flag"), ca.SX.sym("x", 2)
    ahead = ca.Function(WHERE_ANY, [flag, x], [x + 1, x], STAYS_A_CALL)  # not zero: so that it shows
    f = ca.Function("f", [flag, x], [ca.vertcat(*ahead.call([flag, 2 * x], False, True))])
    tape = kernel().StageFunction.of(as_operations(f))
    for own in (tape, kernel().StageFunction.from_tape(tape.as_tape())):
        count = 2 * own.num_lanes
        xs, flags = np.arange(2.0 * count).reshape(-1, 2), np.zeros(count)
        flags[1] = 1.0
        (found,) = own.evaluate([flags, xs.ravel()], count, True)
        rows = found.reshape(-1, 4)
        is_called = rows[:, 0] > 0.0
        assert is_called[1]
        assert not is_called[own.num_lanes :].any()
        expected = np.where(is_called[:, None], np.hstack([2 * xs + 1, 2 * xs]), 0.0)
        np.testing.assert_array_equal(rows, expected)


@pytest.mark.parametrize("least", [-4.0, 2.5, 2.9, 4.0])
@given(steps=st.lists(STEP, min_size=10, max_size=60), others=st.lists(STEP, min_size=10, max_size=60))
@settings(max_examples=20, deadline=None)
def test_what_is_left_out_changes_nothing(least: float, steps: list[Step], others: list[Step]) -> None:
    """Two such functions, of what the rest has, of what they alone have, and of each other's results."""
    x, y, flag = ca.SX.sym("x", 4), ca.SX.sym("y", 3), ca.SX.sym("flag")
    first, second = (
        ca.Function(WHERE_ANY, [flag, x, y], [ca.if_else(flag, out[0], 0)], STAYS_A_CALL)
        for out in (built(one).call([x, y]) for one in (steps, others))
    )
    given = [x * y[0] + 0.5, ca.sin(y)]
    a = first.call([x[0] > least, *given], False, True)[0]
    b = second.call([y[0] > least, ca.fmin(a[:4], 2.0), y * a[0]], False, True)[0]
    compare(ca.Function("f", [x, y], [a + b, b * ca.sum1(given[0]), given[1] + a[:3]]), 40)


def test_what_cannot_be_written_out_runs_in_the_virtual_machine() -> None:
    x = ca.MX.sym("x", 2)
    table = ca.interpolant("table", "linear", [[0.0, 1.0, 2.0]], [1.0, 3.0, 2.0])
    function = ca.Function("f", [x], [table(x[0]) * x[1]])
    own = kernel().StageFunction.of(as_operations(function))
    assert own.num_lanes == 1
    assert own.as_tape() == b""
    for one in (own, own.copy()):
        (values,) = one.evaluate([np.array([0.5, 2.0, 1.5, 1.0])], 2, True)
        np.testing.assert_allclose(values, [4.0, 2.5])


@given(at=st.floats(0.0, 1.0), value=st.integers(0, 255), cut=st.booleans())
@settings(max_examples=200)
def test_bytes_that_are_no_tape_are_refused(at: float, value: int, cut: bool) -> None:
    """What is read is executed: every place that it names has to be there."""
    table, which, shares = ca.MX.sym("table", 2, 3), ca.MX.sym("which", 4), ca.MX.sym("shares", 2, 4)
    outputs = [choose_columns(table, which), add_chosen_columns(3, which, shares), ca.exp(table) + 1.5]
    written = as_operations(ca.Function("f", [table, which, shares], outputs))
    sound = kernel().StageFunction.of(written).as_tape()
    place = int(at * (len(sound) - 1))
    changed = sound[:place] + bytes([value]) + sound[place + 1 :]
    for content in (changed[:place] if cut else changed, changed + b"x"):
        with suppress(RuntimeError):  # else a number or an operation has changed, and nothing else
            own = kernel().StageFunction.from_tape(content)
            assert own.copy().num_lanes == own.num_lanes
    with pytest.raises(RuntimeError, match="not a tape"):
        kernel().StageFunction.from_tape(sound[:-1])


@pytest.mark.parametrize("size", [2_000, 40_000])
def test_large_functions_take_fewer_lanes(size: int) -> None:
    """As many as the cache has room for; their intermediate values are all needed at the end."""
    x = ca.SX.sym("x", size)
    powers = [ca.sin(x)]
    for _ in range(3):
        powers.append(powers[-1] * x)
    function = ca.Function("f", [x], [ca.sum1(powers[0] * powers[1] + powers[2] * powers[3])])
    own = kernel().StageFunction.of(function)
    assert own.num_lanes == (32 if size == 2_000 else 8)
    compare(function, 11)


def test_wrong_inputs_are_refused() -> None:
    own = kernel().StageFunction.of(built([(0, 0, 0)]))
    with pytest.raises(ValueError, match="wrong number"):
        own.evaluate([np.zeros(4)], 1, False)
    with pytest.raises(ValueError, match="wrong length"):
        own.evaluate([np.zeros(4), np.zeros(5)], 1, False)

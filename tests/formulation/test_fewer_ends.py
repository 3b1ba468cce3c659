"""A formulation less some rows of its end is that of a goal that does not ask for them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbocp
from mbocp.formulation import Formulation, formulate
from mbocp.formulation.formulate import without_end_rows

WAYS: dict[str, dict[str, Any]] = {
    "explicit": {"integrator": {"scheme": "rk4"}},
    "implicit": {"integrator": {"scheme": "se1"}},
    "partitioned": {"integrator": {"scheme": "lobatto3"}},
    "natural": {"integrator": {"scheme": "se1"}, "coordinates": "natural"},
    "momentum": {"integrator": {"scheme": "se1"}, "rate": "p"},
}


def reach(way: dict[str, Any], q: tuple[int, ...], rates: tuple[int, ...]) -> Formulation:
    """Double pendulum, whose goal has only those of its angles and rates."""
    robot = mbocp.load_robot("double_pendulum")
    names, tables = [label.name for label in robot.v_labels], dict(way)
    rate = tables.pop("rate", "v")
    problem = mbocp.Problem.create(
        robot,
        1.0,
        10,
        start={"q": [0.3, -0.2]},
        goal={
            "q": {names[i]: 0.4 + i for i in q},
            rate: {names[i]: 0.1 * i for i in rates},
        },
        cost={"effort": 1.0},
        **tables,
    )
    return formulate(problem)


@pytest.mark.parametrize("way", WAYS.values(), ids=list(WAYS))
@pytest.mark.parametrize(
    ("rows", "q", "rates"),
    [
        ((0,), (1,), (0, 1)),
        ((3,), (0, 1), (0,)),
        ((1, 2), (0,), (1,)),
        ((0, 1), (), (0, 1)),
        ((), (0, 1), (0, 1)),
    ],
)
def test_it_is_the_formulation_of_a_goal_that_does_not_ask_for_them(
    way: dict[str, Any], rows: tuple[int, ...], q: tuple[int, ...], rates: tuple[int, ...]
) -> None:
    whole = reach(way, (0, 1), (0, 1))
    fewer, asked = without_end_rows(whole, rows), reach(way, q, rates)
    assert type(fewer) is type(whole)
    found, expected = fewer.programme, asked.programme
    assert found.ng == expected.ng == 4 - len(rows)
    np.testing.assert_array_equal(found.terminal_weights, expected.terminal_weights)
    np.testing.assert_array_equal(found.units.terminal, expected.units.terminal)
    np.testing.assert_array_equal(found.units.end_rows, expected.units.end_rows)
    assert [found.describe_row(-1, row) for row in range(found.ng)] == [
        expected.describe_row(-1, row) for row in range(found.ng)
    ]
    np.testing.assert_array_equal(fewer.end_rows.of_joints, asked.end_rows.of_joints)
    assert fewer.pieces.signature.goal == asked.pieces.signature.goal
    x = np.random.default_rng(0).normal(size=found.x_start.size)
    cost, value = whole.programme.end_functions.function("terminal_values")(x, whole.programme.rho_terminal)
    left = found.end_functions.function("terminal_values")(x, found.rho_terminal)
    kept = np.delete(np.asarray(value).ravel(), rows)
    np.testing.assert_allclose(np.asarray(left[1]).ravel(), kept, rtol=1e-15)
    np.testing.assert_allclose(float(left[0]), float(cost), rtol=1e-15)


def test_what_does_not_speak_of_the_end_is_the_same_object() -> None:
    whole = reach(WAYS["explicit"], (0, 1), (0, 1))
    fewer = without_end_rows(whole, (2,))
    assert fewer.programme.functions is whole.programme.functions
    assert fewer.programme.bounds is whole.programme.bounds
    assert fewer.programme.theta is whole.programme.theta
    assert formulate(whole.problem, (2,)).programme.ng == fewer.programme.ng == 3

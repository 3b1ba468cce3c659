"""`--set key.path=value`."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from mbocp.exceptions import ProblemError, ProblemFileError
from mbocp.problem import Problem
from mbocp.problem.file.overrides import apply_overrides, parse_override

Loader = Callable[..., Problem]


@pytest.mark.parametrize(
    ("text", "path", "value"),
    [
        ("horizon.steps=200", ("horizon", "steps"), 200),
        (" horizon.steps = 200 ", ("horizon", "steps"), 200),
        ("robot.gravity=[0,0,-9.8]", ("robot", "gravity"), [0, 0, -9.8]),
        ("goal.enforce='none'", ("goal", "enforce"), "none"),
        ("goal.enforce=none", ("goal", "enforce"), "none"),
        ("robot=robots/mine/robot.toml", ("robot",), "robots/mine/robot.toml"),
        ("horizon.duration=1.5 s", ("horizon", "duration"), "1.5 s"),
        ("limits.effort=-2e1 N m/s", ("limits", "effort"), "-2e1 N m/s"),
        ("robot.free_flyer=true", ("robot", "free_flyer"), True),
        ('start.q."joint a=b"=1.5', None, None),
        ('start.q."joint.a"=1.5', ("start", "q", "joint.a"), 1.5),
        ("solver.tolerance=1e-6", ("solver", "tolerance"), 1e-6),
        ("goal={q=[1], enforce='none'}", ("goal",), {"q": [1], "enforce": "none"}),
    ],
)
def test_key_and_value(text: str, path: tuple[str, ...] | None, value: Any) -> None:
    if path is None:  # an equals sign in a key is more than this notation can say
        with pytest.raises(ProblemFileError):
            parse_override(text)
    else:
        assert parse_override(text) == (path, value)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("horizon.steps", "expected key.path=value"),
        ("=3", "expected key.path=value"),
        ("horizon.steps=", "expected key.path=value"),
        ("horizon..steps=3", "is not a key"),
        ("horizon steps=3", "is not a key"),
        ("horizon.steps=[1,", "is not a TOML value"),
        ("horizon.steps=1 2", "is not a TOML value"),
        ("horizon.steps=1\nrobot=3", "one key at a time"),
    ],
)
def test_bad_syntax(text: str, reason: str) -> None:
    with pytest.raises(ProblemFileError, match=f"--set: .*{reason}"):
        parse_override(text)


def test_below_a_shorthand() -> None:
    document = {"robot": "ur5"}
    changed = apply_overrides(document, ["robot.gravity=[0,0,-9.8]", "robot.lock=['elbow_joint']"])
    assert changed == {"robot": {"name": "ur5", "gravity": [0, 0, -9.8], "lock": ["elbow_joint"]}}
    assert document == {"robot": "ur5"}


def test_below_a_value_is_an_error() -> None:
    with pytest.raises(ProblemFileError, match=r"start\.q is \[1\], which has no keys below it"):
        apply_overrides({"start": {"q": [1]}}, ["start.q.elbow=1"])


def test_new_tables_are_made() -> None:
    assert apply_overrides({}, ["a.b.c=1", "a.b.d=2"]) == {"a": {"b": {"c": 1, "d": 2}}}


@pytest.mark.parametrize(
    ("table", "setting", "left"),
    [
        ({"steps": 9, "duration": 1}, "horizon.accuracy=1e-4", {"duration": 1, "accuracy": 1e-4}),
        ({"accuracy": 1e-4}, "horizon.steps=9", {"steps": 9}),
        ({"lengths": [1, 2]}, "horizon.steps=9", {"steps": 9}),
        ({"steps": 9}, "horizon.duration=2", {"steps": 9, "duration": 2}),
    ],
)
def test_a_key_takes_the_place_of_what_excludes_it(table: Any, setting: str, left: Any) -> None:
    assert apply_overrides({"horizon": table}, [setting]) == {"horizon": left}


def test_settings_do_not_take_the_place_of_each_other(load: Loader) -> None:
    with pytest.raises(ProblemError, match="steps and accuracy both say which steps there are"):
        load("horizon.steps=7", "horizon.accuracy=1e-4")
    rates = apply_overrides({"start": {"v": 0}}, ["start.p=[1]"])
    assert rates == {"start": {"p": [1]}}


def test_mapping_with_arrays() -> None:
    changed = apply_overrides(
        {}, {"start.q": np.array([1.0, 2.0]), "horizon.steps": np.int64(3), "goal": {"q": (1, 2)}}
    )
    assert changed == {"start": {"q": [1.0, 2.0]}, "horizon": {"steps": 3}, "goal": {"q": [1, 2]}}


def test_in_a_problem(load: Loader) -> None:
    problem = load("horizon.steps=7", "goal.enforce=both", "cost.terminal=2", "robot.gravity=[0,0,-1]")
    assert (problem.num_steps, problem.goal.enforce, problem.cost.terminal) == (7, "both", 2.0)
    np.testing.assert_allclose(problem.robot.model.gravity.linear, [0, 0, -1])
    assert problem.dt == pytest.approx(1.0 / 7)

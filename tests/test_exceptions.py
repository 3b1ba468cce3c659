"""Errors say by attributes what they are about: programs need not read their words."""

from __future__ import annotations

import json
import pickle
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

import mbocp
from mbocp.cli.app import app
from mbocp.exceptions import (
    InvalidValue,
    MbocpError,
    ProblemError,
    ProblemFileError,
    RobotFileError,
    UnknownFrame,
    UnknownJoint,
)
from mbocp.problem import parse_problem

ARM = 'robot = "double_pendulum"\n[horizon]\nduration = 1\nsteps = 4\n[goal]\n'


@pytest.mark.parametrize(
    ("error", "key"),
    [
        (InvalidValue("solver.tolerance", -1, "a positive number"), "solver.tolerance"),
        (InvalidValue("qs[3, 1]", "nan", "a finite number"), "qs[3, 1]"),
        (ProblemError("via.0.frame.1: no such thing"), "via.0.frame.1"),
        (ProblemError("the path ends elsewhere: where?"), None),
        (ProblemFileError("arm.toml", "got 0", "horizon.steps"), "horizon.steps"),
        (RobotFileError("arm.urdf", "no such file"), None),
        (UnknownJoint("elbo", "ur5", ["elbow"]), None),
    ],
)
def test_the_key_is_what_the_message_is_about(error: MbocpError, key: str | None) -> None:
    assert error.key == key
    before = str(error)
    error.put_into("a.toml")
    assert (str(error), error.key) == (f"a.toml: {before}", key)


@pytest.mark.parametrize(
    ("line", "kind", "key"),
    [
        ("q = [1, 0]\n[cost]\nbetta = 1", ProblemFileError, "cost.betta"),
        ("q = [1, nan]", ProblemFileError, "goal.q"),
        ("q = { jont1 = 1 }", UnknownJoint, "goal.q"),
        ('frame = { name = "tol", position = [0, 0, 0] }', UnknownFrame, "goal.frame"),
        ('q = [1, 0]\n[solver]\nmethod = "newton"', ProblemFileError, "solver.method"),
    ],
)
def test_errors_of_files_have_kind_and_key(
    tmp_path: Path, line: str, kind: type[MbocpError], key: str
) -> None:
    (tmp_path / "arm.toml").write_text(ARM + line)
    with pytest.raises(kind) as caught:
        mbocp.load_problem(tmp_path / "arm.toml")
    assert caught.value.key == key
    told = json.loads(CliRunner().invoke(app, ["solve", str(tmp_path / "arm.toml"), "--json"]).stdout)
    assert (told["error"], told["key"]) == (kind.__name__, key)


def subclasses_of(kind: type[MbocpError]) -> list[type[MbocpError]]:
    return [kind, *(one for sub in kind.__subclasses__() for one in subclasses_of(sub))]


def test_what_is_refused_while_solving_names_the_file(tmp_path: Path) -> None:
    path = tmp_path / "tight.toml"
    path.write_text(
        ARM + "q = [0.3, 0.2]\n"
        "[limits]\nvelocity = 2.0\n[robust]\nsigmas = 40.0\nstart = { q = 0.1, v = 0.1 }\n"
    )
    problem = mbocp.load_problem(path)
    with pytest.raises(ProblemFileError, match=rf"^{re.escape(str(path))}: robust: .* has no room"):
        mbocp.solve(problem)


@pytest.mark.parametrize(
    "make",
    [
        lambda: mbocp.load_robot("no_such_robot"),
        lambda: mbocp.load_robot("ur5", lock={"no_joint": 1.0}),
        lambda: parse_problem("robot = 1"),
        lambda: parse_problem("nonsense"),
        lambda: mbocp.Problem.create("double_pendulum", 1.0, 5, start={"q": [1.0]}),
        lambda: mbocp.Problem.create("double_pendulum", 1.0, 5, start={"q": [1.0, float("nan")]}),
    ],
)
def test_errors_of_other_processes_arrive_as_they_were(make: Callable[[], object]) -> None:
    with pytest.raises(MbocpError) as caught:
        make()
    error = caught.value
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is type(error)
    assert (str(again), again.key, vars(again)) == (str(error), error.key, vars(error))


def test_all_kinds_of_errors_can_be_sent() -> None:
    for kind in subclasses_of(MbocpError):
        error = kind.__new__(kind)
        error.args = ("words",)
        assert str(pickle.loads(pickle.dumps(error))) == str(error)

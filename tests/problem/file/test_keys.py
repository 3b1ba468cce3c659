"""Keys are declared once: what pages and editors know of them follows from there."""

from __future__ import annotations

import re
from copy import deepcopy
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator
from pydantic import ValidationError

from mbocp._files import parse_toml, read_toml
from mbocp._keys import default_of, key_of, keys_of, row_of, tables_in, takes_of
from mbocp.exceptions import ProblemFileError
from mbocp.problem import parse_problem
from mbocp.problem.file.keys_page import all_keys
from mbocp.problem.file.read_tables import ProblemTable, problem_schema
from mbocp.problem.solver import SolverOptions, SolverTable

ROOT = Path(__file__).parents[3]
DOCUMENTS = {path: read_toml(path) for path in sorted((ROOT / "examples").rglob("*.toml"))}
PROBLEMS = {
    path: tables for path, tables in DOCUMENTS.items() if set(tables) <= set(ProblemTable.model_fields)
}
FIELDS = dict(all_keys())
SAID_BY_MBOCP_ALONE = ("gait.swings", "robot.inertias.links", "robot.part.inertias.links")
UNITS = re.compile(r"(m|rad|s|kg|N|W|J|1|m/s|part of|those)\b")


@cache
def validator() -> Draft202012Validator:
    schema = problem_schema()
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def complaints(tables: dict[str, Any]) -> list[str]:
    return [error.message for error in validator().iter_errors(tables)]


def tables_with_keys() -> list[Any]:
    """Tables of problem files."""
    seen = {table: name for name, info in all_keys() for table in tables_in(info.annotation)}
    return [pytest.param(ProblemTable, id="ProblemTable"), *(pytest.param(t, id=n) for t, n in seen.items())]


@pytest.mark.parametrize("table", tables_with_keys())
def test_every_key_is_declared(table: Any) -> None:
    """With what it takes, a default and a meaning, or with another key."""
    keys = keys_of(table)
    for name, info in table.model_fields.items():
        if name == "qp":  # where a plain list of weights lands
            continue
        assert row_of(name, keys) is not None, name
        key = key_of(info)
        if key is not None:
            assert key.says, name
            assert takes_of(info), name
            assert default_of(info) or name in ProblemTable.model_fields, name
            assert not key.unit or UNITS.match(key.unit), name
            assert set(key.beside) <= set(table.model_fields), name


@pytest.mark.parametrize("path", PROBLEMS, ids=lambda path: path.stem)
def test_editors_accept_examples(path: Path) -> None:
    assert not complaints(PROBLEMS[path])


@pytest.mark.parametrize("path", PROBLEMS, ids=lambda path: path.stem)
def test_editors_refuse_misspelt_keys(path: Path) -> None:
    """Of each table that an example has."""
    tables = PROBLEMS[path]
    for name, table in tables.items():
        for place in (
            [None] if isinstance(table, dict) else range(len(table) if isinstance(table, list) else 0)
        ):
            wrong = deepcopy(tables)
            (wrong[name] if place is None else wrong[name][place])["mispelt"] = 1
            assert complaints(wrong), name
    assert complaints({**tables, "horizn": {}})


@pytest.mark.parametrize(
    "wrong",
    [
        {"solver": {"method": "simplex"}},
        {"solver": {"tolerance": 0}},
        {"horizon": {"steps": 1.5}},
        {"goal": {"v": 1}},
        {"start": {"frame": {"name": "tool0", "positon": [0, 0, 0]}}},
        {"obstacle": [{"shape": "cube"}]},
        {"self_collision": {"margins": 0.1}},
        {"phase": [{"name": "a", "steps": 3, "duration": 1, "release": [{"name": "b", "how": "soft"}]}]},
    ],
)
def test_editors_refuse_what_no_problem_has(wrong: dict[str, Any]) -> None:
    assert not complaints({"robot": "ur5"})
    assert complaints({"robot": "ur5", **wrong})


@pytest.mark.parametrize("table", ProblemTable.model_fields)
def test_editors_point_at_the_keys_that_mbocp_refuses(table: str) -> None:
    """Or at the table of a key that it does not have."""
    names = [name for name in FIELDS if name.partition(".")[0] == table]
    for name, value in product(names, ({"none": {"none": [{}]}}, [[["none"]]], "none", -1.5, True)):
        tables = tables_of(name, value)
        if (refused := refused_place(name, tables)) and name not in SAID_BY_MBOCP_ALONE:
            told = [tuple(error.absolute_path) for error in validator().iter_errors(tables)]
            assert any(fit(place, refused) for place in told), (name, value, told, refused)


def fit(told: tuple[Any, ...], refused: tuple[Any, ...]) -> bool:
    """Whether a place is within another, or is the table whose key is unknown."""
    return told[: len(refused)] == refused or (refused[-1] == "none" and refused[: len(told)] == told)


def refused_place(name: str, tables: dict[str, Any]) -> tuple[Any, ...] | None:
    """Where mbocp finds the key's value wrong; None: it does not, or complains of something further out."""
    try:
        ProblemTable.model_validate(tables)
    except ValidationError as error:
        found = (item["loc"] for item in error.errors() if item["type"] != "missing")
        places = [tuple(part for part in place if part != "qp") for place in found]
        keys = (".".join(part for part in place if isinstance(part, str)) for place in places)
        return next((place for place, key in zip(places, keys, strict=True) if key.startswith(name)), None)
    return None


def tables_of(name: str, value: Any) -> dict[str, Any]:
    """Tables of a file that gives one key a value."""
    *above, last = name.split(".")
    found: Any = {last: value}
    while above:
        at = above.pop()
        is_list = "list[" in str(FIELDS[".".join([*above, at])].annotation)
        found = {at: [found] if is_list else found}
    return {"robot": "ur5", **found}


@pytest.mark.parametrize(
    ("setting", "key"),
    [
        ("solver = {tolerance = 1e100}", "solver.tolerance"),
        ("cost = {tracking_weights = {q = 1}}", "cost.tracking_weights"),
        ("cost = {target = {q = [1, 1]}}", "cost.target"),
        ("cost = {terminal_weights = [1, 1, 1, 1]}", "cost.terminal_weights"),
        ("self_collision = {margin = 'none'}", "self_collision.margin"),
        ("robot = {name = 'ur5', payload = [{mass = 1, frame = 'tool0', com = 1}]}", "robot.payload.0.com"),
    ],
)
def test_editors_and_mbocp_name_the_same_key(setting: str, key: str) -> None:
    robot = "" if setting.startswith("robot") else "robot = 'double_pendulum'"
    text = f"{robot}\nhorizon = {{duration = 1.0, steps = 10}}\ngoal = {{q = [1.0, 0.5], v = 0}}\n{setting}"
    with pytest.raises(ProblemFileError) as error:
        parse_problem(text)
    told = [".".join(map(str, error.absolute_path)) for error in validator().iter_errors(parse_toml(text))]
    assert [error.value.key] == told == [key]


def test_a_key_without_its_weight_may_be_empty() -> None:
    empty = {"tracking_weights": {}, "target": {}, "terminal_weights": {}}
    assert not complaints({"robot": "ur5", "cost": empty})
    given = {"tracking": 1.0, "tracking_weights": {"q": 1.0}, "target": {"q": [1.0]}, "terminal": 2.0}
    assert not complaints({"robot": "ur5", "cost": {**given, "terminal_weights": {"q": 1.0}}})


def test_editors_explain_keys() -> None:
    found = problem_schema()["$defs"]["SolverTable"]["properties"]["time_limit"]
    assert found["description"].startswith("Wall time")
    assert "[s]" in found["description"]
    assert found["exclusiveMinimum"] == 0
    for name, table in problem_schema()["$defs"].items():
        if name not in ("PartTable", "PayloadTable"):
            assert all(key["description"] for key in table["properties"].values()), name
    assert set(problem_schema()["$defs"]["WeightsTable"]["properties"]) == {"q", "p"}


def test_every_option_of_a_solver_is_a_key() -> None:
    assert set(SolverTable.model_fields) == set(SolverOptions.__dataclass_fields__)
    for name, info in SolverTable.model_fields.items():
        assert info.default == getattr(SolverOptions, name), name


def test_what_several_tables_say_alike_is_said_once() -> None:
    for name, info in all_keys():
        if (key := key_of(info)) is not None:
            parts = key.says.split("; ")
            assert len(parts) == len(set(parts)), name

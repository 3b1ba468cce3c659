"""Keys are declared once: what pages and editors know of them follows from there."""

from __future__ import annotations

import re
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from mbocp._files import read_toml
from mbocp._keys import default_of, key_of, keys_of, row_of, tables_in, takes_of
from mbocp.problem.file.keys_page import all_keys
from mbocp.problem.file.schema import ProblemTable, problem_schema
from mbocp.problem.solver import SolverOptions, SolverTable

ROOT = Path(__file__).parents[3]
DOCUMENTS = {path: read_toml(path) for path in sorted((ROOT / "examples").rglob("*.toml"))}
PROBLEMS = {
    path: tables for path, tables in DOCUMENTS.items() if set(tables) <= set(ProblemTable.model_fields)
}
UNITS = re.compile(r"(m|rad|s|kg|N|W|J|1|m/s|part of|those)\b")


@cache
def validator() -> Draft202012Validator:
    schema = problem_schema()
    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


def complaints(tables: dict[str, Any]) -> list[str]:
    return [error.message for error in validator().iter_errors(tables)]


def tables_with_keys() -> list[Any]:
    """Tables of problem files but those that robots share with their own files."""
    seen = {}
    for name, info in all_keys():
        for table in tables_in(info.annotation):
            if not name.startswith(("robot.part", "robot.payload")):
                seen[table] = name
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

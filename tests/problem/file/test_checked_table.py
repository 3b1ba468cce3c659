"""A file checked by a model of the tables that it has: as by the model of all tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from mbocp._files import read_toml
from mbocp.problem.file.read_tables import ProblemTable, check_tables

EXAMPLES = Path(__file__).parents[3] / "examples"
DOCUMENTS = {path: read_toml(path) for path in sorted(EXAMPLES.rglob("*.toml"))}
PROBLEMS = [path for path, document in DOCUMENTS.items() if set(document) <= set(ProblemTable.model_fields)]
WRONG: tuple[dict[str, Any], ...] = (
    {},
    {"horizon": {}},
    {"robot": "ur5", "horizn": {}},
    {"robot": "ur5", "horizon": {"steps": 1.5, "step": 3}},
    {"robot": 3, "cost": {"effort": "much"}, "goal": []},
    {"robot": "ur5", "path": [{"kind": "?"}], "via": {}, "solver": {"method": 1}},
)


@pytest.mark.parametrize("path", PROBLEMS, ids=lambda path: path.stem)
def test_tables_are_those_of_the_whole_model(path: Path) -> None:
    whole, found = ProblemTable.model_validate(DOCUMENTS[path]), check_tables(DOCUMENTS[path])
    assert found == dict(whole)


@pytest.mark.parametrize("document", WRONG)
def test_errors_are_those_of_the_whole_model(document: dict[str, Any]) -> None:
    told = []
    for check in (ProblemTable.model_validate, check_tables):
        with pytest.raises(ValidationError) as error:
            check(document)
        told.append([(item["type"], item["loc"], item["msg"]) for item in error.value.errors()])
    assert told[0] == told[1]

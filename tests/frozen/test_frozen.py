"""Problems come to what was recorded, and their texts say all of them."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from functools import cache
from pathlib import PurePath
from typing import Any

import pytest

from mbocp._files import parse_toml
from mbocp.problem import parse_problem
from mbocp.problem.file.tables import problem_to_toml
from tests.frozen.fingerprints import RECORD, equals, fingerprint, make_problem, problem_names
from tests.problem.same import same

# Searches for poses of frames end 6e-9 apart on different processors.
ROUGH = (
    "arms/straight_line.toml",
    "arms/throw_into_bucket.toml",
    "legged/talos_sit_to_stand.toml",
    "legged/talos_stairs.toml",
    "legged/talos_step.toml",
)


@cache
def recorded() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(RECORD.read_text(encoding="utf-8"))
    return found


def test_every_problem_is_recorded() -> None:
    assert list(recorded()) == problem_names()


@pytest.mark.parametrize("name", problem_names())
def test_it_comes_to_what_was_recorded(name: str) -> None:
    problem = make_problem(name)
    now, then = json.loads(json.dumps(fingerprint(problem), default=list)), recorded()[name]
    for part in then:
        assert equals(now[part], then[part], rtol=1e-7 if name in ROUGH else 1e-9), part
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        again = parse_problem(problem_to_toml(problem))
    assert equals(parse_toml(problem_to_toml(again)), parse_toml(problem_to_toml(problem)))
    if problem.cost.tracking == 0.0:  # unused: the weights that were written
        again = again.with_(cost=replace(again.cost, tracking_weights=problem.cost.tracking_weights))
    if problem.chooses_scheme:  # the text says which
        again = replace(again, chooses_scheme=True, scheme_reason=problem.scheme_reason)
    same(problem, again)
    assert problem.name == (PurePath(name).stem if name.endswith(".toml") else "problem")

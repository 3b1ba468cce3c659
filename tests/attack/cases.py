"""From a kind and a seed number to the files of an input, and nothing else."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random
from typing import Any, get_args

import yaml
from pydantic import BaseModel

from mbocp.problem.file.read_tables import ProblemTable
from mbocp.robot.loading.readers.robot_yaml import RobotYaml
from mbocp.robot.loading.robot_toml import RobotTable
from mbocp.study.study_schema import StudyTable

from .containers import mutate_result
from .corpus import entries
from .elements import mutate_xml
from .meshes import mutate_mesh
from .raw import mutate_bytes, mutate_lines
from .trees import Vocabulary, mutate_toml
from .yamls import mutate_yaml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

__all__ = ["KINDS", "Case", "make_case", "mutate_file"]

# Kind of input -> its share of all, in per cent: where there is most to go wrong, and what that costs.
KINDS = {
    "problem": 22,
    "robot_toml": 13,
    "robot_yaml": 7,
    "study": 10,
    "urdf": 21,
    "mesh": 7,
    "result": 14,
    "rows": 3,
    "solve": 1,
    "command": 2,
}
# What the other kinds are made from, and how the command line takes it.
_COMMANDS: dict[str, tuple[tuple[str, ...], ...]] = {
    "problem": (
        ("solve", "{}", "--set", "solver.time_limit=1", "--set", "horizon.steps=3", "-o", "out.h5", "-q"),
        ("solve", "{}", "--set", "solver.max_iterations=2", "--set", "horizon.steps=4", "--json"),
        ("solve", "{}", "--set", "{value}", "--set", "solver.time_limit=1", "--set", "horizon.steps=3"),
    ),
    "study": (("study", "{}", "-o", "{}"), ("study", "{}", "-o", "rows.txt"), ("study", "--summary", "{}")),
    "robot_toml": (("robots", "{}"), ("robots", "{}", "--json")),
    "robot_yaml": (("robots", "{}"),),
    "urdf": (("robots", "{}"), ("robots", "{}", "--json")),
    "mesh": (("robots", "{}"),),
    "result": (
        ("info", "{}"),
        ("info", "{}", "--json"),
        ("replay", "{}", "-o", "out.html"),
        ("plot", "{}", "-q"),
    ),
    "rows": (
        ("study", "--summary", "{}"),
        ("study", "--summary", "{}", "--json"),
        ("study", "--summary", "{}", "--csv", "x.csv"),
    ),
}
_SETTINGS = (
    *(
        "horizon.steps=1e9",
        "horizon.steps=-1",
        "horizon=3",
        "=",
        "a",
        "a=b=c",
        "solver.method=nothing",
        "x" * 9000,
    ),
    *(
        "robot.name=\x07",
        "goal.q=[",
        "goal.q=[[1]]",
        "cost.effort=nan",
        "start.q=[1,2]",
        "solver.threads=1000000",
    ),
    *(
        "integrator.substeps=100000",
        "integrator.scheme='rk4'",
        "limits.effort=[[1,2],[3]]",
        "robot.name='chain_9'",
    ),
)


@dataclass(frozen=True)
class Case:
    """An input: files of a folder, which of them is loaded, and the arguments of the command line."""

    kind: str
    seed: int
    entry: str
    main: str
    files: Mapping[str, bytes]
    originals: Mapping[str, bytes]
    arguments: tuple[str, ...] = ()

    def write(self, folder: Path) -> Path:
        """Write the files; the path of the main one."""
        for name, data in self.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)
        return folder / self.main


def make_case(kind: str, seed: int) -> Case:
    """Make the input of that kind and number: always the same one."""
    random = Random(f"{kind} {seed}")
    source = random.choice(list(_COMMANDS)) if kind == "command" else kind
    entry = random.choice(entries(source))
    files = dict(entry.files)
    if random.random() > 0.02:  # a few stay as they are: these must work
        name = random.choice(entry.mutated)
        files[name] = mutate_file(source, name, files[name], random)
    arguments: tuple[str, ...] = ()
    if kind == "command":
        setting = random.choice(_SETTINGS)
        pattern = random.choice(_COMMANDS[source])
        arguments = tuple(word.replace("{value}", setting).replace("{}", entry.main) for word in pattern)
    return Case(kind, seed, f"{source}: {entry.name}", entry.main, files, entry.files, arguments)


def mutate_file(kind: str, name: str, data: bytes, random: Random) -> bytes:
    """Mutate a file by its ending."""
    try:
        if name.endswith(".toml"):
            return mutate_toml(tomllib.loads(data.decode()), random, _vocabulary(kind))
        if name.endswith(".yaml"):
            return mutate_yaml(yaml.safe_load(data), random, _vocabulary(kind))
        if name.endswith((".urdf", ".dae")):
            return mutate_xml(data.decode(), random)
    except (ValueError, SyntaxError, AttributeError, TypeError, RecursionError, yaml.YAMLError):
        return mutate_bytes(data, random)  # mutated before, and no longer of its format
    if name.endswith(".h5"):
        return mutate_result(data, random)
    if name.endswith(".jsonl"):
        return mutate_bytes(
            mutate_lines(data.decode().replace(",", ",\n"), random).replace(",\n", ",").encode(), random
        )
    return mutate_mesh(name, data, random)


@cache
def _vocabulary(kind: str) -> Vocabulary:
    """Keys of each table that such a file may have."""
    seen: dict[Any, frozenset[str]] = {}
    _collect(_TABLES[kind], seen)
    return tuple(seen.values())


_TABLES: dict[str, Any] = {
    "problem": ProblemTable,
    "solve": ProblemTable,
    "study": StudyTable,
    "robot_toml": RobotTable,
    "robot_yaml": RobotYaml,
}


def _collect(annotation: Any, seen: dict[Any, frozenset[str]]) -> None:
    """Walk through the tables, and the tables in them."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if annotation not in seen:
            seen[annotation] = frozenset(annotation.model_fields)
            for field in annotation.model_fields.values():
                _collect(field.annotation, seen)
        return
    for inner in get_args(annotation):
        _collect(inner, seen)

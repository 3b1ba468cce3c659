"""A solution as the parts of a result file, and back."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp._text import printable
from mbocp.robot.robot_files import RobotFiles
from mbocp.solution.checked import check_content, read_facts, read_records
from mbocp.solution.details import Accuracy, Column, Labels, StartRecord
from mbocp.solution.its_iterate import MEANING, arrays_of, columns_of, is_part, iterate_in
from mbocp.solution.solution_data import COUNTS, NUMBERS, WORDS, SolutionData
from mbocp.solvers.records import IterationRecord, Phase
from mbocp.storage.content import QUANTITIES, FileContent

_STRUCTURES = ("phases", "history", "robot_spec", "options", "versions")
_FACTS = "facts"
_LABELLED = ("q", "v", "p", "u", "lam", "mu", "zeta")


def content_of(solution: SolutionData, robot: RobotFiles | None = None) -> FileContent:
    """What a result file of `solution` holds, beside the files of its robot."""
    summary = {name: getattr(solution, name) for name in (*WORDS, *COUNTS, *NUMBERS)}
    summary["status"] = str(solution.status)
    structures = {name: getattr(solution, name) for name in _STRUCTURES}
    for name in ("phases", "history"):
        structures[name] = [dataclasses.asdict(record) for record in structures[name]]
    if solution.starts:
        starts = [dataclasses.asdict(record) for record in solution.starts]
        structures["starts"] = [{**record, "status": str(record["status"])} for record in starts]
    if solution.accuracy.is_known:
        structures["accuracy"] = [dataclasses.asdict(solution.accuracy)]
    if solution.facts_kept is not None:
        structures[_FACTS] = dataclasses.asdict(solution.facts_kept)
    arrays = {name: getattr(solution, name) for name in QUANTITIES if _says_something(solution, name)}
    arrays |= arrays_of(solution.iterate, arrays)
    meaning = {} if solution.iterate is None else {MEANING: solution.iterate.meaning}
    return FileContent(
        arrays=arrays,
        columns=_columns(solution, arrays),
        summary=summary,
        structures=structures,
        texts={"problem_text": solution.problem_text, **meaning},
        meanings={"control_momenta": solution.control_momentum_meanings},
        robot_list=None if robot is None else robot.listed,
        robot_contents={} if robot is None else robot.contents,
    )


def fields_of(content: FileContent) -> dict[str, Any]:
    """Fields of the solution that a result file holds; what it does not has its default.

    Raises
    ------
    InvalidValue
        If something is not what mbocp writes.
    """
    check_content(content)
    given = {**content.arrays, **content.texts}
    own = {name: value for name, value in given.items() if not is_part(name)}
    words = {name: printable(value) for name, value in content.summary.items() if isinstance(value, str)}
    words["advice"] = printable(str(content.summary.get("advice", "")), keep="\n")
    fields: dict[str, Any] = {**own, **content.summary, **words, **content.structures}
    fields["facts_kept"] = read_facts(fields.pop(_FACTS, None))
    fields["iterate"] = iterate_in(content)
    fields["phases"] = read_records(Phase, fields["phases"])
    fields["history"] = read_records(IterationRecord, fields["history"])
    fields["starts"] = read_records(StartRecord, fields.get("starts", []))
    fields["accuracy"] = next(iter(read_records(Accuracy, fields.get("accuracy", []))), Accuracy())
    labels = {
        name: tuple(Column(*map(printable, pair)) for pair in content.columns[f"{name}s"])
        for name in _LABELLED
    }
    fields["labels"] = Labels(**labels)
    fields["control_momentum_names"] = tuple(
        printable(name) for name, _ in content.columns["control_momenta"]
    )
    fields["control_momentum_meanings"] = tuple(map(printable, content.meanings.get("control_momenta", ())))
    fields["path_names"] = tuple(printable(name) for name, _ in content.columns.get("lam_path", ()))
    if content.robot_list is not None:
        fields["robot_files"] = RobotFiles(content.robot_list, content.robot_contents)
    return fields


def _says_something(solution: SolutionData, name: str) -> bool:
    """Whether an array has to be in a file: it differs from what stands for it, or names something."""
    value, quantity = getattr(solution, name), QUANTITIES[name]
    if not quantity.may_lack:
        return True
    if quantity.absent is None or quantity.columns == "path":
        return bool(value.size)
    return bool(value.any() if quantity.absent == 0.0 else np.isfinite(value).any())


def _columns(solution: SolutionData, arrays: Mapping[str, Array]) -> dict[str, tuple[Column, ...]]:
    own = {name: solution.columns(name) for name in arrays if name in QUANTITIES}
    return {**own, **columns_of(solution.iterate, arrays)}

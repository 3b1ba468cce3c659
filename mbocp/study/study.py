"""`Study`: one problem, and what of it is varied."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Container, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from mbocp._arrays import dataclass, plain
from mbocp._text import show
from mbocp.exceptions import ProblemFileError, StudyError, StudyFileError
from mbocp.problem.file.load import load_document
from mbocp.problem.file.messages import schema_error
from mbocp.problem.file.overrides import apply_overrides
from mbocp.problem.file.read_tables import ProblemTable, check_tables
from mbocp.study.run_task import StudyJob, check_record
from mbocp.study.study_schema import StudyTable
from mbocp.study.values import (
    LABEL,
    Dimension,
    axis_dimension,
    check_fixed,
    grid_dimensions,
    list_dimension,
    sample_dimension,
)

_GOALS = ("goal", "start", "guess")  # numbers there tell tasks apart, not groups of tasks


@dataclass(frozen=True)
class Task:
    """One problem of a study.

    Attributes
    ----------
    index : int
        Counts from 0; the last dimension varies fastest.
    values : mapping
        What was varied, as its row says it.
    overrides : mapping
        What has to be changed in the problem, by dotted key.
    """

    index: int
    values: Mapping[str, Any]
    overrides: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Study:
    """Many problems: the product of a grid, axes of named values, and a random sample or a list.

    `Study.load` reads one from a file, `Study.from_tables` from the same words in Python.

    Attributes
    ----------
    name : str
    job : StudyJob
        What is the same for all tasks: the problem's tables, the time limit, what is recorded.
    dimensions : tuple of Dimension
        Grid keys, axes, then the sample or the list; each in the order of the file.
    tables : mapping
        The study as it was written, with the problem's tables: what its digest is made of.
    by : tuple of str or None
        What the summary goes by, if the study says so.
    goal_distance : float or None
        Distance from the goal beyond which a converged task does not count as a success.
    """

    name: str
    job: StudyJob
    dimensions: tuple[Dimension, ...]
    tables: Mapping[str, Any]
    by: tuple[str, ...] | None = None
    goal_distance: float | None = None

    @classmethod
    def load(cls, path: str | Path) -> Study:
        """Read a study file; relative paths in it are relative to its folder.

        Raises
        ------
        StudyFileError
            If the file is missing, is not TOML, or has a wrong key or value.
        ProblemFileError
            If the problem file is missing, is not TOML, or has a wrong key or value.
        """
        path = Path(path)
        try:
            tables = load_document(path, "a study file")
        except ProblemFileError as error:
            raise StudyFileError(path, error.reason) from error
        if "robot" in tables and "problem" not in tables:
            reason = f"is a problem, expected a study that says problem = {show(path.name)}"
            raise StudyFileError(path, reason)
        return cls.from_tables(tables, source=path)

    @classmethod
    def from_tables(cls, tables: Mapping[str, Any], *, source: Path | None = None) -> Study:
        """Make a study from the tables of a study file.

        Parameters
        ----------
        tables : mapping
            Arrays may be NumPy's.
        source : Path, optional
            The file that they come from; else relative paths start from the working directory.
        """
        label = str(source) if source is not None else "<study>"
        try:
            table = StudyTable.model_validate(plain(tables))
        except ValidationError as error:
            wrong = schema_error(label, StudyTable, error)
            raise StudyFileError(label, wrong.reason, wrong.key) from error
        with _in_study(label):
            return _study(table, source, label)

    def __len__(self) -> int:
        return math.prod(len(dimension.points) for dimension in self.dimensions)

    def __repr__(self) -> str:
        return f"<Study {self.name}: {len(self)} tasks over {', '.join(self.names)}>"

    @property
    def names(self) -> tuple[str, ...]:
        """What is varied: keys and names of axes."""
        return tuple(name for dimension in self.dimensions for name in dimension.names)

    @property
    def groups(self) -> tuple[str, ...]:
        """What the summary goes by, unless told otherwise.

        Axes and labels, words and booleans, and numbers of a grid or list that are no start, goal or guess.
        """
        if self.by is not None:
            return self.by
        axes_first = sorted(self.dimensions, key=lambda dimension: dimension.kind != "axis")
        return tuple(
            name for dimension in axes_first for name in dimension.names if _tells_groups(dimension, name)
        )

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all that decides what the tasks are."""
        text = json.dumps(self.tables, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()

    def task(self, index: int) -> Task:
        """Task of that index.

        Raises
        ------
        IndexError
            If there is none.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"task {index} of {len(self)}")
        values: dict[str, Any] = {}
        overrides: dict[str, Any] = {}
        rest, stride = index, len(self)
        for dimension in self.dimensions:
            stride //= len(dimension.points)
            place, rest = divmod(rest, stride)
            values |= dimension.points[place].values
            overrides |= dimension.points[place].overrides
        return Task(index, values, overrides)

    def tasks(self) -> Iterator[Task]:
        """All tasks in order."""
        return (self.task(index) for index in range(len(self)))


@contextmanager
def _in_study(label: str) -> Iterator[None]:
    """Name the study file in errors that only name the place in it."""
    try:
        yield
    except StudyFileError:
        raise
    except StudyError as error:
        raise StudyFileError(label, str(error).removeprefix(f"{error.key}: "), error.key) from error


def _study(table: StudyTable, source: Path | None, label: str) -> Study:
    folder = source.parent if source is not None else Path()
    problem_path = folder / table.problem if isinstance(table.problem, str) else None
    document = load_document(problem_path) if problem_path is not None else dict(table.problem)
    check_record(table.record)
    try:
        document = apply_overrides(document, check_fixed(table.fixed))
    except ProblemFileError as error:
        raise StudyError(f"fixed: {error.reason}") from error
    origin = problem_path if problem_path is not None else source
    job = StudyJob(
        document=document,
        source=origin.absolute() if origin is not None else None,
        label=str(origin) if origin is not None else label,
        record=tuple(table.record),
        time_limit=table.time_limit,
    )
    study = Study(
        name=table.name or (source.stem if source is not None else "study"),
        job=job,
        dimensions=_dimensions(table),
        tables=_definition(table, document),
        by=tuple(table.summary.by) if table.summary.by is not None else None,
        goal_distance=table.summary.goal_distance,
    )
    _check_names(study, table)
    _check_tables(study, label)
    return study


def _dimensions(table: StudyTable) -> tuple[Dimension, ...]:
    if table.sample is not None and table.list:
        raise StudyError("sample: give [sample] or [[list]], not both")
    found = [*grid_dimensions(table.grid), *(axis_dimension(axis, i) for i, axis in enumerate(table.axis))]
    if table.sample is not None:
        found.append(sample_dimension(table.sample, table.seed))
    if table.list:
        found.append(list_dimension(table.list))
    if not found:
        raise StudyError("nothing is varied; add [grid], [[axis]], [sample] or [[list]]")
    return tuple(found)


def _definition(table: StudyTable, document: Mapping[str, Any]) -> dict[str, Any]:
    """What makes this study another one than its like; how it is summed up does not."""
    written = table.model_dump(exclude={"problem", "fixed", "name", "summary"})
    return {"problem": plain(document), **written}


def _first_of(names: Iterable[str], others: Container[str]) -> str | None:
    """First of the names that is among the others, too."""
    return next((name for name in names if name in others), None)


def _check_names(study: Study, table: StudyTable) -> None:
    for one, other in combinations(study.dimensions, 2):
        both = _first_of(one.keys, other.keys) or _first_of(one.names, other.names)
        if both is not None:
            raise StudyError(f"{other.kind}: {both!r} is varied by {one.kind}, too; vary it in one place")
    for dimension in study.dimensions:
        fixed = _first_of(dimension.keys, table.fixed)
        if fixed is not None:
            raise StudyError(f"fixed.{fixed}: is varied by {dimension.kind}; fix it or vary it")
    for name in study.by or ():
        if name not in study.names:
            raise StudyError(f"summary.by: {name!r} is not varied; varied are {', '.join(study.names)}")


def _check_tables(study: Study, label: str) -> None:
    """Refuse keys and kinds of values that no problem has, before anything is run.

    One task is looked at for each set of keys; what depends on the robot is looked at when it is solved.
    """
    first = study.task(0).overrides
    looked_at: set[frozenset[str]] = set()
    for dimension in study.dimensions:
        for point in dimension.points:
            if (keys := frozenset(point.overrides)) in looked_at:
                continue
            looked_at.add(keys)
            _check_document(study.job, {**first, **point.overrides}, label)


def _check_document(job: StudyJob, overrides: Mapping[str, Any], label: str) -> None:
    try:
        document = apply_overrides(job.document, overrides)
    except ProblemFileError as error:
        raise StudyFileError(label, error.reason) from error
    try:
        check_tables(document)
    except ValidationError as error:
        wrong = schema_error(job.label, ProblemTable, error)
        key = wrong.key or ""
        if any(key == varied or key.startswith(f"{varied}.") for varied in overrides):
            raise StudyFileError(label, wrong.reason, key) from error
        raise wrong from error


def _tells_groups(dimension: Dimension, name: str) -> bool:
    """Whether the rows of a value of `name` are a group that a person compares with the others."""
    if dimension.kind == "axis" or name == LABEL:
        return True
    values = [point.values[name] for point in dimension.points if name in point.values]
    if all(isinstance(value, (str, bool)) for value in values):
        return True
    numbers = all(isinstance(value, (int, float)) for value in values)
    return numbers and dimension.kind != "sample" and name.split(".")[0] not in _GOALS

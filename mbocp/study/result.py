"""`StudyResult`: the rows of a study, as columns, as a summary, as a table for other programs."""

from __future__ import annotations

import csv
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbocp._arrays import dataclass
from mbocp.exceptions import StudyError, suggest
from mbocp.solution.atomic import atomic_path
from mbocp.study.run_task import FIELDS
from mbocp.study.summary import Summary, summarise
from mbocp.study.table import read_table


@dataclass(frozen=True, eq=False)
class StudyResult:
    """What came of a study so far.

    Attributes
    ----------
    header : mapping
        What the file says of the study: `name`, `tasks`, `varied`, `by`, `record`, `mbocp`, `digest`,
        `tables`.
    rows : tuple of mapping
        One for each task that is done, in the order of the tasks: `index`, `values`, the columns of every
        row, and `record`.
    """

    header: Mapping[str, Any]
    rows: tuple[Mapping[str, Any], ...]

    @classmethod
    def load(cls, path: str | Path) -> StudyResult:
        """Read a study's file, finished or not.

        Raises
        ------
        ResultFileError
            If there is no such file, it is no study's, or it is damaged.
        """
        header, rows = read_table(path)
        return cls(header, tuple(rows))

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        return f"<StudyResult {self.name}: {len(self)} of {self.num_tasks} tasks>"

    @property
    def name(self) -> str:
        """Name of the study."""
        return str(self.header.get("name", ""))

    @property
    def num_tasks(self) -> int:
        """Number of tasks of the study, done or not."""
        return int(self.header.get("tasks", 0))

    @property
    def is_complete(self) -> bool:
        """Whether every task has a row."""
        return len(self) == self.num_tasks

    @property
    def missing(self) -> tuple[int, ...]:
        """Indices of the tasks without a row."""
        done = {row["index"] for row in self.rows}
        return tuple(index for index in range(self.num_tasks) if index not in done)

    @property
    def not_converged(self) -> dict[str, int]:
        """How the tasks ended that did not converge, and how many of each kind, the most frequent first."""
        ends = Counter(str(row.get("status", "")) for row in self.rows if not row.get("converged", False))
        return dict(ends.most_common())

    @property
    def columns(self) -> tuple[str, ...]:
        """Names that `column` takes: index, what was varied, the columns of every row, what was recorded."""
        return ("index", *self._list("varied"), *FIELDS, *self._list("record"))

    def column(self, name: str) -> NDArray[Any]:
        """One column over all rows.

        Numbers that are missing are NaN, words that are missing "". Lists of one shape become further axes;
        what fits nowhere else has dtype object.

        Raises
        ------
        StudyError
            If there is no such column.
        """
        return _as_array(self._entries(name))

    def summary(self, by: Sequence[str] | None = None, goal_distance: float | None = None) -> Summary:
        """Success, iterations, time and cost for each group of tasks.

        Parameters
        ----------
        by : sequence of str, optional
            What was varied and tells the groups apart; an empty one takes all tasks together. Default: what
            the study says, else axes, words and numbers that are no start, goal or guess.
        goal_distance : float, optional
            How far from the goal a success may end. Default: what the study says, else as far as it likes.

        Raises
        ------
        StudyError
            If something in `by` was not varied.
        """
        by = tuple(self.header.get("by", ())) if by is None else tuple(by)
        for name in by:
            if name not in self._list("varied"):
                raise StudyError(f"{name!r} was not varied: {suggest(name, self._list('varied'))}")
        reach = self.header.get("goal_distance") if goal_distance is None else goal_distance
        return summarise(self.rows, by, reach)

    def to_csv(self, path: str | Path) -> Path:
        """Write all rows as a table; lists and names become columns ``name[0]``, ``name[word]``, nests JSON.

        Raises
        ------
        ResultFileError
            If the file cannot be written.
        """
        names, columns = zip(*(column for name in self.columns for column in self._flat(name)), strict=True)
        with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(names)
            writer.writerows(zip(*columns, strict=True))
        return Path(path)

    def _flat(self, name: str) -> Iterator[tuple[str, list[Any]]]:
        """Columns of a table that a column of the result becomes, with their names."""
        entries = self._entries(name)
        words = dict.fromkeys(word for entry in entries if isinstance(entry, dict) for word in entry)
        for word in words:
            yield f"{name}[{word}]", [_plain(entry.get(word)) if entry else None for entry in entries]
        if words:
            return
        lists = [entry for entry in entries if _is_plain_list(entry)]
        width = max(map(len, lists), default=0)
        if not width or len(lists) + entries.count(None) < len(entries):
            yield name, [_plain(entry) for entry in entries]
            return
        for i in range(width):
            yield f"{name}[{i}]", [e[i] if e and i < len(e) else None for e in entries]

    def plot(self, path: str | Path, by: Sequence[str] | None = None) -> Path:
        """Draw the summary as bars: PNG, PDF or SVG by the suffix."""
        from mbocp.study.plot import plot_summary  # Matplotlib takes its time to load

        return plot_summary(self.summary(by), path, title=self.name)

    def _list(self, key: str) -> list[str]:
        return list(self.header.get(key, ()))

    def _entries(self, name: str) -> list[Any]:
        if name == "index" or name in FIELDS:
            return [row.get(name) for row in self.rows]
        if name in self._list("varied"):
            return [row.get("values", {}).get(name) for row in self.rows]
        if name in self._list("record"):
            return [row.get("record", {}).get(name) for row in self.rows]
        raise StudyError(f"there is no column {name!r}: {suggest(name, self.columns)}")


def _plain(entry: Any) -> Any:
    """Return what a cell of a table holds."""
    return json.dumps(entry) if isinstance(entry, (list, dict)) else entry


def _is_plain_list(entry: Any) -> bool:
    return isinstance(entry, list) and not any(isinstance(part, (list, dict)) for part in entry)


def _as_array(entries: list[Any]) -> NDArray[Any]:
    present = [entry for entry in entries if entry is not None]
    kind = _kind_of(entries, present) if present else None
    if kind is not None:
        return np.array(["" if entry is None else entry for entry in entries], dtype=kind)
    shape = _shape_of(present)
    if shape is not None:
        filled = [np.full(shape, np.nan) if entry is None else entry for entry in entries]
        return np.array(filled, dtype=np.float64)  # None within a list is NaN
    array = np.empty(len(entries), dtype=np.object_)
    array[:] = entries
    return array


def _kind_of(entries: list[Any], present: list[Any]) -> type[np.generic] | None:
    """Return the type of booleans, words or whole numbers; words alone may be missing."""
    kinds = set(map(type, entries))
    if kinds == {bool}:
        return np.bool_
    if kinds == {int}:
        return np.int64
    return np.str_ if all(isinstance(entry, str) for entry in present) else None


def _shape_of(present: list[Any]) -> tuple[int, ...] | None:
    """Return the shape of numbers or lists of numbers; None where they have none in common."""
    try:
        shapes = {np.array(entry, dtype=np.float64).shape for entry in present}
    except (TypeError, ValueError):  # words, tables or ragged lists
        return None
    return shapes.pop() if len(shapes) == 1 else None if present else ()

"""Results of long measurements, one line of JSON each, so that parts of one can be run apart and added up."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

__all__ = ["Found", "Key", "Records"]


@dataclass(frozen=True)
class Found:
    """What one way of solving came to.

    Attributes
    ----------
    cost : float
        Infinite where the optimality conditions do not hold.
    iterations : int
    seconds : float
        Processor time of the whole solve.
    is_resolved : bool
        Whether the optimality conditions hold and the steps resolve the motion.
    """

    cost: float
    iterations: int
    seconds: float
    is_resolved: bool

    @property
    def resolved_cost(self) -> float:
        """The cost; infinite for what is no motion."""
        return self.cost if self.is_resolved else math.inf


@dataclass(frozen=True, order=True)
class Key:
    """What was solved: set of tasks, cost, seed, number of the task, way of solving."""

    set: str
    cost: str
    seed: int
    task: int
    way: str


@dataclass
class Records:
    """Results by what was solved; those of a file, to which new ones are appended, or of this run alone."""

    path: Path | None = None
    found: dict[Key, Found] = field(default_factory=dict)

    @classmethod
    def read(cls, *paths: Path) -> Records:
        """Results of all files that exist; new ones go to the first."""
        records = cls(paths[0] if paths else None)
        for path in paths:
            for line in path.read_text().splitlines() if path.exists() else ():
                key, found = _parsed(line)
                records.found[key] = found
        return records

    def add(self, key: Key, found: Found) -> None:
        """Keep one result."""
        self.found[key] = found
        if self.path is not None:
            with self.path.open("a") as file:
                file.write(json.dumps(_written(key, found)) + "\n")

    def of(self, name: str, cost: str, ways: tuple[str, ...]) -> Iterator[dict[str, Found]]:
        """What each way came to, of every task that all ways have solved, in order."""
        numbers = sorted({(key.seed, key.task) for key in self.found if (key.set, key.cost) == (name, cost)})
        for seed, task in numbers:
            keys = {way: Key(name, cost, seed, task, way) for way in ways}
            if all(key in self.found for key in keys.values()):
                yield {way: self.found[key] for way, key in keys.items()}


def _written(key: Key, found: Found) -> dict[str, object]:
    finite = found.cost if math.isfinite(found.cost) else None
    return {**asdict(key), **asdict(found), "cost_found": finite, "cost": key.cost}


def _parsed(line: str) -> tuple[Key, Found]:
    entry = json.loads(line)
    cost = entry["cost_found"]
    return (
        Key(entry["set"], entry["cost"], entry["seed"], entry["task"], entry["way"]),
        Found(
            math.inf if cost is None else cost, entry["iterations"], entry["seconds"], entry["is_resolved"]
        ),
    )

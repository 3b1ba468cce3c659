"""The experiment of section 5.2 of [Manara2017]_: a lattice of tasks by six formulations, as a study."""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

import mbocp
from mbocp.exceptions import InvalidValue, ProblemFileError
from mbocp.problem import Problem, load_problem
from mbocp.study import Study
from mbocp_papers.so3.data import Formulation, Task

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

Variant = Literal["corrected", "as_printed"]

SOLVERS = ("ipopt", "fatrop", "monolithic")

# What each variant changes of the problem. As printed, the end condition has a row that the dynamics meet by
# themselves, nothing excludes half-turns of a rotation matrix, and a guess at rest agrees with no kinematics.
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "corrected": {},
    "as_printed": {"goal.redundant": "keep", "goal.guard": False, "guess.kind": "at_rest"},
}

_WORDS = re.compile(r"([1-9]\d*)x([1-9]\d*)x([1-9]\d*)")


@dataclass(frozen=True)
class Lattice:
    """Size of the lattice of tasks.

    Attributes
    ----------
    positions : int
        Places along each side of the square of 2 m.
    yaws : int
        Yaw angles at each place.
    """

    positions: int = 13
    yaws: int = 12

    def __str__(self) -> str:
        return f"{self.positions}x{self.positions}x{self.yaws}"

    @property
    def num_tasks(self) -> int:
        """Tasks for each formulation."""
        return self.positions**2 * self.yaws


def parse_lattice(words: str) -> Lattice:
    """Lattice from words such as "13x13x12".

    Raises
    ------
    InvalidValue
        If they are not of this kind, or the places make no square.
    """
    found = _WORDS.fullmatch(words.strip())
    if found is None:
        raise InvalidValue("--lattice", words, "places along x, along y and yaw angles, as in 13x13x12")
    x, y, yaws = map(int, found.groups())
    if x != y:
        raise InvalidValue("--lattice", words, "as many places along x as along y, as in 5x5x4")
    return Lattice(x, yaws)


def check_choice(option: str, value: str, choices: Mapping[str, Any] | tuple[str, ...]) -> None:
    """Refuse a word that is none of the choices.

    Raises
    ------
    InvalidValue
    """
    if value not in choices:
        raise InvalidValue(option, value, f"one of {', '.join(choices)}")


def example_file(name: str) -> Path:
    """Where a file of examples/so3 is: in the installed package, or in the sources.

    Raises
    ------
    ProblemFileError
        If there is none: mbocp is not installed as it should be.
    """
    package = Path(mbocp.__file__).resolve().parent
    places = [package / "data" / "so3" / name, package.parent / "examples" / "so3" / name]
    for place in places:
        if place.is_file():
            return place
    looked = " and ".join(str(place.parent) for place in places)
    raise ProblemFileError(name, f"not found in {looked}; install mbocp again, or from its sources")


def lattice_study(
    lattice: Lattice | None = None,
    variant: str = "corrected",
    solver: str = "monolithic",
    labels: Sequence[str] | None = None,
) -> Study:
    """Study of all tasks of a lattice by the six formulations.

    With the defaults it is that of examples/so3/lattice.toml.

    Parameters
    ----------
    lattice : Lattice, optional
        Default: the paper's, 13 x 13 x 12.
    variant : {"corrected", "as_printed"}
        See `VARIANTS`.
    solver : {"monolithic", "fatrop", "ipopt"}
    labels : sequence of str, optional
        Formulations to try; default: all six.
    """
    check_choice("variant", variant, VARIANTS)
    check_choice("solver", solver, SOLVERS)
    lattice = lattice or Lattice()
    path = example_file("lattice.toml")
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    tables["fixed"] |= {"solver.method": solver, **VARIANTS[variant]}
    side = {"linspace": [-1.0, 1.0, lattice.positions]} if lattice.positions > 1 else [0.0]
    turn = {"linspace": [0.0, float(2 * np.pi * (lattice.yaws - 1) / lattice.yaws), lattice.yaws]}
    tables["grid"] = {
        "goal.q.base_x": side,
        "goal.q.base_y": side,
        "goal.q.yaw": turn if lattice.yaws > 1 else [0.0],
    }
    if labels is not None:
        (axis,) = tables["axis"]
        axis["values"] = [value for value in axis["values"] if value["label"] in labels]
    return Study.from_tables(tables, source=path)


def task_problem(
    formulation: Formulation, task: Task | None = None, settings: Mapping[str, Any] | None = None
) -> Problem:
    """Problem of one task by one formulation.

    Parameters
    ----------
    formulation : Formulation
    task : Task, optional
        Default: x = y = 0.5 m, theta = pi, which the paper's figures show.
    settings : mapping, optional
        Further changes of the problem file, by dotted key.
    """
    changes: dict[str, Any] = {
        "robot.rotations": formulation.rotations,
        "integrator.lie": formulation.lie,
        "solver.method": "ipopt",
        "guess.kind": "line",
    }
    if task is not None:
        changes |= {"goal.q.base_x": task.x, "goal.q.base_y": task.y, "goal.q.yaw": task.yaw}
    return load_problem(example_file("unicycle_pendulum.toml"), {**changes, **(settings or {})})

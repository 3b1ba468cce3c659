"""`[guess]`: its keys, from what is written to a guess, and back."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from mbocp._arrays import Array
from mbocp._files import is_file
from mbocp._keys import Key, Table
from mbocp._text import show
from mbocp.exceptions import ProblemError
from mbocp.problem._checks import choice
from mbocp.problem.file.named_values import configuration_from, control_from
from mbocp.problem.guess import GUESSES, Guess
from mbocp.robot import Robot
from mbocp.terms.written import Control, VectorOrNamed


class GuessTable(Table):
    """Where the solver starts."""

    kind: Annotated[
        str | None, choice(GUESSES), Key("[where the solver starts](solver.md#guesses)", "", '`"auto"`')
    ] = None
    u: Annotated[Control, Key('constant control (kind `"control"`)', "N, N m")] = None
    q: Annotated[list[VectorOrNamed] | None, Key('configurations on the way (kind `"way"`)', "rad, m")] = None
    file: Annotated[str | None, Key('a saved result (kind `"solution"`)', "", "", "path")] = None
    at: Annotated[
        float | None,
        Key("time of `guess.file` at which the problem [begins](results.md#warm-starts)", "s", "found"),
    ] = None


def read_guess(guess_table: GuessTable, robot: Robot, said_q_start: Array, folder: Path) -> Guess:
    """Make the guess; a `kind` that is written leaves the other kinds' keys unused (`--set guess.kind=`)."""
    table, q_start = guess_table, said_q_start
    kind = table.kind
    if kind is None:
        given = {"control": table.u, "way": table.q, "solution": table.file}
        kind = next((name for name, value in given.items() if value is not None), "auto")
    u = control_from(robot, table.u, "guess.u") if table.u is not None and kind == "control" else None
    path = folder / table.file if table.file is not None and kind == "solution" else None
    if path is not None and not is_file(path):
        raise ProblemError(f"guess.file: no such file {show(str(path))}")
    q = _corners(table.q, robot, q_start) if table.q is not None and kind == "way" else None
    at = table.at if kind == "solution" else None
    return Guess(kind=kind, u=u, path=path, q=q, at=at)  # type: ignore[arg-type]  # checked by the class


def _corners(written: Sequence[Any], robot: Robot, q_start: Array) -> Array:
    """Configurations of a guess, shape (n, nq); joints that one does not name are where they start."""
    if not written:
        raise ProblemError("guess.q: expected at least one configuration between start and goal")
    found = [configuration_from(robot, row, q_start, "guess.q")[0] for row in written]
    return np.array([robot.normalise(q, name="guess.q") for q in found])


def write_guess(guess: Guess) -> dict[str, Any]:
    """Return the table that reads back as the same."""
    file = str(guess.path.resolve()) if guess.path else None
    return {"kind": guess.kind, "u": guess.u, "q": guess.q, "file": file, "at": guess.at}

"""The tables `[integrator]` and `[guess]`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from mbocp._arrays import Array
from mbocp._files import is_file
from mbocp._keys import Key, Table
from mbocp._text import show
from mbocp.exceptions import ProblemError
from mbocp.integrators import LIE_METHODS, SCHEMES
from mbocp.problem._checks import choice, whole
from mbocp.problem.file.named_values import configuration_from, control_from
from mbocp.problem.integration import AUTO_SCHEME, Stabilisation
from mbocp.problem.problem_data import ProblemData
from mbocp.problem.solver import GUESSES, Guess
from mbocp.robot import Robot
from mbocp.terms.written import Control, NonNegative, VectorOrNamed


class IntegratorTable(Table):
    """How time is discretised."""

    scheme: Annotated[
        str,
        choice((AUTO_SCHEME, *SCHEMES)),
        Key(
            '`"auto"`: [what suits](#the-scheme-that-suits); '
            "[tau family](mathematics.md#one-step-the-tau-family): "
            '`"se1"`, `"se2"`, `"midpoint"`, `"projected_midpoint"`, `"semi_implicit_euler"`; '
            "[of higher order](mathematics.md#symplectic-methods-of-higher-order): "
            '`"lobatto2"`, `"lobatto3"`, without loops `"gauss1"`, `"gauss2"`, `"gauss3"`, '
            '`"radau2"`, `"radau3"`; [explicit](#explicit-schemes): `"euler"`, `"heun"`, `"rk4"`, `"rkf5"`',
            takes="string",
        ),
    ] = AUTO_SCHEME
    lie: Annotated[str, choice(LIE_METHODS), Key("how [rotations stay rotations](#explicit-schemes)")] = (
        "munthe_kaas"
    )
    substeps: Annotated[int, whole(1), Key("explicit schemes: their steps within one of the N")] = 1
    gamma_quaternion: Annotated[
        NonNegative, Key('`"baumgarte"`: of quaternions, eq. (46) of [Manara2017]', "1/s")
    ] = Stabilisation.gamma_quaternion
    gamma_dcm: Annotated[NonNegative, Key('`"baumgarte"`: of rotation matrices, eq. (47)', "1/s")] = (
        Stabilisation.gamma_dcm
    )
    gamma_constraint: Annotated[
        NonNegative, Key("explicit schemes: Baumgarte's rate for constraints", "1/s")
    ] = Stabilisation.gamma_constraint


def read_integrator(integrator_table: IntegratorTable) -> tuple[str, str, int, Stabilisation]:
    """Return scheme, method for rotations, steps within a step, and rates."""
    table = integrator_table
    rates = Stabilisation(**{field.name: getattr(table, field.name) for field in fields(Stabilisation)})
    return table.scheme, table.lie, table.substeps, rates


def write_integrator(problem: ProblemData) -> dict[str, Any]:
    """Return the table that reads back as the same."""
    options = {"lie": problem.lie, "substeps": problem.substeps, **asdict(problem.stabilisation)}
    taken = {key: v for key, v in options.items() if SCHEMES[problem.scheme].takes(f"integrator.{key}")}
    return {"scheme": problem.scheme, **taken}


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

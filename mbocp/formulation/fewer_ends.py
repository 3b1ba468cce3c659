"""A formulation less some rows of its end condition: all else of it stays as it is, and is not made again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.base import Formulation
from mbocp.formulation.build import load_end_functions
from mbocp.formulation.goal import EndTarget
from mbocp.formulation.layout import places
from mbocp.formulation.parameters import concatenate
from mbocp.formulation.pieces import Pieces
from mbocp.formulation.rows import RowDescriber
from mbocp.formulation.units import units_of_end
from mbocp.programme import StagewiseProgramme


def without_end_rows(
    formulation: Formulation, rows: Sequence[int], *, deadline: float = math.inf
) -> Formulation:
    """Formulation of the same problem, less some rows of the joints' end condition.

    Parameters
    ----------
    formulation : Formulation
        One of the package's.
    rows : sequence of int
        As `EndRows.of_joints` has them.
    deadline : float
        Time of `time.perf_counter` at which compiling is given up.

    Raises
    ------
    TranscriptionError
        If the functions of the end cannot be compiled, or not before the deadline.
    """
    pieces = _fewer(formulation.pieces, rows)
    programme = _with_end_of(formulation.programme, formulation.pieces, pieces, deadline)
    return replace(formulation, programme=programme, end_rows=pieces.end_rows, pieces=pieces)


def _fewer(pieces: Pieces, rows: Sequence[int]) -> Pieces:
    end_rows, end = pieces.end_rows.without(rows), pieces.end
    count = len(end.D_q)
    goal = replace(pieces.signature.goal, ng_q=len(end_rows.D_q), ng_rate=len(end_rows.D_rate))
    return replace(
        pieces,
        signature=replace(pieces.signature, goal=goal),
        end_rows=end_rows,
        end=EndTarget(
            np.delete(end.D_q, [row for row in rows if row < count], axis=0),
            np.delete(end.D_rate, [row - count for row in rows if row >= count], axis=0),
            end.rate,
        ),
    )


def _with_end_of(
    programme: StagewiseProgramme, before: Pieces, pieces: Pieces, deadline: float
) -> StagewiseProgramme:
    problem, signature, layout = pieces.problem, pieces.signature, pieces.parameters
    numbers = {
        name: programme.rho_terminal[place] for name, place in places(before.parameters.terminal).items()
    }
    numbers |= {"D_q": _by_columns(pieces.end.D_q), "D_rate": _by_columns(pieces.end.D_rate)}
    of_force, force_rows = units_of_end(signature, layout)
    return replace(
        programme,
        ng=signature.end_rows,
        end_functions=load_end_functions(
            signature, problem.robot, deadline, at_once=problem.solver.is_interior_point
        ),
        rho_terminal=concatenate(numbers, layout.terminal),
        terminal_weights=layout.weighing(layout.terminal),
        describe_row=RowDescriber(pieces, programme.bounds),
        units=replace(programme.units, terminal=of_force, end_rows=force_rows),
    )


def _by_columns(D: Array) -> Array:
    return D.ravel(order="F")  # as CasADi reshapes

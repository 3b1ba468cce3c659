"""Which formulation a problem asks for: the one place where coordinates and schemes are looked at.

A formulation less some rows of its end condition keeps all else, which is not made again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from weakref import WeakValueDictionary

import numpy as np

from mbocp._arrays import Array
from mbocp.formulation.base import Formulation
from mbocp.formulation.build import load_end_functions
from mbocp.formulation.end_rows import EndTarget
from mbocp.formulation.layout import places
from mbocp.formulation.ordinary_units import units_of_end
from mbocp.formulation.parameter_layout import concatenate
from mbocp.formulation.pieces import Pieces
from mbocp.formulation.row_words import RowDescriber
from mbocp.integrators import PAIRS, TABLEAUX
from mbocp.problem import Problem
from mbocp.programme import StagewiseProgramme
from mbocp.solvers.reachability import dependent_end_rows

_in_use: WeakValueDictionary[int, Formulation] = WeakValueDictionary()  # each holds its problem


def formulate(problem: Problem, without: Sequence[int] = (), *, deadline: float = math.inf) -> Formulation:
    """Formulation of a problem with its stagewise programme, compiled or from the cache.

    Parameters
    ----------
    problem : Problem
    without : sequence of int
        Rows of the end condition to leave out.
    deadline : float
        Time of `time.perf_counter` at which compiling is given up.

    Raises
    ------
    TranscriptionError
        If the stage functions would be too large, cannot be compiled, or not before the deadline.
    MemoryLimitExceeded
        If the horizon has more steps than there is memory for.
    InconsistentStart
        If the scheme cannot begin with the start velocity in steps of this length.
    ProblemError
        If a velocity is limited that is no unknown, because controls prescribe it.
    """
    found = _family_of(problem).of(problem, deadline=deadline)
    return without_end_rows(found, without, deadline=deadline) if without else found


def pieces_of(problem: Problem, without: Sequence[int] = ()) -> Pieces:
    """What a problem's programme is made of; see `formulate`, of which it takes a part of the time."""
    return _fewer(_family_of(problem).pieces_of(problem), without)


def formulate_with_independent_ends(problem: Problem, deadline: float) -> tuple[Formulation, str]:
    """Formulate a problem without end conditions that the dynamics meet by themselves, and name these.

    Raises
    ------
    MbocpError
        As `formulate` does.
    """
    found, told = formulate(problem, deadline=deadline), ""
    rows = find_implied_end_rows(found)
    if rows:
        names = ", ".join(found.programme.describe_row(-1, row) for row in rows)
        told = f"; left out, since the dynamics imply it: {names}"
        found = without_end_rows(found, rows, deadline=deadline)
    _in_use[id(problem)] = found
    return found, told


def formulation_in_use(problem: Problem) -> Formulation | None:
    """Formulation of this very problem with independent ends, where something holds one: its solution may."""
    found = _in_use.get(id(problem))
    return found if found is not None and found.problem is problem else None


def find_implied_end_rows(whole: Formulation) -> tuple[int, ...]:
    """Rows of the joints' end condition that the dynamics meet by themselves, and that may be left out.

    Raises
    ------
    OverdeterminedGoal
        If no control acts upon one that is not met.
    """
    if not whole.end_rows_may_depend or whole.problem.goal.redundant == "keep":
        return ()
    projections = whole.end_rows.of_joints
    dependent = dependent_end_rows(whole.programme, projections)
    return tuple(row for row in dependent if row < len(projections))  # conditions of one's own stay


def with_compiled_functions(formulation: Formulation) -> Formulation:
    """The formulation with compiled functions, unless there is no compiler: for loops that go on for long.

    Raises
    ------
    CompilationError
        If the compiler refuses the generated code, or nothing can be written.
    """
    programme = formulation.programme.compile()
    return replace(formulation, programme=programme)


def _family_of(problem: Problem) -> type[Formulation]:
    # Each is imported where it is asked for: they are as large as all that they share.
    if problem.scheme in TABLEAUX:
        from mbocp.formulation.schemes.explicit import ExplicitFormulation

        return ExplicitFormulation
    if problem.scheme in PAIRS:
        from mbocp.formulation.schemes.symplectic import PartitionedFormulation

        return PartitionedFormulation
    # Robots whose bodies only slide have the same equations in both coordinates.
    if problem.coordinates == "natural" and _has_turning_bodies(problem):
        from mbocp.formulation.schemes.natural import NaturalFormulation

        return NaturalFormulation
    from mbocp.formulation.schemes.implicit import ImplicitFormulation

    return ImplicitFormulation


def _has_turning_bodies(problem: Problem) -> bool:
    from mbocp.mechanics import natural_mechanics

    return bool(natural_mechanics(problem.robot).tree.turning)


def transcribe(
    problem: Problem, without: Sequence[int] = (), *, deadline: float = math.inf
) -> StagewiseProgramme:
    """Stagewise programme of a problem, all that a solver asks for; see `formulate`."""
    return formulate(problem, without, deadline=deadline).programme


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
    if not rows:
        return pieces
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
        terminal_weights=layout.weight_entries(layout.terminal),
        describe_row=RowDescriber(pieces, programme.bounds),
        units=replace(programme.units, terminal=of_force, end_rows=force_rows),
    )


def _by_columns(D: Array) -> Array:
    return D.ravel(order="F")  # as CasADi reshapes

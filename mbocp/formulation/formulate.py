"""Which formulation a problem asks for: the one place where coordinates and schemes are looked at."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from mbocp.formulation.base import Formulation
from mbocp.integrators import PAIRS, TABLEAUX
from mbocp.problem import Problem
from mbocp.programme import StagewiseProgramme
from mbocp.solvers.reachability import dependent_end_rows


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
    found = _formulate(problem, deadline)
    if not without:
        return found
    from mbocp.formulation.fewer_ends import without_end_rows

    return without_end_rows(found, without, deadline=deadline)


def formulate_with_independent_ends(problem: Problem, deadline: float) -> tuple[Formulation, str]:
    """Formulate a problem without end conditions that the dynamics meet by themselves, and name these.

    Raises
    ------
    MbocpError
        As `formulate` does.
    """
    whole = formulate(problem, deadline=deadline)
    rows = implied_end_rows(whole)
    if not rows:
        return whole, ""
    from mbocp.formulation.fewer_ends import without_end_rows

    names = ", ".join(whole.programme.describe_row(-1, row) for row in rows)
    fewer = without_end_rows(whole, rows, deadline=deadline)
    return fewer, f"; left out, since the dynamics imply it: {names}"


def implied_end_rows(whole: Formulation) -> tuple[int, ...]:
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


def _formulate(problem: Problem, deadline: float) -> Formulation:
    # Each is imported where it is asked for: they are as large as all that they share.
    if problem.scheme in TABLEAUX:
        from mbocp.formulation.schemes.explicit import ExplicitFormulation

        return ExplicitFormulation.of(problem, deadline=deadline)
    if problem.scheme in PAIRS:
        from mbocp.formulation.schemes.partitioned import PartitionedFormulation

        return PartitionedFormulation.of(problem, deadline=deadline)
    # Robots whose bodies only slide have the same equations in both coordinates.
    if problem.coordinates == "natural" and _has_turning_bodies(problem):
        from mbocp.formulation.schemes.natural import NaturalFormulation

        return NaturalFormulation.of(problem, deadline=deadline)
    from mbocp.formulation.schemes.implicit import ImplicitFormulation

    return ImplicitFormulation.of(problem, deadline=deadline)


def _has_turning_bodies(problem: Problem) -> bool:
    from mbocp.mechanics import natural_mechanics

    return bool(natural_mechanics(problem.robot).tree.turning)


def transcribe(
    problem: Problem, without: Sequence[int] = (), *, deadline: float = math.inf
) -> StagewiseProgramme:
    """Stagewise programme of a problem, all that a solver asks for; see `formulate`."""
    return formulate(problem, without, deadline=deadline).programme

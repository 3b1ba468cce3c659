"""The top-level `solve`: from a problem, or its file, to its solution.

The module is not called `solve`: importing it would put it into the place of the function `mbocp.solve`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from mbocp.accuracy.solution_accuracy import follows_fast, with_accuracy
from mbocp.exceptions import NotConverged, ProblemError
from mbocp.job import Job
from mbocp.problem import Problem
from mbocp.problem.file.messages import in_file
from mbocp.problem.solver import MENU
from mbocp.solution import Solution
from mbocp.solution.from_files import problem_from
from mbocp.solvers.records import Callback
from mbocp.strategies import strategy_for


def excite(problem: Problem | str | Path, **options: Any) -> Solution:
    """Find the D-optimal motion from start to goal, from rest to rest: log det of its information is largest.

    Parameters
    ----------
    problem : Problem, str or Path
        With a configuration as goal, the same as the start for a periodic motion, and a duration. Its cost is
        left out.
    **options
        Keys of ``[goal.excite]``, beside those that the problem has: ``torque_noise``, ``friction``,
        ``knots``, ``starts``, ``rounds``, ``seed``.

    Returns
    -------
    Solution
        Converged or not: its `status` and `advice` tell. `mbocp.identification.information` says what it is
        worth, and `problem` is that of the motion near the spline that was found.

    Raises
    ------
    UnsupportedRobot, ProblemError, InvalidValue
        For closed loops, phases, via points, several goals, a free duration, ends that are not at rest, and
        where nothing limits how fast the robot moves.
    """
    return solve(to_excite(problem_from(problem), options))


def to_excite(problem: Problem, options: Mapping[str, Any]) -> Problem:
    """Return the problem with keys of ``[goal.excite]`` beside those that it has."""
    own = {} if problem.excite is None else asdict(problem.excite)
    return problem.with_(goal={"excite": {**own, **options}})


def solve(
    problem: Problem | str | Path,
    *,
    solver: str | None = None,
    warm_start: Solution | None = None,
    at: float | None = None,
    callback: Callback | None = None,
    check: bool = False,
    accuracy: bool | None = False,
    gains: bool = False,
    time_limit: float | None = None,
) -> Solution:
    """Solve an optimal control problem.

    Parameters
    ----------
    problem : Problem, str or Path
        The problem, or the path of a problem file, or of a result, whose problem is solved again.
    solver : str, optional
        Stands for `problem.solver.method`.
    warm_start : Solution, optional
        Start from this solution, of any number of steps, instead of the problem's guess. Where the problem
        begins later on its motion, from the rest of that. Where it leads to no solution soon, the problem's
        guess is tried, too.
    at : float, optional
        Time [s] on the motion of `warm_start` at which the problem begins. None: it is found.
    callback : callable, optional
        Called with every `IterationRecord`.
    check : bool
        Raise unless converged.
    accuracy : bool, optional
        Compare the motion with what the robot would do, see `mbocp.accuracy`. None: unless that takes long to
        compile, as it does for large closed mechanisms.
    gains : bool
        Work out `Solution.gains`, the feedback of the optimum; so does `accuracy`.
    time_limit : float, optional
        Longest time of this solve [s], beside that of the problem; the result does not record it.

    Returns
    -------
    Solution
        Converged or not: its `status` and `advice` tell. Ctrl-C ends the solve with the best iterate.

    Raises
    ------
    MbocpError
        If the problem is not well posed, or its functions cannot be compiled, or not within
        `problem.solver.time_limit` or `time_limit`.
    InvalidValue
        If `time_limit` is not positive, or `at` is no time of the motion of `warm_start`.
    NotConverged
        With `check`: carries the solution.
    """
    problem = problem_from(problem)
    if solver is not None:
        problem = problem.with_(solver=replace(problem.solver, method=solver))
    accuracy = follows_fast(problem) if accuracy is None else accuracy
    job = Job.of(
        problem, warm_start, at, time_limit=time_limit, callback=callback, has_gains=gains or accuracy
    )
    try:
        if problem.solver.starts == MENU:
            from mbocp.menus.menu import BestOfMenu  # slow to import, and wanted only here

            solution = BestOfMenu().run(job)
        else:
            solution = strategy_for(job).run(job)
        if accuracy and problem.accuracy is None:
            solution = with_accuracy(problem, solution, job.deadline)
    except ProblemError:
        if problem.source is None:
            raise
        with in_file(problem.document.label):
            raise
    if check and not solution.converged:
        raise NotConverged(solution)
    return solution

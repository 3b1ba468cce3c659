r"""Steps that an accuracy asks for: solve, estimate, refine where it is needed.

Each round solves with some steps, and again with each of them halved. The difference of the costs tells the
error of the finer, see `mbocp.accuracy.costs`; its local errors are those of `mbocp.accuracy.errors`. Where
either is too large, `mbocp.accuracy.mesh` says which steps would do, and the next round begins from the
interpolated motion. Where both seem to be small enough, coarser steps are solved, too, and the order is the
one that is seen. Steps that are more than needed are trimmed at the end, see `mbocp.accuracy.trimming`.
Lengths of steps are parameters, and functions are those of one step: after the first solve nothing is
compiled.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

from mbocp.accuracy.meshes import MOST_STEPS, Mesh, first_mesh
from mbocp.accuracy.of_solution import with_accuracy
from mbocp.accuracy.rounds import Round, asked_of, is_rough
from mbocp.accuracy.trimming import trimmed
from mbocp.problem import Problem
from mbocp.solution import Phase, Solution
from mbocp.solution.later import retold
from mbocp.solution.rest import Rest
from mbocp.solvers import Status

Work: TypeAlias = Callable[[Problem, Solution | Rest | None], Solution]

_ROUNDS = 8
_MORE = 4  # times as many steps where the first do not lead to a motion
_CHECKS, _CHECKS_ROUGH = 1, 2  # solves with fewer steps, by which orders are seen


def refined(
    problem: Problem, warm_start: Solution | Rest | None, work: Work, deadline: float = math.inf
) -> Solution:
    """Solution with as many steps as the accuracy of a problem asks for.

    Parameters
    ----------
    problem : Problem
        With `accuracy`.
    warm_start : Solution or Rest, optional
    work : callable
        Solves a problem, from a solution or from the problem's guess.
    deadline : float
        Time of `time.perf_counter` after which no round begins.

    Returns
    -------
    Solution
        `Solution.accuracy` has what was asked for and what was reached. Where it was not reached within the
        rounds, the time or the most steps, the status is `under_resolved`.
    """
    begun, rounds, failed, taken = time.perf_counter(), list[Round](), None, 0
    mesh, before = first_mesh(problem), warm_start
    for _ in range(_ROUNDS):
        pair = _pair(problem, mesh, before, work)
        taken += sum(solution.iterations for solution in pair)
        if pair[-1].is_stationary:
            found = Round.of(problem, mesh.halved().of(problem), pair, deadline=deadline)
            checks = _coarser(problem, mesh, found.solution, work) if found.is_enough else []
            taken += sum(solution.iterations for solution in checks)
            rounds.append(found.seen_with(checks, rounds[-1] if rounds else None))
            if rounds[-1].is_enough:
                rounds[-1], more = trimmed(rounds[-1], mesh, work, deadline)
                taken += more
                break
            if checks and checks[-1].status in (Status.INTERRUPTED, Status.TIME_LIMIT):
                failed = checks[-1]
                break
            mesh, before = rounds[-1].next_mesh(mesh), found.solution
        else:
            failed = pair[-1]
            if rounds or failed.status in (Status.INTERRUPTED, Status.TIME_LIMIT):
                break
            mesh, before = mesh.even(_MORE), None
        if 2 * mesh.num_steps > MOST_STEPS or time.perf_counter() > deadline:
            break
    if not rounds and failed is not None:
        return failed
    solution = _told(problem, rounds, failed, deadline)
    more, spent = taken - solution.iterations, time.perf_counter() - begun - solution.wall_time_s
    phases = (Phase("coarser steps", more, spent), *solution.phases)
    wall_time_s = solution.wall_time_s + spent
    return retold(solution, iterations=taken, phases=phases, wall_time_s=wall_time_s)


def _coarser(problem: Problem, mesh: Mesh, fine: Solution, work: Work) -> list[Solution]:
    """Solutions with fewer steps, by which orders are seen, fine to coarse."""
    found = list[Solution]()
    for _ in range(_CHECKS_ROUGH if is_rough(problem) else _CHECKS):
        mesh = mesh.coarser()
        found.append(work(mesh.of(problem), fine))
        if not found[-1].is_stationary:
            break
    return found


def _pair(problem: Problem, mesh: Mesh, before: Solution | Rest | None, work: Work) -> list[Solution]:
    """Solutions with steps and with their halves; the first alone if it fails."""
    pair: list[Solution] = []
    for steps in (mesh, mesh.halved()):
        stepped = steps.of(problem)
        found = work(stepped, before)
        pair.append(found)
        before = found
        if not found.is_stationary:
            break
    return pair


def _told(problem: Problem, rounds: list[Round], failed: Solution | None, deadline: float) -> Solution:
    """The last solution with what is known of it."""
    last, asked = rounds[-1], asked_of(problem)
    solution = with_accuracy(last.solved, last.solution, deadline)
    accuracy = replace(solution.accuracy, asked=asked, cost_error=last.cost_error, rounds=len(rounds))
    solution = retold(solution, accuracy=accuracy, guess_used=rounds[0].guess_used)
    if last.is_enough:
        return solution
    why = (
        f"with finer ones: {failed.advice}"
        if failed is not None
        else "there are no more rounds, steps or time"
    )
    status = (
        failed.status if failed is not None and failed.status is Status.INTERRUPTED else Status.UNDER_RESOLVED
    )
    words = (
        f"horizon.accuracy = {asked:g} is not reached: with {solution.num_steps} steps one is wrong by "
        f"{last.errors.largest.max():.2g} at most, the cost by {last.cost_error:.2g} of it; {why}"
    )
    return retold(solution, status=status, advice=f"{words}; {solution.advice}")

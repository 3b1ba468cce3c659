r"""Steps that an accuracy asks for: solve, estimate, refine where it is needed.

Each round solves with some steps, and again with each of them halved. The difference of the costs tells the
error of the finer, see `mbocp.accuracy.costs`; its local errors are those of `mbocp.accuracy.errors`. Where
either is too large, `mbocp.accuracy.mesh` says which steps would do, and the next round begins from the
interpolated motion. Where both seem to be small enough, coarser steps are solved, too, and the order is the
one that is seen. Lengths of steps are parameters, and functions are those of one step: after the first solve
nothing is compiled.

In the end there are as few steps as the accuracy needs: errors just below what was asked for. What the cost
tends to is known from the rounds, and so is where errors are. So any other steps are judged by one solve:
their cost against that limit, and what it is unsure by. From the motion that was found they take a few
iterations. Their number is what the errors of the last round ask for; where they come out otherwise, it is
corrected by the ratio.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import field, replace

import numpy as np

from mbocp._arrays import dataclass
from mbocp.accuracy.mesh import MOST_STEPS, Mesh, first_mesh
from mbocp.accuracy.rounds import (
    Round,
    accuracy_targets,
    is_rough,
    is_told_by_joints,
    step_errors_of,
    with_joints,
)
from mbocp.accuracy.solution_accuracy import with_accuracy
from mbocp.job import Job, Strategy, Warm
from mbocp.problem import Problem
from mbocp.solution import Phase, Solution
from mbocp.solution.later import retold
from mbocp.solvers import IterationRecord, Status
from mbocp.solvers.strategies.in_units import is_no_cost

_ROUNDS = 8
_MORE = 4  # times as many steps where the first do not lead to a motion
_CHECKS, _CHECKS_ROUGH = 1, 2  # solves with fewer steps, by which orders are seen
_TRIES = 3  # of fewer steps at the end
_AIM_STEP, _AIM_COST = 0.9, 0.99  # of what is asked, then
_WORTH, _WORTH_MORE = 0.99, 0.95  # of the steps: fewer, or the first solve and others win nothing
_MOST_CHANGE = 2.0  # of what is aimed at, from one try to the next


@dataclass(frozen=True)
class Refinement:
    """Solve with as many steps as the accuracy of a problem asks for.

    Attributes
    ----------
    once : Strategy
        For each number of steps.
    """

    once: Strategy

    def run(self, job: Job) -> Solution:
        """Solve with one number of steps after another.

        `Solution.accuracy` has what was asked for and what was reached. Where it was not reached within the
        rounds, the time or the most steps, the status is `under_resolved`.
        """
        begun, search = time.perf_counter(), _Search(job, self.once)
        try:
            search.run()
        except KeyboardInterrupt:
            if not search.rounds:
                raise
            search.interrupt()
        solution = search.solution()
        more, spent = search.taken - solution.iterations, time.perf_counter() - begun - solution.wall_time_s
        phases = (Phase("other steps", more, spent), *solution.phases)
        wall_time_s = solution.wall_time_s + spent
        return retold(solution, iterations=search.taken, phases=phases, wall_time_s=wall_time_s)


@dataclass(eq=False)
class _Search:
    """Rounds of solves, coarse to fine.

    Attributes
    ----------
    job : Job
        Of the problem with its accuracy.
    once : Strategy
    taken : int
        Iterations of all solves.
    rounds : list of Round
        Those whose steps lead to a motion.
    failed : Solution, optional
        What ended the search, or came to nothing last.
    """

    job: Job
    once: Strategy
    taken: int = 0
    rounds: list[Round] = field(default_factory=list)
    failed: Solution | None = None

    def run(self) -> None:
        """Go from round to round, until one is enough or there are no more."""
        mesh, start = first_mesh(self.job.problem), self.job.start
        for _ in range(_ROUNDS):
            pair = self._pair(mesh, start)
            following = self._judge(mesh, pair) if pair[-1].is_stationary else self._widen(mesh, pair)
            if following is None:
                break
            mesh, start = following
            if 2 * mesh.num_steps > MOST_STEPS or self._is_too_late_for(mesh, pair[-1]):
                break

    def _is_too_late_for(self, mesh: Mesh, last: Solution) -> bool:
        """Whether two solves take longer than there is time, at half of what a step of the last took."""
        taken = sum(phase.wall_time_s for phase in last.phases if phase.name != "compile")
        left = self.job.deadline - time.perf_counter()
        return left < 0.5 * taken * 3 * mesh.num_steps / last.num_steps

    def interrupt(self) -> None:
        """End with the last round."""
        self.failed = retold(self.rounds[-1].solution, status=Status.INTERRUPTED, advice="interrupted")

    def solution(self) -> Solution:
        """Return the last solution with what is known of it."""
        if not self.rounds and self.failed is not None:
            return self.failed
        last, asked = self.rounds[-1], accuracy_targets(self.job.problem)
        solution = with_accuracy(last.solved, last.solution, self.job.deadline)
        accuracy = replace(
            solution.accuracy, asked=asked, cost_error=last.cost_error, rounds=len(self.rounds)
        )
        solution = retold(solution, accuracy=accuracy, guess_used=self.rounds[0].guess_used)
        if last.is_enough:
            return solution
        status, why = Status.UNDER_RESOLVED, "there are no more rounds, steps or time"
        if self.failed is not None:
            why = f"with finer ones: {self.failed.advice}"
            status = self.failed.status if self.failed.status is Status.INTERRUPTED else status
        words = (
            f"horizon.accuracy = {asked:g} is not reached: with {solution.num_steps} steps one is wrong by "
            f"{last.errors.largest.max():.2g} at most, the cost by {last.cost_error:.2g} of it; {why}"
        )
        return retold(solution, status=status, advice=f"{words}; {solution.advice}")

    def _solve(self, mesh: Mesh, start: Warm) -> Solution:
        return self._run(self.job, self.job.problem, mesh, start)

    def _check(self, problem: Problem, mesh: Mesh, start: Warm) -> Solution:
        """Solve for the sake of the cost alone: it is not what a search that is stopped has found."""
        return self._run(replace(self.job, found=None), problem, mesh, start)

    def _run(self, job: Job, problem: Problem, mesh: Mesh, start: Warm) -> Solution:
        found = self.once.run(job.with_steps_of(mesh.of(problem), start))
        self.taken += found.iterations
        return found

    def _tell(self, last: Round) -> None:
        """Show a round among the iterations."""
        if self.job.callback is None:
            return
        words = (
            f"round {len(self.rounds)}: {last.solution.num_steps} steps, one is wrong by "
            f"{last.errors.largest.max():.2g} at most, the cost by {last.cost_error:.2g} of it"
        )
        residual, cost = last.solution.residual, last.solution.cost
        self.job.callback(IterationRecord(self.taken, residual, cost=cost, phase=words))

    def _pair(self, mesh: Mesh, start: Warm) -> list[Solution]:
        """Solve with steps and with their halves; the first alone if it fails."""
        pair = [self._solve(mesh, start)]
        if pair[0].is_stationary:
            pair.append(self._solve(mesh.halve(), pair[0]))
        return pair

    def _judge(self, mesh: Mesh, pair: list[Solution]) -> tuple[Mesh, Warm] | None:
        """Add a round; return the steps of the next one and where it begins, or None where it is the last."""
        problem, deadline = self.job.problem, self.job.deadline
        found = Round.of(problem, mesh.halve().of(problem), pair, deadline=deadline)
        checks = self._coarser(mesh, found.solution) if found.is_enough else []
        if is_told_by_joints(problem):
            last = found.beside_joints(checks)
        else:
            last = found.compare_with(checks, self.rounds[-1] if self.rounds else None)
        self.rounds.append(last)
        self._tell(last)
        if last.is_enough:
            self.rounds[-1] = trim(last, mesh, self._solve, deadline)
            return None
        if checks and checks[-1].status.is_stopped:
            self.failed = checks[-1]
            return None
        return last.next_mesh(mesh), found.solution

    def _widen(self, mesh: Mesh, pair: list[Solution]) -> tuple[Mesh, Warm] | None:
        """More steps from the guess, where the first do not lead to a motion; None: it is over."""
        self.failed = failed = pair[-1]
        if not (self.rounds or failed.status.is_stopped):
            return mesh.even(_MORE), None
        if pair[0].is_stationary and not self.rounds:
            words = f"optimal with {pair[0].num_steps} steps; finer ones, which tell how exact"
            self.failed = retold(pair[0], status=failed.status, advice=f"{words}: {failed.advice}")
        return None

    def _coarser(self, mesh: Mesh, fine: Solution) -> list[Solution]:
        """Solutions with fewer steps, or of the joints, by which orders are seen, fine to coarse."""
        found, problem = list[Solution](), self.job.problem
        if is_told_by_joints(problem):
            problem = with_joints(problem)
            return [self._check(problem, each, fine) for each in (mesh.halve(), mesh, mesh.coarser())]
        for _ in range(_CHECKS_ROUGH if is_rough(problem) else _CHECKS):
            mesh = mesh.coarser()
            found.append(self._check(problem, mesh, fine))
            if not found[-1].is_stationary:
                break
        return found


def trim(found: Round, mesh: Mesh, solve: Callable[[Mesh, Solution], Solution], deadline: float) -> Round:
    """Look for fewer steps that have what was asked for, too; return their round, or the one that is known.

    Parameters
    ----------
    found : Round
        With what was asked for.
    mesh : Mesh
        Its coarser steps.
    solve : callable
        Solves with other steps, from a solution.
    deadline : float
        Time of `time.perf_counter` after which no solve begins.
    """
    asked, best, worth = accuracy_targets(found.problem), found, _WORTH
    most, before = _most(found), None
    step, cost = _AIM_STEP * asked, _AIM_COST * most
    for _ in range(_TRIES):
        fewer = found.fewest(mesh, step, cost) if cost > 0.0 else mesh.halve()
        is_late = time.perf_counter() > deadline
        if is_late or fewer == before or fewer.num_steps > worth * len(best.solution.us):
            break
        solution = solve(fewer, best.solution)
        if not solution.is_stationary or (best.solution.converged and not solution.converged):
            break
        one, before = _judge(found, fewer, solution, deadline), fewer
        if one.is_enough:
            best, worth = one, _WORTH_MORE
        away, local = abs(solution.cost - found.limit.value), float(one.errors.largest.max())
        cost *= _correct(_AIM_COST * most, away)
        step *= _correct(_AIM_STEP * asked, local)
    return best


def _most(found: Round) -> float:
    """What a cost may be away from the limit at most, in its unit."""
    cost = found.solution.cost
    return math.inf if is_no_cost(cost) else accuracy_targets(found.problem) * abs(cost) - found.limit.unsure


def _judge(found: Round, mesh: Mesh, solution: Solution, deadline: float) -> Round:
    """A solution with other steps, its cost against what those of the round tend to."""
    solved = mesh.of(found.problem)
    return replace(
        found,
        solved=solved,
        solution=solution,
        errors=step_errors_of(solved, solution, deadline=deadline),
        error=found.limit.error_of(solution.cost),
        sure=1.0,
    )


def _correct(aim: float, came_to: float) -> float:
    """Factor for what is aimed at next, where the last aim came to something else."""
    ratio = aim / came_to if came_to > 0.0 else _MOST_CHANGE
    return float(np.clip(ratio, 1.0 / _MOST_CHANGE, _MOST_CHANGE))

"""How a job is done: the choice of a strategy, and those that know nothing of obstacles or accuracy.

Each strategy is frozen, has one method, `run(job)`, and holds those that it runs:

    BestInTime              the best solution by then, where functions are not compiled in time, or on Ctrl-C
      NearSpline            near the spline that tells most about the robot
      Refining              one number of steps after another, until the accuracy is reached
        RoomForTubes        again within tighter limits, until they leave room for what is uncertain
          WarmStart         from the warm start briefly, from the guess, from the warm start at length
            OtherWays       on one way around obstacles, or else on others
              RoomToBrake   again with larger reserves of braking joints, where they fall short between nodes
                WithinSteps with limits that hold within steps
                RoomForSpeeds  or among obstacles with lower limits of speeds, where these are left
                  ClearOfObstacles or OneSolve
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mbocp._arrays import dataclass, frozen_array
from mbocp.clearing import ClearOfObstacles, OtherWays, after, depth_of
from mbocp.exceptions import CompilationTimeout
from mbocp.guesses.in_turn import attempt
from mbocp.job import Job, Strategy
from mbocp.problem import Bounds, PathConstraint, Problem
from mbocp.problem.between_nodes import (
    GROSS_EXCESS,
    can_hold_within,
    is_followed,
    letter_of,
    limits_accelerations,
)
from mbocp.solution import Solution
from mbocp.solution.curves import Curves
from mbocp.solution.later import retold
from mbocp.solvers import Phase, Status
from mbocp.terms.kinds import Braking

_NEARLY_KEPT = 0.5  # excess of a limit within steps, as a part of it
_ROUNDS = 6  # of solving again with more reserve, ...
_MORE = 1.5  # ... by so much of what is missing: where steps cut another corner then, they cut less of it
_SPARE, _PARTS = 1e-4, 10  # [rad/s] that a reserve may fall short by between nodes; parts of a step
_FROM_START = 40  # iterations from a warm start, before other guesses: most take less than half of them
_LOWER = 0.25  # of a limit of speeds, by which it may be lower: steps that leave it by more resolve no motion
_WITHIN = 250  # iterations with limits within steps, before without: most take less than a fifth of them


def strategy_for(job: Job) -> Strategy:
    """Choose how a job is done."""
    problem = job.problem
    # Of several goals each has rows of its own, and what one motion comes near says nothing of the others.
    has_rows = problem.clearance is not None and not problem.goals
    once: Strategy = ClearOfObstacles() if has_rows else OneSolve()
    once = SolveWithinSteps(once) if can_hold_within(problem) and problem.robust is None else once
    once = RoomForSpeeds(once) if has_rows and _leaves_speeds(problem) else once
    once = RoomToBrake(once) if any(path.kind == Braking.kind for path in problem.frame_constraints) else once
    strategy: Strategy = WarmStart(once, OtherWays(once) if has_rows else once)
    if problem.robust is not None:
        from mbocp.robust import RoomForTubes

        strategy = RoomForTubes(strategy)
    if problem.accuracy is not None:
        from mbocp.accuracy.refining import Refinement

        strategy = Refinement(strategy)
    if problem.excite is not None:
        from mbocp.identification.exciting import NearSpline

        strategy = NearSpline(strategy)
    return BestInTime(strategy)


@dataclass(frozen=True)
class BestInTime:
    """Solve; where functions are not compiled before the deadline, or on Ctrl-C, return the best by then.

    It is no more than a motion where accuracy or room for what is uncertain is asked for, too.

    Attributes
    ----------
    strategy : Strategy
    """

    strategy: Strategy

    def run(self, job: Job) -> Solution:
        """Solve, and keep what has been found."""
        begun, found = time.perf_counter(), list[Solution]()
        try:
            return self.strategy.run(replace(job, found=found))
        except (CompilationTimeout, KeyboardInterrupt) as end:
            if not found:
                raise
            best = max(reversed(found), key=lambda one: (one.converged, one.is_stationary, -depth_of(one)))
            spent = time.perf_counter() - begun
            if isinstance(end, KeyboardInterrupt):
                advice = f"interrupted in another attempt; {best.advice}"
                return retold(best, status=Status.INTERRUPTED, advice=advice, wall_time_s=spent)
            words = f"{best.advice}; the time limit passed while {end.doing}, for another attempt"
            asked = {"horizon.accuracy": job.problem.accuracy, "[robust]": job.problem.robust}
            left = " and ".join(key for key, value in asked.items() if value is not None)
            status = Status.UNDER_RESOLVED if left and best.converged else best.status
            if left:
                words = f"what {left} asks for was not reached within solver.time_limit; raise it; {words}"
            return retold(best, status=status, advice=words, wall_time_s=spent)


@dataclass(frozen=True)
class OneSolve:
    """Formulate, guess, solve, read."""

    def run(self, job: Job) -> Solution:
        """Solve once."""
        return job.read(attempt(job))


@dataclass(frozen=True)
class SolveWithinSteps:
    """Solve so that speeds, accelerations and what falls with a speed keep their limits between nodes, too.

    Limits of accelerations and jerks hold there from the first, and others with them; path constraints, those
    of speeds and motors alone, or all where that comes to nothing, only if the motion leaves them by far.

    Attributes
    ----------
    once : Strategy
        For both.
    """

    once: Strategy

    def run(self, job: Job) -> Solution:
        """Solve up to six times; nothing else looks at jerks between nodes, so that these are tried again."""
        can = can_hold_within(job.problem).replace("p", "")
        if not limits_accelerations(job.problem) or job.rough:
            return self._solve_in_turn(job)
        within = "".join(sorted({*can, *_limits_held_by_start(job)}))
        solution = self.once.run(replace(job.with_limits_within(within), brief=job.brief or _WITHIN))
        asked = job.problem.solver.max_iterations
        is_spent = asked is not None and solution.iterations >= asked
        if solution.is_stationary or solution.status.is_stopped or job.is_late or is_spent:
            return self._add_in_turn(job, solution, within)
        found = after(solution, self._solve_in_turn(job.anew()), "limits within steps")
        if not found.is_stationary or job.is_late or "j" not in can:
            return found
        again = self.once.run(replace(job.with_limits_within(can), start=found, brief=job.brief or _WITHIN))
        if again.is_stationary:
            return after(found, again, "limits of jerk at nodes alone")
        words = f"{found.advice}; limits of jerk hold between the means of steps, and not within these"
        return retold(found, advice=words, wall_time_s=found.wall_time_s + again.wall_time_s)

    def _solve_in_turn(self, job: Job) -> Solution:
        """Up to four times; a motion that keeps its limits already begins with them."""
        within = _limits_held_by_start(job)
        return self._add_in_turn(job, self.once.run(job.with_limits_within(within)), within)

    def _add_in_turn(self, job: Job, solution: Solution, within: str) -> Solution:
        """Solve again with what a solution leaves, beside limits that hold within steps, by their letters."""
        can = can_hold_within(job.problem)
        while solution.status is Status.UNDER_RESOLVED and not (job.rough or job.is_late):
            letter = letter_of(solution.limit_excess_of)
            if letter not in set(can) - set(within):
                break
            within = "".join(sorted(within + letter))
            start = solution if solution.limit_excess < _NEARLY_KEPT else None  # else it leads nowhere soon
            again = WarmStart(self.once, self.once).run(replace(job.with_limits_within(within), start=start))
            is_better = again.converged or again.limit_excess < solution.limit_excess
            if not (again.is_stationary and is_better):
                return retold(solution, wall_time_s=solution.wall_time_s + again.wall_time_s)
            solution = after(solution, again, "limits at nodes alone")
        return solution


def _limits_held_by_start(job: Job) -> str:
    """Letters of the limits that hold within the steps of a warm start, and can again."""
    begun = job.start.iterate if isinstance(job.start, Solution) else None
    held = "" if begun is None else begun.limits_within
    return "".join(letter for letter in can_hold_within(job.problem) if letter in held)


@dataclass(frozen=True)
class RoomForSpeeds:
    """Solve; where a speed leaves its limit between nodes by far, again with so much lower a limit at nodes.

    Attributes
    ----------
    once : Strategy
        For each.
    """

    once: Strategy

    def run(self, job: Job) -> Solution:
        """Solve up to seven times."""
        solution, problem, lowered = self.once.run(job), job.problem, dict[str, float]()
        for _ in range(_ROUNDS):
            of = solution.limit_excess_of
            is_left = solution.status is Status.UNDER_RESOLVED and solution.limit_excess > GROSS_EXCESS
            if job.rough or job.is_late or not is_left or letter_of(of) != "v":
                break
            lowered[of] = lowered.get(of, 0.0) + _MORE * (solution.limit_excess - GROSS_EXCESS)
            if lowered[of] > _LOWER:
                break
            problem = _with_lower_speeds(job.problem, lowered)
            again = self.once.run(replace(job, problem=problem, start=solution))
            if not (again.is_stationary and again.limit_excess < solution.limit_excess):
                return retold(solution, wall_time_s=solution.wall_time_s + again.wall_time_s)
            solution = after(solution, again, "higher speeds at nodes")
            told = ", ".join(f"the {of} by {100.0 * share:.2g} %" for of, share in lowered.items())
            words = f"it is one within limits that were lowered at nodes, to hold nearly between them: {told}"
            solution = retold(solution, advice=f"{solution.advice}; {words}")
        return solution


def _leaves_speeds(problem: Problem) -> bool:
    """Whether speeds have limits that are known to be left between nodes, and cannot hold there."""
    has_limits = "v" in problem.widest_limits.letters and problem.robust is None
    return has_limits and is_followed(problem) and "v" not in can_hold_within(problem)


def _with_lower_speeds(problem: Problem, lowered: Mapping[str, float]) -> Problem:
    """The problem, and its phases, with limits of speeds lower by a part of the larger side of each."""
    names = [f"speed of {label.name}" for label in problem.robot.v_labels]
    shares = np.array([lowered.get(name, 0.0) for name in names])

    def lower(limits: Bounds) -> Bounds:
        if "v" not in limits.letters:
            return limits
        sides = limits.sides("v")
        size = np.max([np.where(np.isfinite(side), np.abs(side), 0.0) for side in sides], axis=0)
        low, high = sides[0] + shares * size, sides[1] - shares * size
        return replace(limits, v_lower=frozen_array(low), v_upper=frozen_array(high))

    phases = tuple(replace(phase, limits=lower(phase.limits)) for phase in problem.timeline.phases)
    return replace(problem, limits=lower(problem.limits), timeline=replace(problem.timeline, phases=phases))


@dataclass(frozen=True)
class RoomToBrake:
    """Solve; where a braking joint has less than its reserve between nodes, again with so much more at nodes.

    Where controls vary within steps it holds there from the first, see
    `mbocp.formulation.features.braking_within`. Where more reserve leads to no motion, the advice names the
    joints.

    Attributes
    ----------
    once : Strategy
        For each.
    """

    once: Strategy

    def run(self, job: Job) -> Solution:
        """Solve up to seven times."""
        solution, problem = self.once.run(job), job.problem
        for _ in range(_ROUNDS):
            if job.rough or job.is_late or not solution.is_stationary or not is_followed(problem):
                break
            wider = _with_reserves(problem, job.problem, solution)
            if wider is None:
                break
            again = WarmStart(self.once, self.once).run(replace(job, problem=wider, start=solution))
            if not again.is_stationary:
                short = f"between nodes a joint falls short of its reserve: {_short(wider, problem)}"
                words = f"{solution.advice}; {short}"
                spent = solution.wall_time_s + again.wall_time_s
                return retold(solution, advice=words, wall_time_s=spent)
            solution, problem = after(solution, again, "reserves at nodes"), wider
        return solution


def _with_reserves(problem: Problem, asked: Problem, solution: Solution) -> Problem | None:
    """The problem with more reserve where a motion has less than is asked for; None where it has enough."""
    model, path = problem.robot.model, list(problem.path)
    is_enough = True
    for k, (own, given) in enumerate(zip(problem.path, asked.path, strict=True)):
        if not (isinstance(own, PathConstraint) and isinstance(given, PathConstraint)):
            continue
        joint = model.joints[model.frames[own.frame].parentJoint]
        holds_always = bool(own.span.nodes(problem.num_steps, problem.dt).all())
        if own.kind != Braking.kind or joint.nq != 1 or not holds_always:
            continue
        curve = Curves(solution.t, solution.qs[:, [joint.idx_q]], solution.vs[:, [joint.idx_v]])
        q, v, *_ = curve.places(_PARTS)[1]
        missing = Braking.find_missing_reserve(given, q[:, 0], v[:, 0])
        if missing > _SPARE:
            is_enough = False
            reserve = own.number("reserve") + _MORE * missing
            path[k] = replace(own, further={**own.further, "reserve": reserve})
    return None if is_enough else replace(problem, path=tuple(path))


def _short(wider: Problem, problem: Problem) -> str:
    """Which path constraints ask for more reserve in one problem than in another, and by how much."""
    pairs = zip(wider.frame_constraints, problem.frame_constraints, strict=True)
    more = {
        one.name: float((one.number("reserve") - other.number("reserve"))[0]) / _MORE
        for one, other in pairs
        if one is not other
    }
    return ", ".join(f"{name} by {missing:.2g} rad/s" for name, missing in more.items())


@dataclass(frozen=True)
class WarmStart:
    """Solve from a warm start, and where that leads to no solution soon, from the problem's own guess.

    Attributes
    ----------
    from_start, from_guess : Strategy
        Without and with further ways where the first comes to nothing.
    """

    from_start: Strategy
    from_guess: Strategy

    def run(self, job: Job) -> Solution:
        """Solve, and say why nothing else was tried."""
        solution = self._run_in_turn(job)
        if solution.is_stationary or not job.patience.words:
            return solution
        status, proof = job.patience.status_of(solution.status), job.patience.proof
        is_proved = proof and status is Status.INFEASIBLE
        advice = proof if is_proved else f"{solution.advice}; {job.patience.words}"
        return retold(solution, status=status, advice=advice)

    def _run_in_turn(self, job: Job) -> Solution:
        """Solve from the warm start, briefly; from the guess; from the warm start, at length."""
        if job.start is None:
            return self.from_guess.run(job)
        if job.is_only or not _has_a_guess_left(job.problem):
            return self.from_start.run(job)
        solution = self.from_start.run(replace(job, brief=_FROM_START))
        if _is_final(solution, job):
            return solution
        again = self.from_guess.run(replace(job, start=None))
        if not _is_final(again, job):
            again = _add(again, self.from_start.run(job), "from the guess")
        return _add(solution, again, "from the warm start")


def _is_final(solution: Solution, job: Job) -> bool:
    """Whether nothing else is to be tried after a solution."""
    return solution.is_stationary or solution.status.is_stopped or job.patience.is_over


def _has_a_guess_left(problem: Problem) -> bool:
    """Whether a problem may be solved from its own guess, too, after a warm start."""
    solver = problem.solver
    return solver.num_starts == 1 and not problem.goals and solver.max_iterations is None


def _add(first: Solution, second: Solution, name: str) -> Solution:
    """The better of two solutions, with what both took and how the first ended."""
    is_first = not second.is_stationary and first.residual < second.residual
    better, other = (first, second) if is_first else (second, first)
    taken, spent = other.iterations, other.wall_time_s
    words = f"; {name}: {first.status} after {first.iterations} iterations"
    return retold(
        better,
        advice=better.advice + ("" if is_first else words),
        iterations=better.iterations + taken,
        phases=(Phase(name, taken, spent), *better.phases),
        history=(*first.history, *second.history),
        wall_time_s=better.wall_time_s + spent,
    )

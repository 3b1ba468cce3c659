"""A guess in natural coordinates: the optimum in joint coordinates."""

from __future__ import annotations

from dataclasses import replace

from mbocp.exceptions import ProblemError
from mbocp.formulation import Formulation, formulate
from mbocp.formulation.features.switches import filled_impulses
from mbocp.guesses.kinds import guess_candidates, none_made, plain_guess
from mbocp.job import settings_of
from mbocp.problem import Guess
from mbocp.programme import Iterate
from mbocp.solvers import SolverResult, Start, Status, run_strategy


def from_joints(formulation: Formulation) -> tuple[Iterate, str]:
    """Optimum in joint coordinates, in natural ones; or what comes nearest to it."""
    problem = formulation.problem
    best: SolverResult | None = None
    joint = problem.with_(coordinates="joint", guess=Guess(), solver=replace(problem.solver, method="auto"))
    stepwise = formulate(joint)
    failed: dict[str, ProblemError] = {}
    taken = 0
    for kind in guess_candidates(joint):
        try:
            guess, _ = plain_guess(kind, stepwise)
        except ProblemError as error:
            failed[kind] = error
            continue
        start = Start(stepwise.programme, guess)
        result = run_strategy(settings_of(stepwise), start).result
        if result.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        taken += sum(not record.is_guess for record in result.history)
        if best is None or result.record.residual < best.record.residual:
            best = result
        if result.status is Status.CONVERGED:
            break
    if best is None:
        raise none_made(failed)
    motion = stepwise.motion_of(best.iterate)
    lams = best.iterate.ys / filled_impulses(formulation.problem, motion.dts)
    iterate = formulation.iterate_of(motion, lams)
    what = "optimum" if best.status is Status.CONVERGED else f"best iterate ({best.status})"
    return iterate, f"{what} in joint coordinates after {taken} iterations, mapped to bodies"

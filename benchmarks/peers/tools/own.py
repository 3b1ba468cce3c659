"""mbocp: what `mbocp.solve` does from the guess of the file, without the look-up of functions and reports."""

from __future__ import annotations

from pathlib import Path

import mbocp
from benchmarks.peers.task import Task
from benchmarks.peers.tools.runs import NotSolved, Run, timed
from mbocp.formulation import formulate
from mbocp.guesses import make_guess
from mbocp.solvers import SolverSettings, Start, run_strategy

_PROBLEMS = Path(__file__).parent.parent / "problems"


def run(task: Task, method: str, repeats: int) -> Run:
    """Solve the problem of the task's name with a method of `solver.method`."""
    problem = mbocp.load_problem(_PROBLEMS / f"{task.name}.toml", [f"solver.method={method}"])
    formulation = formulate(problem)
    guess, _ = make_guess("hold", formulation)
    settings = SolverSettings.of(problem.solver, formulation.programme, has_inequalities=problem.is_bounded)
    outcome, seconds = timed(lambda: run_strategy(settings, Start(formulation.programme, guess)), repeats)
    if outcome.result.status != "converged":
        raise NotSolved(str(outcome.result.status))
    motion = formulation.motion_of(outcome.result.iterate)
    iterations = sum(not record.is_guess for record in outcome.result.history)
    return Run(motion.qs, motion.vs, motion.us, iterations, seconds)

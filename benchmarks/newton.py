"""Time of one exact Newton iteration: factorise, solve, a trial of the line search, evaluate."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

import numpy as np

import mbocp
from benchmarks.tables import Table
from mbocp.formulation import formulate
from mbocp.guesses import guess_candidates, make_guess
from mbocp.programme import StagewiseProgramme
from mbocp.solvers import GlobalisedNewton, Iterate, SolverResult, run

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelNewtonState

__all__ = [
    "CASES",
    "SE1",
    "Case",
    "StepTime",
    "Stepper",
    "exponent",
    "in_rounds",
    "iteration_table",
    "load",
    "median_time",
    "newton",
    "scaling_table",
    "warm_guess",
]

EXAMPLES = Path(__file__).parent.parent / "examples"
_ROUNDS = 3
_KEPT = 20  # iterates before the end, among which one with a full step is looked for


@dataclass(frozen=True)
class Case:
    """A problem file with changes."""

    label: str
    file: str
    settings: tuple[str, ...] = ()


SE1 = (
    "integrator.scheme=se1",
    "horizon.steps=100",
)  # as in the tables of docs/performance.md
CASES = (
    Case("ur5_reach", "arms/ur5_reach.toml", SE1),
    Case("panda_reach", "arms/panda_reach.toml", SE1),
    Case("kinova_reach", "arms/kinova_reach.toml", SE1),
    Case("drone_flip", "free_flyer/drone_flip.toml", SE1),
    Case("elastic_pendulum", "paper/elastic_pendulum.toml"),
    Case("rigid_pendulum", "paper/rigid_pendulum.toml"),
)


@dataclass(frozen=True)
class StepTime:
    """Medians, in seconds."""

    num_steps: int
    unknowns: int
    step: float  # a whole iteration
    evaluate: float
    factorise: float
    solve: float
    trial: float
    iterations: int  # of the whole solve from the default guess
    whole: float  # of that solve


def load(case: Case, *more: str) -> mbocp.Problem:
    """Problem of a case."""
    return mbocp.load_problem(EXAMPLES / case.file, [*case.settings, *more])


def warm_guess(problem: mbocp.Problem) -> tuple[StagewiseProgramme, Iterate]:
    """Compiled programme and the default initial guess."""
    formulation = formulate(problem)
    iterate, _ = make_guess(guess_candidates(problem)[0], formulation)
    return formulation.programme, iterate


def newton(problem: mbocp.Problem, programme: StagewiseProgramme) -> GlobalisedNewton:
    """Return the default solver of a problem."""
    options = problem.solver
    return GlobalisedNewton(options.tolerance, options.newton_iterations, programme.control_weight)


class Stepper:
    """A problem at an iterate from which a full, unshifted Newton step is taken, ready to be timed."""

    def __init__(self, problem: mbocp.Problem) -> None:
        self.problem = problem
        self.programme, self.guess = warm_guess(problem)
        self.solver = newton(problem, self.programme)
        self.state, self.iterate = _before_a_full_step(self.solver, self.programme, self.guess)
        self.iterations = self._solve().history[-1].iteration

    def measure(self, repetitions: int) -> StepTime:
        """Medians over `repetitions` of an iteration and of each of its parts."""
        native, rho = self.state.native, self.state.augmentation

        def ready() -> None:
            self._reset()
            native.factorise(0.0, rho)

        def directed() -> None:
            ready()
            native.solve()

        return StepTime(
            num_steps=self.problem.num_steps,
            unknowns=self.programme.num_unknowns,
            step=median_time(lambda: self.solver.step(self.state), self._reset, repetitions),
            evaluate=median_time(native.evaluate, self._reset, repetitions),
            factorise=median_time(lambda: native.factorise(0.0, rho), self._reset, repetitions),
            solve=median_time(native.solve, ready, repetitions),
            trial=median_time(lambda: native.trial(1.0), directed, repetitions),
            iterations=self.iterations,
            whole=median_time(self._solve, lambda: None, max(1, repetitions // 20)),
        )

    def _reset(self) -> None:
        self.iterate.load_into(self.state.native)
        self.state.native.evaluate()

    def _solve(self) -> SolverResult:
        return run(self.solver, self.programme, self.guess)


def in_rounds(
    steppers: Sequence[Stepper], repetitions: Sequence[int], rounds: int = _ROUNDS
) -> list[StepTime]:
    """Measure all in turn, several times over, and keep each least median: others use the machine, too."""
    measured = [
        [stepper.measure(max(1, n // rounds)) for stepper, n in zip(steppers, repetitions, strict=True)]
        for _ in range(rounds)
    ]
    return [_least(times) for times in zip(*measured, strict=True)]


def _least(times: Sequence[StepTime]) -> StepTime:
    return StepTime(*(min(getattr(t, field.name) for t in times) for field in fields(StepTime)))


def _before_a_full_step(
    solver: GlobalisedNewton, programme: StagewiseProgramme, guess: Iterate
) -> tuple[KernelNewtonState, Iterate]:
    """State and iterate, as late in the solve as possible, whose next step is one plain Newton step."""
    state = solver.init(programme, guess)
    visited: deque[tuple[KernelNewtonState, Iterate, KernelNewtonState]] = deque(maxlen=_KEPT)
    while solver.terminate(state) is None:
        iterate, before = Iterate.read_from(state.native, programme), state
        state = solver.step(state)
        visited.append((before, iterate, state))
    for before, iterate, after in reversed(visited):
        is_plain = after.step_length == 1.0 and after.regularisation == 0.0 and not before.is_relaxed
        is_progress = before.evaluation.residual > solver.tolerance  # else round-off decides about the step
        if is_plain and is_progress and after.augmentation == before.augmentation:
            return before, iterate
    raise RuntimeError("no plain Newton step among the last ones of this solve: nothing to measure")


def median_time(work: Callable[[], object], prepare: Callable[[], object], repetitions: int) -> float:
    seconds = []
    for _ in range(repetitions):
        prepare()
        clock = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - clock)
    return median(seconds)


def iteration_table(cases: Sequence[Case] = CASES, repetitions: int = 200) -> Table:
    """One row a case."""
    measured = in_rounds([Stepper(load(case)) for case in cases], [repetitions] * len(cases))
    rows = []
    for case, t in zip(cases, measured, strict=True):
        parts = (t.evaluate, t.factorise, t.solve, t.trial)
        whole = (str(t.iterations), _ms(t.whole), _ms(t.whole / t.iterations))
        rows.append((case.label, str(t.num_steps), str(t.unknowns), _ms(t.step), *map(_ms, parts), *whole))
    columns = ("problem", "N", "unknowns", "Newton iteration", "evaluate", "factorise", "solve", "trial")
    return Table(
        "One exact Newton iteration, and a whole solve from the default guess [ms]",
        (*columns, "iterations", "whole solve", "per iteration"),
        rows,
        f"Medians of {repetitions // _ROUNDS} iterations, the least of {_ROUNDS} rounds through the table. "
        "An iteration is factorise, solve (refinement included), one trial of the line search, and evaluate: "
        "all first and second derivatives. Iterations of a solve may factorise or try several times.",
    )


def scaling_table(case: Case, steps: Sequence[int], budget: int = 20_000) -> tuple[Table, float]:
    """Time of an iteration over the number of steps, and the fitted exponent."""
    steppers = [Stepper(load(case, f"horizon.steps={n}")) for n in steps]
    measured = in_rounds(steppers, [max(9, min(200, budget // n)) for n in steps])
    rows = []
    for t in measured:
        numbers = (_ms(t.step), f"{1e6 * t.step / t.num_steps:.2f}", str(t.iterations), _ms(t.whole))
        rows.append((str(t.num_steps), str(t.unknowns), *numbers))
    fitted = exponent(steps, [t.step for t in measured])
    columns = ("N", "unknowns", "Newton iteration [ms]", "per step [us]", "iterations", "whole solve [ms]")
    note = f"Time of an iteration ~ N^{fitted:.3f} (least squares on the logarithms)."
    return Table(f"Growth with the number of steps: {case.label}", columns, rows, note), fitted


def exponent(steps: Sequence[int], seconds: Sequence[float]) -> float:
    """Slope of log(seconds) over log(steps)."""
    return float(np.polyfit(np.log(steps), np.log(seconds), 1)[0])


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}" if seconds < 1.0 else f"{1e3 * seconds:.0f}"

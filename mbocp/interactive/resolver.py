"""A thread that solves a problem again for what is asked last, each time from the solution before."""

from __future__ import annotations

import threading
import time
import warnings
from collections.abc import Callable

import numpy as np

from mbocp._arrays import dataclass
from mbocp.exceptions import MbocpError
from mbocp.interactive.wish import Wish, change_problem
from mbocp.problem import Problem
from mbocp.solution import Solution
from mbocp.solving import solve


@dataclass(frozen=True, eq=False)
class Answer:
    """What became of a wish.

    Attributes
    ----------
    wish : Wish
    problem : Problem, optional
        What was solved; None where it cannot be asked for.
    solution : Solution, optional
    seconds : float
        Time that it took, the making of the problem included [s].
    words : str
        Why there is no solution, or what is odd about the problem.
    """

    wish: Wish
    problem: Problem | None
    solution: Solution | None
    seconds: float
    words: str = ""

    @property
    def is_good(self) -> bool:
        """Whether there is a solution that converged."""
        return self.solution is not None and self.solution.converged

    @property
    def state(self) -> str:
        """How it went, in a line."""
        took = f"{1e3 * self.seconds:.0f} ms" if self.seconds < 1.0 else f"{self.seconds:.1f} s"
        if self.solution is None:
            return f"not solved ({took})"
        count = self.solution.iterations
        steps = f"{count} iteration{'' if count == 1 else 's'}"
        if self.is_good:
            return f"converged in {took}, {steps}, cost {self.solution.cost:.5g}"
        return f"not converged: {self.solution.status}, {took}, {steps}"


class Resolver:
    """Solves for the last of the wishes that came in while it was busy.

    Parameters
    ----------
    problem : Problem
        What wishes change.
    solution : Solution
        Its solution: from where the first wish is solved.
    on_answer : callable
        Called in the thread, with each `Answer`.
    rate : float
        Solves a second, at most [1/s].
    time_limit : float
        Longest time of a solve [s].
    """

    def __init__(
        self,
        problem: Problem,
        solution: Solution,
        on_answer: Callable[[Answer], None],
        *,
        rate: float = 20.0,
        time_limit: float = 2.0,
    ) -> None:
        self._problem, self._good = problem, solution
        self._time_limit = time_limit
        self._on_answer, self._period = on_answer, 1.0 / rate
        self._changed = threading.Condition()
        self._wish: Wish | None = None
        self._is_busy = self._is_closed = False
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="mbocp live", daemon=True)
        self._thread.start()

    def ask(self, wish: Wish) -> None:
        """Solve for a wish as soon as possible, in the place of one that has not begun."""
        with self._changed:
            self._wish = wish
            self._changed.notify_all()

    def wait_until_idle(self, timeout: float | None = None) -> bool:
        """Block until all is answered; False if that takes longer than the timeout [s]."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._is_busy and self._wish is None, timeout)

    def close(self) -> None:
        """End the thread, after the solve that it is at."""
        with self._changed:
            self._is_closed = True
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        try:
            while (wish := self._next()) is not None:
                begun = time.perf_counter()
                self._on_answer(self._answer(wish))
                with self._changed:
                    self._is_busy = False
                    self._changed.notify_all()
                    left = self._period - (time.perf_counter() - begun)
                    self._changed.wait_for(lambda: self._is_closed, max(left, 0.0))
        except BaseException as error:
            self.error = error  # told where somebody waits for the page
            with self._changed:
                self._is_busy, self._wish, self._is_closed = False, None, True
                self._changed.notify_all()

    def _next(self) -> Wish | None:
        """The last wish, once there is one; None at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._wish is not None or self._is_closed)
            wish, self._wish = self._wish, None
            self._is_busy = wish is not None
            return None if self._is_closed else wish

    def _answer(self, wish: Wish) -> Answer:
        begun = time.perf_counter()
        problem, solution, words = None, None, []
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                problem = change_problem(self._problem, wish, np.array(self._good.qs[-1]))
                solution = solve(problem, warm_start=self._good, time_limit=self._time_limit)
            except MbocpError as error:
                words.append(str(error))
        if solution is not None and solution.converged:
            self._good = solution
        elif solution is not None:
            words.append(solution.advice)
        words += [str(warning.message) for warning in caught]
        return Answer(wish, problem, solution, time.perf_counter() - begun, "; ".join(filter(None, words)))

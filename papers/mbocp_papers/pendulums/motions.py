"""Solved motions as the paper's figures show them: scaled adjoints, all three components of xi."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbocp._arrays import Array
from mbocp.exceptions import MbocpError, NotConverged
from mbocp.problem import Problem
from mbocp.solution import Solution
from mbocp_papers.pendulums.cases import Form, paper_problem, strategy_settings
from mbocp_papers.pendulums.data import STRATEGIES
from mbocp_papers.pendulums.measure import solved

Say = Callable[[str], object]  # told what is being solved

_CONTINUATION = (9.81, 4.0, 0.0)  # [m/s^2]: gravity, down to free space


@dataclass(frozen=True)
class Motion:
    r"""A solution in the quantities of the figures.

    Attributes
    ----------
    problem : Problem
    solution : Solution
    scale : float
        alpha: adjoints and control Hamiltonian are divided by it, so that the forms compare (Remark 2).
    """

    problem: Problem
    solution: Solution
    scale: float

    @classmethod
    def of(cls, problem: Problem, solution: Solution) -> Motion:
        """Take alpha from the problem's cost."""
        return cls(problem, solution, float(problem.cost.effort[0]))

    @property
    def t(self) -> Array:
        """Time of the nodes [s], shape (N + 1,)."""
        return self.solution.t

    @property
    def mu_q(self) -> Array:
        """Adjoint of the position over alpha, shape (N + 1, nv)."""
        return np.asarray(self.solution.mus[:, : self.solution.nv] / self.scale)

    @property
    def mu_p(self) -> Array:
        """Adjoint of the momentum over alpha, shape (N + 1, nv)."""
        return np.asarray(self.solution.mus[:, self.solution.nv :] / self.scale)

    @property
    def hamiltonian(self) -> Array:
        """Control Hamiltonian over alpha, eq. (11), shape (N,)."""
        return np.asarray(self.solution.control_hamiltonians / self.scale)

    @property
    def violation(self) -> Array:
        """Holonomic constraints at the nodes [m^2], shape (N + 1, nc)."""
        return np.array([self.problem.robot.constraint_residual(q) for q in self.solution.qs])

    @property
    def xi(self) -> Array:
        """Control angular momentum of a particle in space over alpha, eq. (15), shape (N + 1, 3)."""
        s = self.solution
        return np.asarray(np.cross(s.qs, self.mu_q) + np.cross(s.ps, self.mu_p))


@dataclass(frozen=True)
class Pair:
    """The same problem by both Newton methods; `fbsm` is None where it does not find the same optimum."""

    monolithic: Motion
    fbsm: Motion | None
    remark: str = ""


def motion_pair(system: str, form: Form, say: Say = str) -> Pair:
    """Solve a system at dt = 0.01 s by both Newton methods, each with its default globalisation."""
    say(f"{system}, {form}: monolithic")
    problem = paper_problem(system, form, settings=strategy_settings(STRATEGIES[0]))
    monolithic = Motion.of(problem, _optimum(problem))
    say(f"{system}, {form}: FBSM-Newton")
    return _with_fbsm(monolithic, _optimum, system, form, {})


def penalty_or_lagrange(system: str, form: Form, say: Say = str) -> Motion:
    """Solve a system at dt = 0.01 s by the monolithic solver."""
    say(f"{system}, {form}: monolithic")
    problem = paper_problem(system, form, settings=strategy_settings(STRATEGIES[0]))
    return Motion.of(problem, _optimum(problem))


def free_space(say: Say = str) -> Pair:
    """Solve the rigid pendulum without gravity, from the paper's start to its goal.

    From the paper's constant control the motion without gravity stays on the equator, where the end condition
    is singular. The optimum with gravity is followed down to a = 0 instead.
    """
    say("rigid pendulum in free space: continuation in gravity")
    problems = [
        paper_problem(
            "rigid_pendulum",
            "lagrange",
            settings={"robot.gravity": [0.0, 0.0, -gravity], **strategy_settings(STRATEGIES[0])},
        )
        for gravity in _CONTINUATION
    ]
    start: Solution | None = None
    for problem in problems[:-1]:
        start = _optimum(problem, start)
    return _with_fbsm(
        Motion.of(problems[-1], _optimum(problems[-1], start)),
        lambda p: _optimum(p, start),
        "rigid_pendulum",
        "lagrange",
        {"robot.gravity": [0.0, 0.0, 0.0]},
    )


def _optimum(problem: Problem, warm_start: Solution | None = None) -> Solution:
    """Solve, and refuse anything but a converged solution."""
    solution = solved(problem, warm_start=warm_start)
    if not solution.converged:
        raise NotConverged(solution)
    return solution


def _with_fbsm(
    monolithic: Motion,
    optimum: Callable[[Problem], Solution],
    system: str,
    form: Form,
    settings: Mapping[str, Any],
) -> Pair:
    """Add the motion of FBSM-Newton, or the reason why there is none."""
    try:
        problem = paper_problem(system, form, settings={**settings, **strategy_settings(STRATEGIES[1])})
        solution = optimum(problem)
    except MbocpError as error:
        return Pair(monolithic, None, f"FBSM-Newton: {str(error).partition(';')[0]}")
    apart = float(np.abs(solution.us - monolithic.solution.us).max())
    if apart > 1e-5:
        words = f"FBSM-Newton finds another optimum, J = {solution.cost:.6g}"
        return Pair(monolithic, None, f"{words} (monolithic: {monolithic.solution.cost:.6g})")
    return Pair(monolithic, Motion.of(problem, solution))

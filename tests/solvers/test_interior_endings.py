"""How IPOPT and fatrop end where they do not converge: by a status with advice, at once, finite."""

from __future__ import annotations

import json
import math
import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from typer.testing import CliRunner

import mbocp
from mbocp.cli.app import app
from mbocp.cli.progress_table import ProgressCallback
from mbocp.problem import Problem
from mbocp.solution import IterationRecord, Solution, Status
from mbocp.solvers.nlp.iteration_log import IterationLog
from mbocp.solvers.nlp.nlp_functions import calm_or_none
from mbocp.solvers.nlp.nlp_layout import NlpLayout

FILE = Path(__file__).parents[2] / "examples" / "paper" / "elastic_pendulum.toml"
SETTINGS = ("horizon.steps=20", "limits={effort=5.3}")  # without limits up to 5.8 N
METHODS = pytest.mark.parametrize("method", ["ipopt", "fatrop"])


def load(*settings: str) -> Problem:
    return mbocp.load_problem(FILE, (*SETTINGS, *settings))


def check_honest(s: Solution) -> None:
    for name in ("qs", "vs", "us", "mus", "lams", "eta", "control_momenta", "lam_us", "lam_vs", "lam_qs"):
        assert np.isfinite(getattr(s, name)).all(), name
    assert math.isfinite(s.residual)
    assert math.isfinite(s.cost)
    assert all(math.isfinite(r.cost) and math.isfinite(r.residual) for r in s.history)
    json.loads(s.to_json(), parse_constant=lambda name: pytest.fail(name))


def at_iteration(number: int, action: Callable[[], None]) -> Callable[[IterationRecord], None]:
    def callback(record: IterationRecord) -> None:
        if record.iteration == number:
            action()

    return callback


def press() -> None:
    raise KeyboardInterrupt


# --- iterations -------------------------------------------------------------------------------------------


@METHODS
def test_every_iteration_is_told(method: str) -> None:
    seen: list[IterationRecord] = []
    s = mbocp.solve(load(), solver=method, callback=seen.append)
    assert s.converged
    assert seen == list(s.history)
    assert [r.iteration for r in seen] == list(range(s.iterations + 1))
    assert [r.is_guess for r in seen] == [True] + [False] * s.iterations
    assert {r.phase for r in seen} == {method}
    assert all(0.0 < r.step_length <= 1.0 and r.increment >= 0.0 for r in seen[1:])
    assert seen[-1].cost == pytest.approx(s.cost, rel=1e-7)
    assert all(r.residual == max(r.primal, r.dual) for r in seen)
    assert [p.iterations for p in s.phases if p.name == method] == [s.iterations]
    check_honest(s)


TABLE = """
This is Ipopt version 3.14.11, running with linear solver MUMPS 5.4.1.
iter    objective    inf_pr   inf_du lg(mu)  ||d||  lg(rg) alpha_du alpha_pr  ls
   0  7.5000000e-06 1.06e+01 9.00e-01  -1.0 0.00e+00    -  0.00e+00 0.00e+00   0
   1 -2.0544298e+01 7.11e+00 6.99e-01  -1.0 1.13e+01  -4.0 6.46e-01 3.29e-01f  1
   2r 3.5372521e+01 4.96e+00 9.99e+02   0.9 0.00e+00    -  0.00e+00 1.91e-10R  6
   2r 3.5372521e+01 4.96e+00 9.99e+02   0.9 0.00e+00    -  0.00e+00 1.91e-10R  6
   3  5.5198017e+01 1.90e+00 nan  -1.0 7.93e+00    -  8.13e-01 6.29e-01f  1
EXIT: Optimal Solution Found.
"""


def test_the_table_is_read_in_pieces_of_any_size() -> None:
    for size in (1, 7, 1000):
        seen: list[IterationRecord] = []
        log = IterationLog("ipopt", 10, seen.append)
        for start in range(0, len(TABLE), size):
            log.write(TABLE[start : start + size])
        assert [r.iteration for r in seen] == [10, 11, 12, 13]
        assert [r.phase for r in seen] == ["ipopt", "ipopt", "ipopt (restoration)", "ipopt"]
        assert seen[1].cost == -20.544298
        assert seen[1].regularisation == 1e-4
        assert (seen[1].step_length, seen[1].increment) == (0.329, 11.3)
        assert seen[0].is_guess
        assert math.isnan(seen[3].dual)


# --- limits of iterations and time ------------------------------------------------------------------------


@METHODS
@pytest.mark.parametrize("limit", [1, 2, 5])
def test_max_iterations(method: str, limit: int) -> None:
    s = mbocp.solve(load(f"solver.max_iterations={limit}"), solver=method)
    assert s.status is Status.MAX_ITERATIONS
    assert s.iterations == (limit if method == "ipopt" or limit > 1 else 0)
    assert f"not converged in {s.iterations} iteration" in s.advice
    assert "raise solver.max_iterations" in s.advice
    assert "largest violation: " in s.advice
    check_honest(s)


@METHODS
def test_time_limit(method: str, capfd: pytest.CaptureFixture[str]) -> None:
    clock = time.perf_counter()
    slow = at_iteration(3, lambda: time.sleep(0.7))
    s = mbocp.solve(load("solver.time_limit=0.6"), solver=method, callback=slow)
    assert s.status is Status.TIME_LIMIT
    assert "not converged within solver.time_limit, after 3 iterations" in s.advice
    assert s.iterations == 3
    check_honest(s)
    at_once = mbocp.solve(load("solver.time_limit=1e-9"), solver=method)
    assert at_once.status is Status.TIME_LIMIT
    assert at_once.iterations == 0
    assert np.abs(at_once.us).max() <= 5.3 + 1e-9
    assert time.perf_counter() - clock < 20.0
    assert capfd.readouterr() == ("", "")  # no traces of how it was ended
    assert mbocp.solve(load("solver.time_limit=100"), solver=method).converged


# --- infeasible -------------------------------------------------------------------------------------------


@METHODS
def test_a_goal_out_of_reach_within_the_limits(method: str) -> None:
    s = mbocp.solve(load("limits={effort=1.0}"), solver=method)
    assert s.status in ({Status.INFEASIBLE} if method == "ipopt" else {Status.LINE_SEARCH_FAILED})
    assert "longer duration" in s.advice
    assert "largest violation: kinematics of" in s.advice
    assert s.residual > 1.0
    assert s.limit_violation < 1e-8  # limits are kept, the motion is not
    assert [r.iteration for r in s.history] == list(range(s.iterations + 1))
    check_honest(s)


@METHODS
def test_a_path_that_leads_nowhere(method: str) -> None:
    """The bob may not leave the ball that it starts in, and its goal is hardly inside."""
    path = '{name="ball", kind="distance", frame="bob", point=[-2, -5, -5], max=6.5}'
    s = mbocp.solve(load("limits={effort=1.0}", f"path=[{path}]"), solver=method)
    assert not s.converged
    assert "largest violation: " in s.advice
    check_honest(s)


def test_a_solver_that_stalls_near_a_solution_says_so() -> None:
    """Fast frames make fatrop regularise to the end: 1e-9 is too much to ask for there."""
    path = 'path=[{kind="speed", frame="bob", max=7}]'
    s = mbocp.solve(load("limits={}", path), solver="fatrop")
    assert s.status is Status.LINE_SEARCH_FAILED
    assert s.advice.startswith("near a solution, but no step makes progress any more after")
    assert "raise solver.tolerance" in s.advice
    assert s.residual < 1e-6
    looser = mbocp.solve(load("limits={}", path, "solver.tolerance=1e-7"), solver="fatrop")
    assert looser.converged
    exact = mbocp.solve(load("limits={}", path), solver="ipopt")
    assert exact.converged
    assert looser.cost == pytest.approx(exact.cost, rel=1e-7)


def test_the_command_line_exits_with_1(tmp_path: Path) -> None:
    saved = tmp_path / "far.h5"
    arguments = ["solve", str(FILE), "--set", "horizon.steps=20", "--set", "limits={effort=1.0}"]
    done = CliRunner(env={"COLUMNS": "80", "TERM": "dumb"}).invoke(
        app, [*arguments, "--solver", "ipopt", "-o", str(saved)]
    )
    assert done.exit_code == 1
    assert "infeasible: no motion meets all constraints" in " ".join(done.stdout.split())
    assert Solution.load(saved).status is Status.INFEASIBLE


# --- Ctrl-C, and what callbacks raise ---------------------------------------------------------------------


@METHODS
@pytest.mark.parametrize("count", [0, 1, 6])
def test_ctrl_c_returns_the_last_iterate(method: str, count: int, capfd: pytest.CaptureFixture[str]) -> None:
    """A signal, as from the keyboard; and KeyboardInterrupt, as another handler of the signal raises it."""
    for action in (lambda: os.kill(os.getpid(), signal.SIGINT), press):
        before = signal.getsignal(signal.SIGINT)
        s = mbocp.solve(load(), solver=method, callback=at_iteration(count, action))
        assert signal.getsignal(signal.SIGINT) is before
        assert s.status is Status.INTERRUPTED
        assert s.advice.startswith(f"interrupted after {count} iteration")
        assert s.iterations == count
        assert s.cost == pytest.approx(s.history[-1].cost, rel=1e-6)
        check_honest(s)
    assert capfd.readouterr() == ("", "")


@METHODS
def test_ctrl_c_on_the_command_line(method: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    stop = at_iteration(2, press)
    monkeypatch.setattr(ProgressCallback, "__call__", lambda _, record: stop(record))
    saved = tmp_path / "swing.h5"
    settings = [part for setting in SETTINGS for part in ("--set", setting)]
    done = CliRunner(env={"COLUMNS": "80", "TERM": "dumb"}).invoke(
        app, ["solve", str(FILE), *settings, "--solver", method, "-o", str(saved)]
    )
    assert done.exit_code == 130
    assert "interrupted: interrupted after 2 iterations; the last iterate" in " ".join(done.stdout.split())
    assert Solution.load(saved).status is Status.INTERRUPTED


class MyError(Exception):
    pass


@METHODS
def test_what_a_callback_raises_comes_out_at_once(method: str) -> None:
    seen: list[int] = []

    def callback(record: IterationRecord) -> None:
        seen.append(record.iteration)
        if record.iteration == 2:
            raise MyError("mine")

    with pytest.raises(MyError, match="mine"):
        mbocp.solve(load(), solver=method, callback=callback)
    assert seen == [0, 1, 2]
    assert mbocp.solve(load(), solver=method).converged  # the solver object is as good as new


@METHODS
def test_other_threads_solve_and_stop_too(method: str) -> None:
    """Only the main thread may set handlers of signals."""
    found: list[Solution] = []

    def run() -> None:
        found.append(mbocp.solve(load(), solver=method))
        found.append(mbocp.solve(load(), solver=method, callback=at_iteration(1, press)))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert [s.status for s in found] == [Status.CONVERGED, Status.INTERRUPTED]


def test_an_iterate_beyond_all_squares_is_told_without_an_overflow() -> None:
    """Explicit steps of a minute; warnings are errors."""
    problem = Problem.create(
        "double_pendulum",
        1000.0,
        6,
        goal={"q": [1.0, 0.5], "v": 0},
        cost={"velocity": 0.1},
        integrator={"scheme": "rk4", "substeps": 2},
        solver={"method": "ipopt", "max_iterations": 8},
    )
    solution = mbocp.solve(problem)
    assert not solution.converged
    check_honest(solution)


@pytest.mark.parametrize(("duration", "steps"), [(1.0, 6), (1.0, 14), (3.0, 20), (1000.0, 6)])
def test_explicit_steps_that_are_far_too_long_do_not_hold_fatrop_for_ever(
    duration: float, steps: int
) -> None:
    """Its loop over ever larger shifts asks no function, looks at no clock and hears no Ctrl-C."""
    goal = {"q": [1.0, 0.5], "v": 0}
    problem = Problem.create(
        "double_pendulum", duration, steps, goal=goal, scheme="rk4", solver={"method": "fatrop"}
    )
    solution = mbocp.solve(problem)
    assert solution.status is Status.DIVERGED
    assert "take more steps" in solution.advice
    check_honest(solution)


def test_the_growth_of_a_step_does_not_depend_on_units() -> None:
    draw = np.random.default_rng(0)
    N, nx = 3, 4
    layout = NlpLayout(N, nx, 2, 0, 0, 0, 0, rows_are_gaps=True, is_lifted=False)
    for size, is_calm in ((10.0, True), (1e4, False)):
        units = 10.0 ** draw.uniform(-6, 6, nx)
        turn = np.linalg.qr(draw.standard_normal((nx, nx)))[0]
        jacobian = np.zeros((layout.num_rows, layout.num_unknowns))
        for step, values in enumerate(([1, 1, 1, 1], [1, -1, 1, -1], [size, -size, 1, 1])):
            block = turn @ np.diag(np.array(values, dtype=float)) @ turn.T
            jacobian[np.ix_(layout.steps[step], layout.xs[step])] = -block * np.divide.outer(units, units)
        symbol = ca.MX.sym("J", ca.DM(jacobian).sparsity())
        watched = ca.Function("f", [symbol], [calm_or_none(symbol, layout)])(ca.DM(jacobian))
        assert np.isfinite(np.array(watched)[jacobian != 0.0]).all() == is_calm

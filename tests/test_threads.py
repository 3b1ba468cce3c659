"""Threads change no bit of a result, and an interrupt or an error in one of them is told."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import mbocp
from mbocp._threads import SideBySide, Watch
from mbocp.exceptions import ProblemFileError
from mbocp.formulation import formulate
from mbocp.guesses import guess_candidates, make_guess
from mbocp.guesses.around import near_the_way
from mbocp.problem import SolverOptions
from mbocp.programme import Iterate
from mbocp.programme.compilation import CompiledFunctions
from mbocp.programme.kernel import kernel_programme
from mbocp.solution import IterationRecord, Status
from tests.test_determinism import digest, digest_of

if TYPE_CHECKING:
    from mbocp.programme.native_modules import KernelProgramme

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(autouse=True)
def processors(monkeypatch: pytest.MonkeyPatch) -> None:
    """Four, wherever the tests run."""
    monkeypatch.setattr("mbocp.problem.solver.available_threads", lambda: 4)


def pendulum(**solver: Any) -> mbocp.Problem:
    return mbocp.Problem.create(
        "double_pendulum",
        3.0,
        60,
        goal={"q": [2.5, 2.0], "v": [0, 0]},
        cost={"velocity": 0.0},
        solver={"starts": 5, **solver},
        scheme="se1",
    )


# What is done side by side


def test_pieces_come_in_their_order_whoever_is_quicker():
    def work(number: int, watch: Watch) -> int:
        time.sleep(0.02 * (number % 3 == 0))
        return 10 * number

    for threads in (1, 2, 3, 8):
        assert list(SideBySide(work, 7).run(threads).items()) == [(k, 10 * k) for k in range(7)]
    assert SideBySide(work, 0).run(3) == {}


@pytest.mark.parametrize("threads", [1, 2, 3, 6])
def test_no_piece_counts_after_the_first_that_ends_them_all(threads):
    """Piece 2 ends them, and piece 1 would, too, but takes longer."""

    def work(number: int, watch: Watch) -> int:
        if number == 1:
            time.sleep(0.05)
        return number

    assert SideBySide(work, 6, ends=lambda n: n in (1, 2)).run(threads) == {0: 0, 1: 1}


def test_a_piece_that_nobody_waits_for_is_ended():
    given_up = threading.Event()

    def work(number: int, watch: Watch) -> int:
        if number == 0:
            assert begun.wait(10.0)
            return number
        begun.set()
        try:
            while True:
                watch("record")
        except KeyboardInterrupt:
            given_up.set()
            raise

    begun = threading.Event()
    assert SideBySide(work, 2, ends=lambda _: True).run(2) == {0: 0}
    assert given_up.is_set()


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_the_error_of_the_earliest_piece_is_raised(threads):
    def work(number: int, watch: Watch) -> int:
        time.sleep(0.03 * (number == 1))
        if number in (1, 2):
            raise ValueError(f"piece {number}")
        return number

    before = threading.active_count()
    with pytest.raises(ValueError, match="piece 1"):
        SideBySide(work, 4).run(threads)
    assert threading.active_count() == before


def test_ctrl_c_in_the_calling_thread_ends_all():
    def work(number: int, watch: Watch) -> int:
        if number == 0:
            assert begun.wait(10.0)
            raise KeyboardInterrupt
        begun.set()
        while True:
            watch("record")

    begun, before = threading.Event(), threading.active_count()
    row = SideBySide(work, 5)
    with pytest.raises(KeyboardInterrupt):
        row.run(3)
    assert row.results == {}
    assert threading.active_count() == before


def test_callbacks_are_called_in_the_calling_thread_in_order():
    seen: list[tuple[int, int]] = []

    def work(number: int, watch: Watch) -> int:
        watch(number)
        return number

    def callback(number: int) -> None:
        seen.append((number, threading.get_ident()))

    SideBySide(work, 5, callback).run(3)
    assert sorted(seen) == [(k, threading.get_ident()) for k in range(5)]


# Starts


def test_starts_come_to_the_same_with_any_number_of_threads():
    alone, *others = (mbocp.solve(pendulum(threads=n)) for n in (1, 2, 3))
    assert alone.converged
    for other in others:
        assert other.starts == alone.starts
        assert digest_of(other, alone) == digest(alone)


def test_starts_that_go_down_again_come_to_the_same():
    def problem(threads: int) -> mbocp.Problem:
        goal = {"q": [np.pi, 0.0], "v": [0, 0]}
        cost = {"velocity": 0.0}
        robot = {"name": "double_pendulum", "damping": False}
        return mbocp.Problem.create(
            robot, 2.0, 40, goal=goal, cost=cost, solver={"starts": 3, "threads": threads}, scheme="se1"
        )

    alone, other = mbocp.solve(problem(1)), mbocp.solve(problem(3))
    assert any(" weighed " in phase.name for phase in alone.phases) or alone.iterations > 15
    assert other.starts == alone.starts
    assert digest_of(other, alone) == digest(alone)


def test_the_callback_sees_all_starts_in_its_own_thread():
    seen: list[tuple[str, int]] = []

    def callback(record: IterationRecord) -> None:
        seen.append((record.phase, threading.get_ident()))

    solution = mbocp.solve(pendulum(threads=3), callback=callback)
    assert {place for _, place in seen} == {threading.get_ident()}
    phases = {phase for phase, _ in seen}
    assert {f"monolithic (start {k})" for k in range(2, 6)} <= phases
    assert {record.phase for record in solution.history} <= phases


def test_ctrl_c_in_one_start_ends_those_of_other_threads():
    def callback(record: IterationRecord) -> None:
        if record.iteration == 2 and "start" not in record.phase:
            raise KeyboardInterrupt

    before = threading.active_count()
    solution = mbocp.solve(pendulum(threads=2), callback=callback)
    assert solution.status is Status.INTERRUPTED
    assert threading.active_count() == before


def test_ctrl_c_at_the_keyboard_ends_a_solve_with_threads():
    """While the other thread goes on, and this one begins nothing new."""
    code = (
        "import time, mbocp; from tests.test_threads import pendulum; "
        "see = lambda record: (print('begun', flush=True), time.sleep(1.0)); "
        "print(mbocp.solve(pendulum(threads=2), callback=see).status, flush=True)"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code], cwd=Path(__file__).parents[1], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "begun\n"
    process.send_signal(signal.SIGINT)
    out, _ = process.communicate(timeout=60)
    assert out.split()[-1] == "interrupted"
    assert process.returncode == 0


def test_an_error_in_a_start_of_another_thread_is_raised(monkeypatch):
    def failing(settings: Any, start: Any) -> Any:
        if "start 2" in start.label:
            raise RuntimeError("broken")
        return solved(settings, start)

    solved = mbocp.guesses.several.run_strategy
    monkeypatch.setattr("mbocp.guesses.several.run_strategy", failing)
    with pytest.raises(RuntimeError, match="broken"):
        mbocp.solve(pendulum(threads=2))


def test_starts_by_ipopt_wait_for_each_other():
    def problem(threads: int) -> mbocp.Problem:
        return pendulum(threads=threads, starts=3, method="ipopt").with_(limits={"effort": 3.0})

    alone, other = mbocp.solve(problem(1)), mbocp.solve(problem(3))
    assert alone.converged
    assert len(other.history) > 1
    assert digest_of(other, alone) == digest(alone)


# Stages


@pytest.fixture
def programmes(monkeypatch: pytest.MonkeyPatch) -> list[KernelProgramme]:
    """Those that solvers make."""
    made: list[KernelProgramme] = []

    def kept(*arguments: Any, **options: Any) -> KernelProgramme:
        made.append(kernel_programme(*arguments, **options))
        return made[-1]

    for module in ("newton", "limit_multipliers"):
        monkeypatch.setattr(f"mbocp.solvers.newton_method.{module}.kernel_programme", kept)
    return made


@pytest.mark.parametrize(
    "name",
    [
        "arms/ur5_limits",
        "arms/slalom",  # obstacles
        "arms/minimum_time",  # a free duration
        pytest.param("loops/four_bar", marks=pytest.mark.slow),
        "free_flyer/drone_flip",
        pytest.param("arms/throw_into_bucket", marks=pytest.mark.slow),  # phases
    ],
)
def test_threads_that_share_stages_change_no_bit(name: str, programmes: list[KernelProgramme]):
    problem = mbocp.load_problem(EXAMPLES / f"{name}.toml")
    alone = mbocp.solve(problem)
    for threads in (2, 3):
        programmes.clear()
        other = mbocp.solve(problem.with_(solver={"threads": threads}))
        assert {p.num_threads for p in programmes} == {threads}
        assert sum(p.num_shared for p in programmes) > 0
        assert digest_of(other, alone) == digest(alone)


@pytest.mark.parametrize("name", ["arms/ur5_limits", "arms/slalom", "arms/panda_reach"])
def test_every_part_of_an_iteration_is_the_same_at_random_points(name: str):
    """A hundred times: loops are shared now and then."""
    problem = near_the_way(mbocp.load_problem(EXAMPLES / f"{name}.toml"))
    formulation = formulate(problem)
    iterate, _ = make_guess(guess_candidates(problem)[0], formulation)
    has_limits = not formulation.programme.bounds.is_empty
    made = [kernel_programme(formulation.programme, has_limits=has_limits, threads=n) for n in (1, 2, 4)]
    for seed in range(100):
        found = [
            parts_of(native, iterate, np.random.default_rng(seed), has_limits=has_limits) for native in made
        ]
        assert found[0] == found[1] == found[2]
    assert [native.num_threads for native in made] == [1, 2, 4]
    assert made[0].num_shared == 0
    assert min(native.num_shared for native in made[1:]) > 5


def parts_of(
    native: KernelProgramme, iterate: Iterate, rng: np.random.Generator, *, has_limits: bool
) -> list[bytes]:
    """What the kernel makes of a point near an iterate, bit by bit; sometimes of one that is not finite."""
    iterate.load_into(native)
    native.u = native.u + 1e-2 * rng.standard_normal(native.u.size)
    native.m = 1e-2 * rng.standard_normal(native.m.size)
    if rng.random() < 0.02:
        x = native.x
        x[rng.integers(x.size)] = np.nan
        native.x = x
    if has_limits:
        native.start_limits(1e-2, 1e-2)
    evaluation = native.evaluate()
    numbers = [
        getattr(evaluation, key) for key in ("cost", "residual", "dual", "violation", "worst", "finite")
    ]
    factorisation = native.factorise(float(rng.choice([0.0, 1.0, 100.0])), 10.0)
    numbers += [getattr(factorisation, key) for key in ("ok", "negative", "smallest_pivot", "bad_stage")]
    if factorisation.ok:
        direction = native.solve()
        numbers += [direction.increment, direction.slope, direction.curvature, direction.linear_residual]
        trial = native.trial(0.3)
        numbers += [trial.objective, trial.violation, trial.finite]
    arrays = [native.costates, native.control_gradient]
    arrays += [native.dx, native.du, native.dm, native.deta] if factorisation.ok else []
    return [np.array(numbers, dtype=float).tobytes(), *(array.tobytes() for array in arrays)]


@pytest.mark.usefixtures("compiled")
def test_functions_that_cannot_be_copied_have_one_thread():
    def interpreted(functions: CompiledFunctions, names: str) -> CompiledFunctions:
        return CompiledFunctions.interpret({name: functions.function(name) for name in names.split()})

    programme = formulate(pendulum()).programme
    made = replace(
        programme,
        functions=interpreted(programme.functions, "values jacobian complete retract difference"),
        end_functions=interpreted(programme.end_functions, "terminal_values terminal_complete"),
    )
    assert kernel_programme(programme, threads=3).num_threads == 3
    assert kernel_programme(made, threads=3).num_threads == 1


def test_a_horizon_that_moves_on_has_one_thread():
    problem = mbocp.load_problem(EXAMPLES / "receding" / "ur5_follow.toml")
    horizon = mbocp.RecedingHorizon(problem.with_(solver={"threads": 2}))
    assert horizon._programme.num_threads == 1


# The option


def test_words_and_numbers_that_cannot_be_are_refused():
    for wrong in (0, -1, 1.5, "many", True):
        with pytest.raises(ProblemFileError, match=r"solver\.threads"):
            pendulum(threads=wrong)


def test_no_more_threads_than_processors_and_one_in_a_worker(monkeypatch):
    assert SolverOptions().num_threads == 1
    assert SolverOptions(threads="auto").num_threads == 4
    assert [SolverOptions(threads=n).num_threads for n in (2, 4, 9)] == [2, 4, 4]
    monkeypatch.setattr("mbocp.problem.solver.available_threads", lambda: 1)  # as a worker of a study says
    assert [SolverOptions(threads=n).num_threads for n in (2, "auto")] == [1, 1]

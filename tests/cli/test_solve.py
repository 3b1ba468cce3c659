"""`mbocp solve`: exit status, what goes where, and bad input."""

from __future__ import annotations

import errno
import json
import re
import warnings
from pathlib import Path

import pytest

from mbocp.exceptions import SingularSystem
from mbocp.solution import Solution, Status
from mbocp.solvers.options import METHODS

from .conftest import FakeSolver, Run


def test_converged(folder: Path, run: Run, solver: FakeSolver) -> None:
    done = run("solve", "arm.toml", "-o", "arm.h5")
    assert done.exit_code == 0
    for words in (
        "ur5: 6 degrees of freedom, 6 controls",
        "1 s in 10 steps of 0.1 s",
        "converged: all is well",
        "a straight line",
        "12.5",
        "3 in 250 ms",
        "off by 0.00e+00 rad",
        "320 unknowns",
        "arm.h5",
    ):
        assert words in done.stdout, words
    assert "residual" in done.stderr
    assert Solution.load(folder / "arm.h5").converged


@pytest.mark.parametrize("status", [s for s in Status if s not in (Status.CONVERGED, Status.INTERRUPTED)])
def test_not_converged_is_1_and_still_saved(
    folder: Path, run: Run, solver: FakeSolver, status: Status
) -> None:
    solver.status = status
    done = run("solve", "arm.toml", "-o", "arm.h5")
    assert done.exit_code == 1
    assert f"{status}: try another guess" in done.stdout
    assert Solution.load(folder / "arm.h5").status is status


def test_json_is_one_object_and_nothing_else(folder: Path, run: Run, solver: FakeSolver) -> None:
    done = run("solve", "arm.toml", "--json", "--replay", "arm.html")
    facts = json.loads(done.stdout)
    assert done.stderr == ""
    assert set(facts) == {
        "status",
        "converged",
        "positive_work",
        "drawn_energy",
        "advice",
        "solver",
        "iterations",
        "cost",
        "residual",
        "increment",
        "constraint_violation",
        "velocity_violation",
        "violation_within",
        "limit_violation",
        "limit_excess",
        "limit_excess_of",
        "limit_excess_time",
        "manifold_drift",
        "accuracy",
        "parameters",
        "sigmas",
        "tightest",
        "manifold_drift_resimulated",
        "clearance",
        "clearance_between",
        "clearance_time",
        "unknowns",
        "num_steps",
        "duration",
        "via_times",
        "phase_times",
        "wall_time_s",
        "starts",
        "phases",
        "history",
        "control_hamiltonian",
        "control_momentum_drift",
        "conserved",
        "q_final",
        "p_final",
        "u_first",
        "u_last",
        "eta",
    }
    assert (facts["status"], facts["num_steps"]) == ("converged", 10)
    assert [phase["name"] for phase in facts["phases"]] == ["compile", "monolithic"]
    assert set(facts["history"][0]) == {"residual", "increment", "cost", "step_length"}


def test_quiet_says_nothing(folder: Path, run: Run, solver: FakeSolver) -> None:
    done = run("solve", "arm.toml", "-q")
    assert (done.exit_code, done.stdout, done.stderr) == (0, "", "")


def test_quiet_says_what_did_not_converge(folder: Path, run: Run, solver: FakeSolver) -> None:
    solver.status = Status.MAX_ITERATIONS
    done = run("solve", "arm.toml", "-q")
    assert (done.exit_code, done.stdout) == (1, "")
    assert done.stderr == "arm.toml: max_iterations: try another guess\n"


def test_settings_and_solver(folder: Path, run: Run, solver: FakeSolver) -> None:
    done = run(
        "solve",
        "arm.toml",
        "--set",
        "horizon.steps=7",
        "--set",
        "robot.gravity=[0,0,-1]",
        "--solver",
        "monolithic",
    )
    assert done.exit_code == 0
    (problem,) = solver.problems
    assert (problem.num_steps, problem.solver.method) == (7, "monolithic")
    assert list(problem.robot.model.gravity.linear) == [0, 0, -1]


def test_all_outputs(folder: Path, run: Run, solver: FakeSolver) -> None:
    done = run("solve", "arm.toml", "-o", "a.h5", "--replay", "a.html", "--plot", "a.png")
    assert done.exit_code == 0
    for name in ("a.h5", "a.html", "a.png"):
        assert (folder / name).stat().st_size > 1000
        assert name in done.stdout


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["missing.toml"], "missing.toml: no such file"),
        (["arm.toml", "--set", "horizon.steps=0"], "arm.toml: horizon.steps: got 0, expected a whole number"),
        (["arm.toml", "--set", "horizon.duration=-1"], "arm.toml: horizon.duration: got -1.0"),
        (["arm.toml", "--set", "start.q=[1,2]"], "arm.toml: start.q: got shape (2,), expected (6,)"),
        (["arm.toml", "--set", "start.q=[1,2,nan,0,0,0]"], "arm.toml: start.q: got nan"),
        (["arm.toml", "--set", "horizon.stepz=3"], "unknown key, did you mean 'steps'?"),
        (["arm.toml", "--set", "robot=ur55"], "unknown robot 'ur55': did you mean 'ur5'"),
        (["arm.toml", "--set", "robot.lock=['elbow']"], "no joint 'elbow'"),
        (["arm.toml", "--set", "horizon.steps=1"], "12 independent exact end conditions"),
        (["arm.toml", "--set", "horizon.steps"], "--set: expected key.path=value"),
        (["arm.toml", "--solver", "magic"], "solver.method: got 'magic', expected \"auto\""),
        (["arm.toml", "-o", "nowhere/a.h5"], "nowhere/a.h5: -o: there is no folder 'nowhere'"),
        (["arm.toml", "-o", "."], "-o is a folder"),
        (["arm.toml", "-o", "a.json"], "-o must end in .h5 or .hdf5, got .json"),
        (["arm.toml", "-o", "arm.toml"], "-o must end in"),
        (["arm.toml", "--replay", "a.h5"], "--replay must end in .html"),
        (["arm.toml", "--plot", "plot"], "--plot must end in .png or .pdf or .svg, got nothing"),
        ([], "Missing argument 'FILE'"),
        (["arm.toml", "--no-such-option"], "No such option"),
    ],
)
def test_bad_input_is_2_before_any_work(
    folder: Path, run: Run, solver: FakeSolver, arguments: list[str], reason: str
) -> None:
    done = run("solve", *arguments)
    assert done.exit_code == 2
    assert reason in done.stderr.replace("\n", " ")
    assert "Traceback" not in done.output
    assert done.stdout == ""
    assert solver.problems == []


def test_malformed_toml_names_the_line(folder: Path, run: Run) -> None:
    (folder / "bad.toml").write_text('robot = "ur5"\n[horizon\n')
    done = run("solve", "bad.toml")
    assert done.exit_code == 2
    assert "bad.toml: malformed TOML" in done.stderr
    assert "line 2" in done.stderr


def test_two_outputs_of_one_name(folder: Path, run: Run, solver: FakeSolver) -> None:
    (folder / "b.html").symlink_to(folder / "a.h5")
    done = run("solve", "arm.toml", "-o", "a.h5", "--replay", "b.html")
    assert done.exit_code == 2
    assert "--replay would overwrite -o" in done.stderr


def test_error_of_the_solver_is_2(folder: Path, run: Run, solver: FakeSolver) -> None:
    solver.error = SingularSystem("the mass matrix of robot 'ur5' is singular")
    done = run("solve", "arm.toml")
    assert done.exit_code == 2
    assert "error: the mass matrix" in done.stderr


def test_a_bug_is_neither_1_nor_2(folder: Path, run: Run, solver: FakeSolver) -> None:
    solver.error = ZeroDivisionError("oh")
    done = run("solve", "arm.toml")
    assert done.exit_code == 70
    assert "ZeroDivisionError: oh" in done.stderr
    assert "please report" in done.stderr


def test_what_the_machine_refuses_is_a_line(folder: Path, run: Run, solver: FakeSolver) -> None:
    for error, words in (
        (MemoryError(), "error: there is not enough memory"),
        (OSError(errno.ENOSPC, "No space left on device", "/a/b"), "error: /a/b: No space left on device"),
    ):
        solver.error = error
        done = run("solve", "arm.toml")
        assert done.exit_code == 2
        assert done.stderr.splitlines()[-1].startswith(words)
        assert "Traceback" not in done.stderr


def test_other_errors_of_the_system_stay_bugs(folder: Path, run: Run, solver: FakeSolver) -> None:
    for error in (FileNotFoundError(errno.ENOENT, "no"), RecursionError("deep")):
        solver.error = error
        assert run("solve", "arm.toml").exit_code == 70


@pytest.mark.parametrize(
    ("error", "status", "kind"),
    [
        (SingularSystem("oh " * 10_000), 2, "SingularSystem"),
        (MemoryError(), 2, "MemoryError"),
        (KeyboardInterrupt(), 130, "KeyboardInterrupt"),
        (ZeroDivisionError("oh"), 70, "ZeroDivisionError"),
    ],
)
def test_json_is_one_object_also_when_it_fails(
    folder: Path, run: Run, solver: FakeSolver, error: BaseException, status: int, kind: str
) -> None:
    solver.error = error
    done = run("solve", "arm.toml", "--json")
    facts = json.loads(done.stdout)
    assert done.exit_code == facts["exit_status"] == status
    assert facts["converged"] is False
    assert facts["error"] == kind
    assert facts["status"] == ("interrupted" if status == 130 else "error")
    assert len(facts["message"]) <= 4000
    assert done.stderr


def test_an_output_whose_name_is_too_long(folder: Path, run: Run, solver: FakeSolver) -> None:
    for name in (300 * "x" + ".h5", 300 * "x" + "/a.h5"):
        done = run("solve", "arm.toml", "-o", name)
        assert done.exit_code == 2
        assert done.stderr.startswith("error: ")
        assert len(done.stderr.splitlines()) == 1
    assert not solver.problems


def test_messages_are_bounded(folder: Path, run: Run, solver: FakeSolver) -> None:
    solver.error = ZeroDivisionError("x" * 1_000_000)
    assert len(run("solve", "arm.toml").stderr) < 30_000


def test_ctrl_c_before_the_solver(folder: Path, run: Run, solver: FakeSolver) -> None:
    solver.error = KeyboardInterrupt()
    done = run("solve", "arm.toml", "-o", "a.h5")
    assert done.exit_code == 130
    assert not (folder / "a.h5").exists()


def test_warnings_are_one_line(folder: Path, run: Run, solver: FakeSolver) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        done = run("solve", "arm.toml", "--set", "goal={}")
    assert done.exit_code == 0
    assert "warning: the problem asks for nothing" in done.stderr
    assert "ProblemWarning" not in done.stderr


def test_help_names_every_method(run: Run) -> None:
    words = " ".join(run("solve", "--help").stdout.split())
    for method in METHODS:
        assert re.search(rf"(^|[ ,]){re.escape(method)}([ ,;])", words), method


@pytest.mark.parametrize(
    ("name", "hint"),
    [("fbsm", "'fbsm_bb'"), ("fbsm_nweton", "'fbsm_newton'"), ("Monolithic", "'monolithic'")],
)
def test_a_misspelt_method_gets_a_hint(folder: Path, run: Run, name: str, hint: str) -> None:
    done = run("solve", "arm.toml", "--solver", name)
    assert done.exit_code == 2
    assert f"did you mean {hint}" in done.stderr.replace("\n", " ")
    assert all(f'"{method}"' in done.stderr for method in METHODS)


def test_summary_says_what_is_conserved(folder: Path, run: Run, solver: FakeSolver) -> None:
    words = " ".join(run("solve", "arm.toml").stdout.split())
    assert "rotation about z: -2.5, drift 0.0e+00, relative 0.0e+00" in words
    assert "adjoint mu_q of shoulder_pan_joint, a cyclic coordinate" in words
    assert "Hamiltonian mean 3, from 3 to 3" in words
    assert "monolithic 3 in 50 ms" in words

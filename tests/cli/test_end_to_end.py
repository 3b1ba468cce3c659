"""The command line with the real solver, on a small problem."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mbocp.cli.progress_table import ProgressCallback
from mbocp.solution import IterationRecord, Solution, Status

from .conftest import Run

FILE = str(Path(__file__).parents[2] / "examples" / "paper" / "rigid_pendulum.toml")
SMALL = ("--set", "horizon.steps=10")


def test_solve_save_and_warm_start(tmp_path: Path, run: Run) -> None:
    saved = tmp_path / "swing.h5"
    done = run("solve", FILE, *SMALL, "--json", "-o", str(saved))
    assert done.exit_code == 0
    facts = json.loads(done.stdout)
    assert facts["cost"] == pytest.approx(379.902613860062, rel=1e-9)  # independent reference, dt = 0.1 s
    assert facts["constraint_violation"] < 1e-12
    assert facts["residual"] < 1e-9
    again = json.loads(run("solve", FILE, *SMALL, "--json", "--set", f"guess={{file='{saved}'}}").stdout)
    assert again["iterations"] <= 1
    assert again["cost"] == pytest.approx(facts["cost"], rel=1e-12)
    assert "violated by" in run("info", str(saved)).stdout


def test_ctrl_c_while_solving(tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(progress: ProgressCallback, record: IterationRecord) -> None:
        if record.iteration == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(ProgressCallback, "__call__", stop)
    saved = tmp_path / "swing.h5"
    done = run("solve", FILE, *SMALL, "-o", str(saved))
    assert done.exit_code == 130
    assert "interrupted" in done.stdout
    assert Solution.load(saved).status is Status.INTERRUPTED


def test_a_proved_cause_is_told_once_and_alone(run: Run) -> None:
    ur5 = str(Path(FILE).parents[1] / "arms/ur5_limits.toml")
    told = " ".join(run("solve", ur5, "--set", "horizon.duration=0.6", *SMALL).stdout.split())
    assert "infeasible: shoulder_pan_joint needs 0.698 s" in told
    assert told.count("shoulder_pan_joint needs") == 1
    assert "try a longer duration" not in told
    assert "last increment -" in told


def test_unreachable_tolerance_is_not_converged(run: Run) -> None:
    done = run("solve", FILE, *SMALL, "--json", "--set", "solver.max_iterations=1")
    assert done.exit_code == 1
    facts = json.loads(done.stdout)
    assert (facts["status"], facts["converged"]) == ("max_iterations", False)
    assert "solver.max_iterations" in facts["advice"]

"""Tables and JSON for other tools."""

from __future__ import annotations

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from mbocp.solution import IterationRecord, Solution, export

from .fabricated import limited, pendulum

# The object of `mbocp solve --json`, in this order: others read it.
KEYS = [
    "status", "converged", "advice", "solver", "iterations", "cost", "residual", "increment",
    "constraint_violation", "velocity_violation", "violation_within", "limit_violation",
    "limit_excess", "limit_excess_of", "limit_excess_time", "manifold_drift",
    "manifold_drift_resimulated", "clearance", "clearance_between", "clearance_time", "positive_work",
    "drawn_energy", "sigmas", "tightest", "accuracy", "unknowns", "num_steps", "duration", "via_times",
    "phase_times", "parameters", "wall_time_s", "phases",
    "history",
    "control_hamiltonian", "control_momentum_drift",
    "conserved", "q_final", "p_final", "u_first", "u_last", "eta", "starts",
]  # fmt: skip


def test_json_has_the_keys_of_the_contract_in_order() -> None:
    summary = json.loads(pendulum().to_json())
    assert list(summary) == KEYS
    assert summary["status"] == "converged"
    assert summary["converged"] is True
    assert summary["phases"][1] == {"name": "newton", "iterations": 9, "wall_time_s": 0.05}
    assert list(summary["history"][0]) == ["residual", "increment", "cost", "step_length"]
    assert list(summary["control_hamiltonian"]) == ["min", "max", "mean"]
    (conserved,) = summary["conserved"]
    assert list(conserved) == ["name", "meaning", "value", "drift", "relative_drift"]
    assert (conserved["name"], conserved["value"]) == ("rotation about z", 1.5)
    assert summary["q_final"] == pendulum().qs[-1].tolist()


def test_every_key_is_an_attribute_of_the_same_name() -> None:
    for key in KEYS:
        assert hasattr(pendulum(), key), key


def test_json_knows_no_nan() -> None:
    record = IterationRecord(iteration=1, residual=math.inf, step_length=1.0)
    text = pendulum(cost=math.nan, residual=math.inf, history=(record,), eta=np.array([math.nan])).to_json()
    summary = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert summary["cost"] is summary["residual"] is summary["history"][0]["residual"] is None
    assert summary["eta"] == [None]


def read(path: Path) -> tuple[list[str], list[list[str]]]:
    with path.open(newline="") as file:
        header, *rows = csv.reader(file)
    return header, rows


def test_csv_has_every_number(tmp_path: Path) -> None:
    solution = pendulum()
    header, rows = read(solution.to_csv(tmp_path / "result.csv"))
    assert header[:4] == ["t [s]", "q:x [m]", "q:y [m]", "q:z [m]"]
    assert "u:force_x [N]" in header
    assert "xi:rotation about z [cost]" in header
    assert len(header) == len(set(header))
    assert len(rows) == 101
    table = np.array([[float(cell or "nan") for cell in row] for row in rows])
    column = {name: table[:, i] for i, name in enumerate(header)}
    assert np.array_equal(column["t [s]"], solution.t)
    assert np.array_equal(column["q:z [m]"], solution.qs[:, 2])
    assert np.array_equal(column["u:force_y [N]"][:-1], solution.us[:, 1])
    assert np.array_equal(column["lam:0"][:-1], solution.lams[:, 0])
    assert np.array_equal(column["mu_p:z"], solution.mus[:, 5])


def test_csv_leaves_the_last_row_of_stage_quantities_blank(tmp_path: Path) -> None:
    header, rows = read(pendulum().to_csv(tmp_path / "result.csv"))
    blank = {name for name, cell in zip(header, rows[-1], strict=True) if cell == ""}
    assert {name.split(":")[0] for name in blank} == {"u", "lam", "zeta", "H [cost/s]"}
    assert "" not in rows[-2]


def test_csv_has_the_multipliers_of_limits_where_there_are_any(tmp_path: Path) -> None:
    solution = limited()
    header, rows = read(solution.to_csv(tmp_path / "result.csv"))
    pulls = [name for name in header if name.startswith("lam_")]
    assert pulls[:3] == ["lam_u:force_x [cost/N]", "lam_u:force_y [cost/N]", "lam_u:force_z [cost/N]"]
    assert pulls[-2:] == ["lam_path:ceiling.z", "lam_path:clearance"]
    assert "lam_q:x [cost/m]" not in header  # positions are free
    column = [row[header.index("lam_path:ceiling.z")] for row in rows]
    assert column[0] == ""
    assert np.array_equal([float(cell) for cell in column[1:]], solution.lam_path[:, 0])
    assert not any("lam_" in name for name in read(pendulum().to_csv(tmp_path / "free.csv"))[0])


def test_an_interrupted_csv_leaves_the_old_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = pendulum().to_csv(tmp_path / "result.csv")
    before = path.read_bytes()

    def broken(solution: Solution) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(export, "table", broken)
    with pytest.raises(KeyboardInterrupt):
        pendulum().to_csv(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]

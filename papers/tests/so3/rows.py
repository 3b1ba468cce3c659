"""Made-up rows of a lattice."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mbocp_papers.so3.experiment import Lattice, lattice_study

from mbocp.study import StudyResult
from mbocp.study.run import _header

UPRIGHT = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0]
HANGING = [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]

Row = Callable[[int, str], Mapping[str, Any]]


def row(_index: int, _label: str) -> dict[str, Any]:
    """A success."""
    return {
        "status": "converged",
        "converged": True,
        "iterations": 50,
        "solver_time_s": 0.25,
        "total_time_s": 1.0,
        "cost": -1.5,
        "residual": 1e-9,
        "constraint_violation": 0.0,
        "manifold_drift": 1e-9,
        "limit_violation": 0.0,
        "goal_distance": 0.0,
        "message": "",
        "record": {"q_final": UPRIGHT, "manifold_drift_resimulated": 1e-15},
    }


def written(path: Path, lattice: Lattice, make: Row = row, *, count: int | None = None, **kind: str) -> Path:
    """Write rows of a lattice's study; `make` gives each by its number within the lattice and its label."""
    study = lattice_study(lattice, **kind)  # type: ignore[arg-type]
    header = {**_header(study), "digest": study.digest}
    lines = [json.dumps(header)]
    for task in study.tasks():
        if count is not None and task.index >= count:
            break
        made = make(task.index // 6, task.values["formulation"])
        lines.append(json.dumps({"index": task.index, "values": dict(task.values), **made}))
    path.write_text("\n".join(lines) + "\n")
    return path


def random_rows(path: Path, lattice: Lattice) -> Path:
    """Rows with different numbers, some half-turns and some failures."""
    rng = np.random.default_rng(4)

    def make(_index: int, label: str) -> dict[str, Any]:
        made, draw = row(0, label), rng.random()
        made |= {"iterations": int(rng.normal(60, 10)), "cost": float(rng.normal(-1.0, 2.0))}
        if draw < 0.1:
            made |= {"status": "max_iterations", "converged": False, "cost": None}
        elif draw < 0.2:
            made["record"] = {"q_final": HANGING, "manifold_drift_resimulated": 1e-15}
        return made

    return written(path, lattice, make)


def loaded(path: Path) -> StudyResult:
    """Read rows."""
    return StudyResult.load(path)

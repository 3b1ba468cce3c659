"""A solution for other tools: a CSV table and the object that `mbocp solve --json` prints."""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from mbocp._arrays import Array, plain_json
from mbocp.solution.atomic import atomic_path
from mbocp.solution.data import TOLD, SolutionData
from mbocp.solution.records import Column
from mbocp.storage.content import QUANTITIES


def table(solution: SolutionData) -> tuple[list[str], Array]:
    """All trajectories side by side, one row a node.

    What belongs to the step from node n to n+1 (u, lam, zeta, H) stands in row n, and is NaN in the last row.
    Where controls vary within steps `u` is their mean, and `u@0.5` their value after that part of the step.

    Returns
    -------
    header : list of str
        `t [s]`, then `q:joint [rad]` and so on.
    rows : ndarray, shape (N + 1, columns)
    """
    header, columns = ["t [s]"], [solution.t[:, None]]
    for prefix, names, values in _blocks(solution):
        header += [prefix + column.header for column in names]
        missing = np.full((len(solution.t) - len(values), values.shape[1]), np.nan)
        columns.append(np.vstack([values, missing]))
    return header, np.hstack(columns)


def _blocks(solution: SolutionData) -> Iterator[tuple[str, tuple[Column, ...], Array]]:
    """Beginning of the names, columns and rows of each quantity, those of no limits left out."""
    for name, quantity in QUANTITIES.items():
        values, columns, prefix = getattr(solution, name), solution.columns(name), quantity.heading
        if prefix is None or (quantity.may_lack and not values.size):
            continue
        if quantity.axes[1:2] == ("share",):  # where controls vary within steps
            for k, share in enumerate(solution.u_shares):
                yield f"{prefix}@{share:.6g}:", columns, values[:, k]
        elif quantity.axes[1:] == ("mu",):
            num_v = solution.nv
            yield f"{prefix}_q:", columns[:num_v], values[:, :num_v]
            yield f"{prefix}_p:", columns[num_v:], values[:, num_v:]
        elif quantity.axes[0] == "later node":  # nothing is constrained at the start
            start = np.full((1, values.shape[1]), np.nan)
            yield f"{prefix}:", columns, np.vstack([start, values])
        elif len(quantity.axes) == 1:
            yield "", columns, values[:, None]
        elif not quantity.columns.startswith("dual ") or _has_limits(solution, quantity.axes[1]):
            yield f"{prefix}:", columns, values


def _has_limits(solution: SolutionData, letter: str) -> bool:
    return bool(np.isfinite(getattr(solution, f"limits_{letter}")).any())


def write_csv(solution: SolutionData, path: str | Path) -> Path:
    """Write `table(solution)` as CSV, atomically; NaN is an empty cell, numbers have all their digits."""
    header, rows = table(solution)
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(["" if math.isnan(x) else repr(x) for x in row] for row in rows.tolist())
    return Path(path)


def solution_dict(solution: SolutionData) -> dict[str, Any]:
    """The object of `--json`: plain numbers and lists; NaN and infinity become None."""
    result = {
        "status": str(solution.status),
        "converged": solution.converged,
        **{name: getattr(solution, name) for name in TOLD if name != "status"},
        "accuracy": dataclasses.asdict(solution.accuracy) if solution.accuracy.is_known else None,
        "unknowns": solution.unknowns,
        "num_steps": solution.num_steps,
        "duration": solution.duration,
        "via_times": solution.via_times,
        "phase_times": solution.phase_times,
        "parameters": solution.parameters,
        "wall_time_s": solution.wall_time_s,
        "phases": [dataclasses.asdict(phase) for phase in solution.phases],
        "history": [
            {"residual": r.residual, "increment": r.increment, "cost": r.cost, "step_length": r.step_length}
            for r in solution.history
            if not r.is_guess
        ],
        "control_hamiltonian": solution.control_hamiltonian,
        "control_momentum_drift": solution.control_momentum_drift,
        "conserved": [dataclasses.asdict(quantity) for quantity in solution.conserved],
        "q_final": solution.q_final,
        "p_final": solution.p_final,
        "u_first": solution.u_first,
        "u_last": solution.u_last,
        "eta": solution.eta,
        "starts": [
            {"guess": s.guess, "status": str(s.status), "cost": s.cost, "iterations": s.iterations}
            | ({} if s.goal is None else {"goal": s.goal})
            for s in solution.starts
        ],
    }
    found: dict[str, Any] = plain_json(result)
    return found
